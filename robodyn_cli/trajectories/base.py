"""What the trajectories share: the inverse kinematics options, and what they may ask about the scene.

A trajectory is a frozen dataclass whose fields are its YAML keys. ``problems`` reports what single keys
cannot tell, as (path below the trajectory, message); the loader adds file and line.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Integer, JointMap, Number, key

# the sides of an arm that its inverse kinematics chooses between
SIDES, ELBOWS, WRISTS = ("righty", "lefty"), ("elbow_up", "elbow_down"), ("no_flip", "flip")
BRANCHES = (*ELBOWS, *(f"{side}-{elbow}-{wrist}" for side in SIDES for elbow in ELBOWS for wrist in WRISTS))

Problems = Iterator[tuple[tuple[str | int, ...], str]]


class SceneNames(Protocol):
    """What a trajectory may ask about the scene: its moving joints, whether loops close it, whether a point exists.

    joints : names of the columns of q that a trajectory gives: joints, or their coordinates (``slide.d``).
    quasi : joints whose attitude is given as a whole.
    """

    @property
    def joints(self) -> tuple[str, ...]: ...

    @property
    def closed(self) -> bool: ...

    @property
    def quasi(self) -> tuple[str, ...]: ...

    def point_problem(self, reference: str) -> str | None: ...


@record
class Ik:
    """Options of the inverse kinematics."""

    method: str = key(
        Choice(("auto", "analytic", "newton")),
        default="auto",
        doc="`auto` uses the analytic solution if there is one.",
    )
    branch: str | None = key(
        Choice(BRANCHES),
        default=None,
        doc="Branch of an arm in closed form, by its sides: elbow_up (theta2 < 0) or elbow_down of planar arms and "
        "SCARA robots; shoulder, elbow and wrist of arms with a spherical wrist or three parallel axes.",
    )
    guess: dict[str, float] = key(
        JointMap(Number(angle=True)),
        default=None,
        unit="rad or m",
        doc="Start of Newton's method at t = 0.",
    )
    redundancy: str = key(
        Choice(("least_rates", "away_from_limits", "least_torque")),
        default="least_rates",
        doc="What a redundant arm does with its freedom along the path.",
    )
    tolerance: float = key(
        Number(minimum=0.0, exclusive=True),
        default=1e-12,
        unit="m, rad",
        doc="Distance, and angle, to the target that is accepted.",
    )
    max_iterations: int = key(
        Integer(minimum=1, maximum=100_000), default=50, doc="Newton iterations a sample."
    )


def joint_problems(
    names: Sequence[str],
    joints: Sequence[str],
    path: tuple[str | int, ...],
    needed: Sequence[str] | None = None,
) -> Problems:
    """Report names that are no moving joints; else joints that ``names`` lacks (of ``needed``, by default all)."""
    from robodyn_cli.errors import did_you_mean

    unknown = [name for name in names if name not in joints]
    for name in unknown:
        yield (
            (*path, name),
            f"unknown joint {name!r}{did_you_mean(name, joints)}; allowed: {', '.join(joints)}",
        )
    if unknown:
        return
    needed = joints if needed is None else needed
    missing = [name for name in needed if name not in names]
    if missing:
        yield path, f"joint {missing[0]!r} is missing; needed here: {', '.join(needed)}"


def led_joints(names: Sequence[str], scene: SceneNames) -> Sequence[str]:
    """Return the joints that a motion in joint space must give: all, but in mechanisms those that it chooses to.

    Loops decide about the others.
    """
    return names if scene.closed else scene.joints


def attitude_problems(kind: str, scene: SceneNames) -> Problems:
    """Report joints whose attitude a kind of trajectory cannot lead; loops may decide about it."""
    if scene.quasi and not scene.closed:
        yield (
            (),
            f"a {kind} cannot lead joint {scene.quasi[0]!r}, whose attitude is no list of numbers to interpolate; use "
            "type: joint with rpy, rotation_vector or quaternion formulas",
        )


def time_problems(times: Sequence[float], paths: Sequence[tuple[str | int, ...]]) -> Problems:
    """Report times that do not start at 0 or do not increase."""
    if times and times[0] != 0.0:
        yield paths[0], f"the first time must be 0 (value {times[0]!r})"
    for k in range(1, len(times)):
        if not times[k] > times[k - 1]:
            yield paths[k], f"times must increase (value {times[k]!r} after {times[k - 1]!r})"


def point_problems(point: str, ik: Ik, scene: SceneNames) -> Problems:
    """Report a point that does not exist, and guesses for joints that do not."""
    problem = scene.point_problem(point)
    if problem is not None:
        yield ("point",), problem
    yield from attitude_problems("path of a point", scene)
    guessed = tuple(ik.guess)
    for path, message in joint_problems(guessed, scene.joints, ("ik", "guess"), led_joints(guessed, scene)):
        if ik.guess:
            yield path, message

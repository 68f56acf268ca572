"""What the trajectories share: the inverse kinematics options, and what they may ask about the scene.

A trajectory is a frozen dataclass whose fields are its YAML keys. ``problems`` reports what single keys
cannot tell, as (path below the trajectory, message); the loader adds file and line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Integer, JointMap, Number, key

# the sides of an arm that its inverse kinematics chooses between
SIDES, ELBOWS, WRISTS = ("righty", "lefty"), ("elbow_up", "elbow_down"), ("no_flip", "flip")
BRANCHES = (*ELBOWS, *(f"{side}-{elbow}-{wrist}" for side in SIDES for elbow in ELBOWS for wrist in WRISTS))

Problems = Iterator[tuple[tuple[str | int, ...], str]]


class JointLimits(Protocol):
    """What a joint may do, None where there is no limit."""

    @property
    def lower(self) -> float | None: ...

    @property
    def upper(self) -> float | None: ...


class SceneNames(Protocol):
    """What a trajectory may ask about the scene: its moving joints, whether loops close it, whether a point exists.

    joints : names of the columns of q but for those of quasi joints: joints, or their coordinates (``slide.d``).
    quasi : joints whose attitude is given as a whole. columns, rates : all columns of q and of v.
    some : whether the trajectory may leave joints to the forces: in loops, and where it prescribes a simulation.
    """

    @property
    def joints(self) -> tuple[str, ...]: ...

    @property
    def columns(self) -> tuple[str, ...]: ...

    @property
    def rates(self) -> tuple[str, ...]: ...

    @property
    def closed(self) -> bool: ...

    @property
    def some(self) -> bool: ...

    @property
    def parameters(self) -> Mapping[str, float]: ...

    def limits(self, joint: str) -> JointLimits | None: ...

    @property
    def quasi(self) -> tuple[str, ...]: ...

    def point_problem(self, reference: str) -> str | None:
        """Tell why a point or a named frame does not exist, or return None."""
        ...

    def moves(self, reference: str, against: str = "base.origin") -> bool:
        """Tell whether joints, or a motion of its own, move a point or a named frame against another; both exist."""
        ...


def limit_key(what: str, unit: str, angle: bool = True) -> Any:
    """Declare a key with a limit of each joint."""
    return key(
        JointMap(Number(minimum=0.0, exclusive=True, angle=angle), coordinates="v"),
        default=None,
        unit=unit,
        doc=f"Largest {what} of each joint, either way; by default that in its `limits`.",
    )


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
    from robodyn_cli.errors import unknown_name

    unknown = [name for name in names if name not in joints]
    for name in unknown:
        yield (
            (*path, name),
            unknown_name("joint", name, joints),
        )
    if unknown:
        return
    needed = joints if needed is None else needed
    missing = [name for name in needed if name not in names]
    if missing:
        yield path, f"joint {missing[0]!r} is missing; needed here: {', '.join(needed)}"


def limit_problems(given: Mapping[str, Mapping[str, float]], scene: SceneNames) -> Problems:
    """Report limits of a trajectory, by kind and joint, that are of no joint or above the joint's own."""
    for name, values in given.items():
        yield from joint_problems(tuple(values), scene.rates, (name,), ())
        for joint, x in values.items():
            most = getattr(scene.limits(joint), name, None)
            if most is not None and x > most:
                yield (name, joint), f"{x:.6g} is above the joint's own limit; allowed: up to {most:.6g}"


def with_joint_limits(given: Mapping[str, Mapping[str, float]], scene: SceneNames) -> dict[str, Any]:
    """Return limits of a trajectory, by kind and joint, with those of the joints where it gives none of its own."""
    found = {}
    for name, values in given.items():
        own = {joint: getattr(scene.limits(joint), name, None) for joint in scene.rates}
        found[name] = {joint: x for joint, x in own.items() if x is not None} | dict(values)
    return found


def led_joints(names: Sequence[str], scene: SceneNames) -> Sequence[str]:
    """Return the joints that a motion in joint space must give: all, or those that it chooses to.

    Loops, or forces, decide about the others.
    """
    return names if scene.some else scene.joints


def position_problems(
    q: Mapping[str, float],
    scene: SceneNames,
    path: tuple[str | int, ...],
    needed: Sequence[str] | None = None,
) -> Problems:
    """Report what is wrong with positions by column of q: names, joints that lack, limits that are passed.

    Parameters
    ----------
    needed : the columns that must be there; by default all, or those of ``q`` where some joints are enough.
    """
    names = tuple(q)
    wanted = needed if needed is not None else names if scene.some else scene.columns
    found = list(joint_problems(names, scene.columns, path, wanted))
    yield from found
    if found:
        return
    for name, x in q.items():
        limits = scene.limits(name)
        if limits is None:
            continue
        for side, bound, sign in (("lower", limits.lower, -1.0), ("upper", limits.upper, 1.0)):
            if bound is not None and sign * (x - bound) > 1e-12 * max(1.0, abs(bound)):
                yield (*path, name), f"{x:.6g} is beyond the joint's {side} limit; allowed: {_range(limits)}"


def _range(limits: JointLimits) -> str:
    if limits.lower is None or limits.upper is None:
        return f"up to {limits.upper:.6g}" if limits.lower is None else f"{limits.lower:.6g} or more"
    return f"{limits.lower:.6g} to {limits.upper:.6g}"


def time_problems(times: Sequence[float], paths: Sequence[tuple[str | int, ...]]) -> Problems:
    """Report times that do not start at 0 or do not increase."""
    if times and times[0] != 0.0:
        yield paths[0], f"the first time must be 0 (value {times[0]!r})"
    for k in range(1, len(times)):
        if not times[k] > times[k - 1]:
            yield paths[k], f"times must increase (value {times[k]!r} after {times[k - 1]!r})"


def place_problems(point: str, reference: str | None, scene: SceneNames) -> Problems:
    """Report a frame of reference that does not exist, or against which no joint moves the point."""
    if reference is None:
        return
    problem = scene.point_problem(reference)
    if problem is None and scene.point_problem(point) is None and not scene.moves(point, reference):
        problem = (
            f"no joint moves {point!r} against {reference!r}; allowed: a place on the base or on another link"
        )
    if problem is not None:
        yield ("relative_to",), problem


def point_problems(point: str, ik: Ik, scene: SceneNames) -> Problems:
    """Report a point that does not exist, and guesses for joints that do not."""
    problem = scene.point_problem(point)
    if problem is not None:
        yield ("point",), problem
    guessed = tuple(ik.guess)
    for path, message in joint_problems(guessed, scene.joints, ("ik", "guess"), led_joints(guessed, scene)):
        if ik.guess:
            yield path, message

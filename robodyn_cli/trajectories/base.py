"""What the trajectories share: their contract, the inverse kinematics options, what they may ask about the scene.

A trajectory is a frozen dataclass whose fields are its YAML keys. ``problems`` reports what single keys
cannot tell, as (path below the trajectory, message); the loader adds file and line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Integer, JointMap, Number, Text, key
from robodyn_cli.schema.spans import SPAN, Span, either_way, sides, span_fault, span_text

if TYPE_CHECKING:
    from robodyn_cli.spatial.algebra import Array
    from robodyn_cli.trajectories.legs import Scaling
    from robodyn_cli.trajectories.motion import PointMotion, PoseMotion

# the sides of an arm that its inverse kinematics chooses between
SIDES, ELBOWS, WRISTS = ("righty", "lefty"), ("elbow_up", "elbow_down"), ("no_flip", "flip")
BRANCHES = (*ELBOWS, *(f"{side}-{elbow}-{wrist}" for side in SIDES for elbow in ELBOWS for wrist in WRISTS))

Problems = Iterator[tuple[tuple[str | int, ...], str]]
Own = TypeVar("Own", bound="Trajectory")


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


def limit_key(limit: str, unit: str, spans: bool = False) -> Any:
    """Declare a key with a limit of each joint. spans : it may differ by direction."""
    item = SPAN if spans else Number(minimum=0.0, exclusive=True)
    other = ", or [least, largest]" if spans else ""
    return key(
        JointMap(item, coordinates="v"),
        default=None,
        unit=unit,
        doc=f"Largest {limit} of each joint, either way{other}; by default that in its `limits`.",
    )


def relative_key() -> Any:
    """Declare the key of the frame in which a path is given."""
    return key(
        Text(),
        default=None,
        doc="The frame in which the path is given: a named frame or point of the base or of a link, which may move; "
        "default: the world.",
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
        JointMap(Number()),
        default=None,
        unit="rad or m",
        doc="Start of Newton's method at t = 0.",
    )
    redundancy: str = key(
        Choice(("least_rates", "away_from_limits", "least_torque")),
        default="least_rates",
        doc="Use of a redundant arm's freedom along the path.",
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


class Lacks(IntEnum):
    """What has to be found before a trajectory is a motion of joints in time; false where that is nothing."""

    NOTHING = 0
    JOINTS = 1  # it leads a point
    TIMES = 2  # they follow from the dynamics
    PARTS = 3  # it is a sequence of motions, some of which lack something


class Trajectory:
    """What every trajectory answers, with the answers of most. It has no fields, so that records derive from it.

    lacks : what has to be found before it is a motion of joints in time. least_time : whether its times, or those of a
    part, follow from the dynamics. point, relative_to, ik : what it leads, in which coordinates, and the options of the
    inverse kinematics that finds the joints. scaling : how its times were found. A field of the same name wins.
    """

    lacks: Lacks = Lacks.NOTHING
    least_time: bool = False
    point: str | None = None
    relative_to: str | None = None
    ik: Ik | None = None
    scaling: Scaling | None = None

    if TYPE_CHECKING:  # a field, or a property, of each kind

        @property
        def duration(self) -> float: ...

    @property
    def in_time(self) -> bool:
        """Whether it is a motion in time as it stands, of joints or of a point."""
        return self.lacks <= Lacks.JOINTS

    @property
    def places(self) -> tuple[str, ...]:
        """The places that it names: the point that it leads, and in whose coordinates."""
        return tuple(x for x in (self.point, self.relative_to) if x is not None)

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives; those of attitudes in any form. () where that is to be found."""
        return ()

    @property
    def knots(self) -> tuple[float, ...] | None:
        """Times at which an acceleration, or a rate of it, jumps; None where that is not known beforehand."""
        return None

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        return iter(())

    def completed(self: Own, scene: SceneNames) -> Own:
        """Return the trajectory with the limits of the joints where it gives none of its own."""
        return self

    def at_constant_speed(self: Own) -> Own:
        """Return the path, where it has a time law of its own, without it: its length is linear in time."""
        return self


class TaskSpaceTrajectory(Trajectory):
    """Base of the trajectories that say where a named point should be, or a frame there."""

    lacks = Lacks.JOINTS
    point: str
    ik: Ik

    def problems(self, scene: SceneNames) -> Problems:
        """Report a point, or a frame of reference, that does not exist or does not move, and guesses of no joint."""
        unknown = scene.point_problem(self.point)
        if unknown is not None:
            yield ("point",), unknown
        guessed = tuple(self.ik.guess)
        if guessed:
            needed = led_joints(guessed, scene)
            yield from joint_problems(guessed, scene.joints, ("ik", "guess"), needed)
        if self.relative_to is None:
            return
        problem = scene.point_problem(self.relative_to)
        if problem is None and unknown is None and not scene.moves(self.point, self.relative_to):
            problem = (
                f"no joint moves {self.point!r} against {self.relative_to!r}; allowed: a place on the base or on "
                "another link"
            )
        if problem is not None:
            yield ("relative_to",), problem

    def target(self, times: Array, parameters: Mapping[str, float]) -> PointMotion | PoseMotion:
        """Return what is asked of the point, or of the frame there, at ``times`` (T,).

        In the coordinates of the place ``relative_to``, which may move; by default the world's. parameters : of the
        scene.
        """
        raise NotImplementedError


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


def limit_problems(given: Mapping[str, Mapping[str, Span]], scene: SceneNames) -> Problems:
    """Report limits of a trajectory, by kind and joint, that are of no joint or above the joint's own."""
    for name, values in given.items():
        yield from joint_problems(tuple(values), scene.rates, (name,), ())
        for joint, x in values.items():
            if fault := span_fault(x, with_zero=name != "effort"):
                yield (name, joint), fault
            own = getattr(scene.limits(joint), name, None)
            if own is not None and (sides(x)[0] < sides(own)[0] or sides(x)[1] > sides(own)[1]):
                allowed = f"within {span_text(own)}" if isinstance(own, tuple) else f"up to {span_text(own)}"
                yield (name, joint), f"{span_text(x)} is above the joint's own limit; allowed: {allowed}"


def with_joint_limits(
    given: Mapping[str, Mapping[str, Span]], scene: SceneNames, spans: bool = False
) -> dict[str, Any]:
    """Return limits of a trajectory, by kind and joint, with those of the joints where it gives none of its own.

    spans : they may differ by direction; otherwise what is allowed in both counts.
    """
    limits = {}
    for name, values in given.items():
        own = {joint: getattr(scene.limits(joint), name, None) for joint in scene.rates}
        known = {joint: x if spans else either_way(x) for joint, x in own.items() if x is not None}
        limits[name] = known | dict(values)
    return limits


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
    problems = list(joint_problems(names, scene.columns, path, wanted))
    yield from problems
    if problems:
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

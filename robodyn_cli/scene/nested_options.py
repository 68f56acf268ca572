"""Sections that few scenes have: masses that links pick up and release, and what is nested in the options of commands;
imported for scenes that have them."""

from __future__ import annotations

from typing import Any

from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.expr.statements import Expectation, Variation
from robodyn_cli.record import record
from robodyn_cli.scene.robot_types import Inertia, Orientation
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Criteria,
    Direction,
    Either,
    Formula,
    Integer,
    JointMap,
    ListOf,
    MapOf,
    Name,
    Number,
    Section,
    Text,
    Variations,
    Vector,
    key,
)
from robodyn_cli.trajectories.base import BRANCHES


@record
class Instant:
    """A time, or an event: what a motion comes to by itself."""

    time: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="s", doc="A time of the run."
    )
    when: FormulaTree | None = key(
        Formula(),
        default=None,
        doc="Or an event: a formula of t, q and qd; it happens where its value rises through zero.",
    )


@record
class LandingPlane:
    """The plane in the world to which a released payload comes down."""

    through: tuple[float, ...] = key(
        Vector(3), default=(0.0, 0.0, 0.0), unit="m", doc="A point of it; default: the world's origin."
    )
    normal: tuple[float, ...] | None = key(
        Direction(),
        default=None,
        unit="1",
        doc="Its normal, on whose side the payload flies; default: against gravity.",
    )


@record
class Payload:
    """A rigid body that a link carries for a while."""

    name: str = key(Name(of="payload"), doc="Name.")
    at: str = key(
        Text(),
        doc="What holds it: a named point or frame, LINK.origin, LINK.end or LINK.com. `com` and `inertia` are in the "
        "axes of that frame, of the link where it is a point.",
    )
    mass: float = key(Number(minimum=0.0), unit="kg", doc="Mass.")
    com: tuple[float, ...] = key(
        Vector(3), default=(0.0, 0.0, 0.0), unit="m", doc="Centre of mass, from `at`."
    )
    inertia: Inertia = key(Section(Inertia), default=Inertia(), doc="About its centre of mass.")
    start: Instant | None = key(
        Section(Instant),
        default=None,
        name="from",
        doc="When it is gripped; without this key it is carried from the start.",
    )
    until: Instant | None = key(Section(Instant), default=None, doc="When it is released.")
    plane: LandingPlane | None = key(
        Section(LandingPlane),
        default=None,
        name="range",
        doc="Where its flight ends after the release: its centre of mass comes down to this plane.",
    )
    velocity: tuple[float, ...] = key(
        Vector(3),
        default=(0.0, 0.0, 0.0),
        unit="m/s",
        doc="Velocity of its centre of mass, in world axes, up to the time at which it is gripped.",
    )
    angular_velocity: tuple[float, ...] = key(
        Vector(3), default=(0.0, 0.0, 0.0), unit="rad/s", doc="Its angular velocity then, in world axes."
    )

    @property
    def changes(self) -> bool:
        """Whether it is gripped or released on the way."""
        return self.start is not None or self.until is not None

    @property
    def instants(self) -> dict[str, Instant]:
        """When it is gripped and released, as far as that happens, by key."""
        by_key = {"from": self.start, "until": self.until}
        return {name: instant for name, instant in by_key.items() if instant is not None}


@record
class LoadLimit:
    """What a joint or a closure may bear."""

    force: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="N", doc="Largest force."
    )
    moment: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="N m", doc="Largest moment."
    )


@record
class Sweep:
    """One joint that goes from one position to another at a constant rate."""

    joint: str = key(Name(of="joint"), doc="The joint that is swept.")
    start: float = key(Number(), unit="rad or m", doc="Where it begins.")
    stop: float = key(Number(), unit="rad or m", doc="Where it ends.")
    rate: float = key(Number(minimum=0.0, exclusive=True), default=1.0, unit="rad/s or m/s", doc="Its speed.")


@record
class ReachOptions:
    """The pose of ``reach``, and what decides between the ways to reach it."""

    frame: str = key(Text(), doc="Frame to bring there: a named point or frame, a link, or `LINK.end`.")
    position: tuple[float, ...] | None = key(
        Vector(3), default=None, unit="m", doc="Where its origin is to be, in the world; free without it."
    )
    components: str = key(
        Choice(("xyz", "xy", "xz", "yz", "x", "y", "z")),
        default="xyz",
        doc="The components of `position` that are asked for.",
    )
    orientation: Orientation | None = key(
        Section(Orientation), default=None, doc="How its axes are to be turned in the world; free without it."
    )
    axis: tuple[float, ...] | None = key(
        Direction(),
        default=None,
        unit="1",
        doc="A direction in the frame, of which alone the orientation matters: the frame may turn about it.",
    )
    branch: str | None = key(Choice(BRANCHES), default=None, doc="The branch of the arm's closed form.")
    criterion: str = key(
        Choice(("nearest", "away_from_limits", "least_torque")),
        default="nearest",
        doc="Criterion between several ways: nearest to `initial.q`, else to the middle of the limits.",
    )
    limits: bool = key(Boolean(), default=True, doc="Whether the joints' limits are respected.")


@record
class Motorisation:
    """Factors of a margin of motorisation, which kinds of resistance stand outside of it, and what is required.

    Kinds are the roles of forces, and ``drive_inertia``: the inertia of a given motion.
    """

    factors: dict[str, float] = key(
        MapOf(Number(minimum=0.0), of="role"),
        default=None,
        unit="1",
        doc="Factor of each kind of resistance, 1 by default: the roles of forces, and `drive_inertia`, what a "
        "given motion needs to be accelerated.",
    )
    outside: dict[str, float] = key(
        MapOf(Number(minimum=0.0), of="role"),
        default=None,
        unit="1",
        doc="Kinds that are taken from the torque available instead, each with its factor, and not multiplied by "
        "`required`.",
    )
    required: float = key(
        Number(minimum=0.0, exclusive=True), default=1.0, unit="1", doc="Least ratio that is required."
    )
    joints: tuple[str, ...] = key(
        ListOf(Text()),
        default=(),
        doc="Driven joints (or coordinates) that ratios are given for; by default those that what drives acts on, in "
        "loops as many as there are degrees of freedom.",
    )


@record
class Latch:
    between: tuple[str, ...] = key(
        ListOf(Name(of="link"), minimum=2, maximum=2), doc="The two links it fixes."
    )
    at: dict[str, float] = key(
        JointMap(Number(), minimum=1),
        default=None,
        unit="rad or m",
        doc="Position of one joint at which it closes, for `criterion: latch`.",
    )
    at_limit: dict[str, str] = key(
        JointMap(Choice(("lower", "upper")), minimum=1),
        default=None,
        doc="Or: the limit of one joint at which it closes, such as a stop.",
    )


@record
class LatchSpring:
    """How a latch gives way once it has closed: a spring and a damper on the far side of its position."""

    stiffness: float = key(
        Number(minimum=0.0, exclusive=True), unit="N m/rad or N/m", doc="Stiffness k beyond the position."
    )
    damping: float = key(Number(minimum=0.0), default=0.0, unit="N m s/rad or N s/m", doc="Damping c there.")


CONDITIONS = ("at", "at_limit", "at_dead_point", "when")


@record
class DeployLatch:
    """One of several latches: what it holds, when it closes, and when it opens again."""

    name: str = key(Name(of="latch"), doc="Name.")
    joint: str | None = key(
        Text(), default=None, doc="Joint that it holds; `JOINT.COORDINATE` of one with several."
    )
    between: tuple[str, ...] | None = key(
        ListOf(Name(of="link"), minimum=2, maximum=2),
        default=None,
        doc="Or the two links that it fixes to each other, which a joint of one axis or a closure of type `revolute` "
        "joins.",
    )
    at: Any = key(
        Either((Number(), JointMap(Number(), minimum=1))),
        default=None,
        unit="rad or m",
        doc="Position at which it closes: of its own `joint`, or {JOINT: POSITION} of another.",
    )
    at_limit: dict[str, str] = key(
        JointMap(Choice(("lower", "upper")), minimum=1),
        default=None,
        doc="Or the limit of a joint at which it closes.",
    )
    at_dead_point: bool = key(Boolean(), default=False, doc="Or: it closes in a dead point of the input.")
    when: FormulaTree | None = key(
        Formula(), default=None, doc="Or a formula of t, q and qd: it closes where its value passes zero."
    )
    side: str = key(
        Choice(("either", "up", "down")),
        default="either",
        doc="The way in which the position or the formula has to pass: rising (`up`), falling (`down`).",
    )
    hold: Any = key(
        Either((Choice(("rigid",)), Section(LatchSpring))),
        default="rigid",
        doc="`rigid`: what it holds moves no more; or a spring and damper that never pull.",
    )
    release: FormulaTree | None = key(
        Formula(),
        default=None,
        doc="It opens where the value of this formula of t, q and qd rises through zero; it may close again.",
    )

    @property
    def conditions(self) -> tuple[str, ...]:
        """The keys that say when it closes, of which there is to be one."""
        given = {name: getattr(self, name) for name in CONDITIONS}
        return tuple(name for name, x in given.items() if x is not None and x is not False and x != {})

    def position(self, robot: Any) -> tuple[str, float]:
        """Return the coordinate whose position closes it, and that position [rad or m]."""
        if isinstance(self.at, float):
            return str(self.joint), self.at
        if self.at:
            ((name, at),) = self.at.items()
            return name, at
        ((name, side),) = self.at_limit.items()
        return name, getattr(robot.limits_of(name), side)


@record
class Correlation:
    """Two keys of a study that do not vary independently of one another."""

    between: tuple[str, ...] = key(ListOf(Text(), minimum=2, maximum=2), doc="Two keys under `vary`.")
    value: float = key(
        Number(minimum=-1.0, maximum=1.0, exclusive=True),
        unit="1",
        doc="Correlation of their normal scores (a Gaussian copula).",
    )


@record
class SearchOptions:
    """What ``optimise`` looks for."""

    vary: dict[str, Variation] = key(
        Variations(),
        default=None,
        doc="Keys of the scene, as `--set` writes them, each with its bounds, `uniform(low, high)`, or with the values "
        "that it may take: `[a, b]`, `linspace(a, b, n)`, `logspace(a, b, n)`.",
    )
    minimise: str | None = key(Text(), default=None, doc="Output that is to be least: a key of the summary.")
    maximise: str | None = key(Text(), default=None, doc="Or: output that is to be largest.")
    reach: dict[str, Expectation] = key(
        Criteria(),
        default=None,
        doc="Or: outputs and the values that they are to have, `value` or `value +- tolerance`.",
    )
    keep: dict[str, Expectation] = key(
        Criteria(),
        default=None,
        doc="Constraints: outputs and what holds of them, `<= value`, `>= value` or `a .. b`; those of `expect` too.",
    )
    starts: int = key(
        Integer(minimum=1, maximum=10_000),
        default=4,
        doc="Points from which the search begins, of each combination of values: the scene as it stands, and points of "
        "a Sobol sequence.",
    )
    seed: int = key(Integer(minimum=0), default=0, doc="Seed of the sequence.")


@record
class KinematicDesign:
    """What kinematic design asks of a mechanism that moves in a plane."""

    grashof: bool = key(
        Boolean(),
        default=False,
        doc="Class of each closed chain of four links by Grashof, its inversions, and the dead points of its joints.",
    )
    poles: dict[str, tuple[str, ...]] = key(
        MapOf(ListOf(Name(of="link"), minimum=2, maximum=2), of="pair"),
        default=None,
        doc="Pairs of links, by names of your own: pole, centrodes and acceleration pole of the first as seen from the "
        "second.",
    )
    curves: tuple[str, ...] = key(
        ListOf(Text()), default=(), doc="Points whose paths have their curvature told."
    )
    ratios: dict[str, tuple[str, ...]] = key(
        MapOf(ListOf(Text(), minimum=2, maximum=2), of="ratio"),
        default=None,
        doc="Pairs of joints, or of links, by names of your own: rate of the first over that of the second.",
    )
    pressure: dict[str, tuple[str, ...]] = key(
        MapOf(ListOf(Text(), minimum=2, maximum=2), of="pressure angle"),
        default=None,
        doc="Pairs of points A and B, by names of your own: angle between a force along AB and the way of B.",
    )


@record
class Flywheel:
    """The flywheel that keeps a joint near a constant rate."""

    joint: str = key(Text(), doc="Joint that turns at a constant rate, on whose shaft the flywheel is.")
    fluctuation: float = key(
        Number(minimum=0.0, exclusive=True, maximum=2.0),
        unit="1",
        doc="Coefficient of fluctuation that is wanted: (largest less smallest rate) over their mean.",
    )

"""What the kinds of controller share: their common keys, and what a law may ask of its surroundings.

A controller is a frozen record whose fields are its YAML keys. Its law is written once, on scalars of any sort: a
simulation evaluates it at every instant, or as one compiled program at each sampling period.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

from robodyn_cli.control.design import ControlDesign, Leading
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.record import record
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Either,
    Integer,
    ListOf,
    MapOf,
    Name,
    Number,
    OrFile,
    Section,
    Settings,
    Tagged,
    key,
)
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.registry import trajectory_types

Problems = Iterator[tuple[tuple[str | int, ...], str]]
PER_JOINT = Either((Number(minimum=0.0), MapOf(Number(minimum=0.0), of="joint")))
POSITIVE_PER_JOINT = Either(
    (Number(minimum=0.0, exclusive=True), MapOf(Number(minimum=0.0, exclusive=True), of="joint"))
)


def gain(unit: str, doc: str, default: Any = 0.0) -> Any:
    """Declare a gain: one number for all joints, or a map by joint."""
    return key(PER_JOINT, default=default, unit=unit, doc=doc)


@record
class Sensors:
    """How a sampled controller sees the joints."""

    resolution: Any = key(
        POSITIVE_PER_JOINT,
        default=None,
        unit="rad or m",
        doc="Step of the encoders: positions are rounded to its multiples.",
    )
    noise: Any = key(
        PER_JOINT, default=0.0, unit="rad or m", doc="Standard deviation of the noise of positions."
    )
    rate_noise: Any = key(
        PER_JOINT, default=0.0, unit="rad/s or m/s", doc="Standard deviation of the noise of measured rates."
    )
    rates: str = key(
        Choice(("measured", "differences")),
        default="measured",
        doc="Rates come from sensors of their own, or are differences of positions over a period.",
    )
    seed: int = key(Integer(minimum=0), default=0, doc="Seed of the noise.")

    @property
    def noisy(self) -> bool:
        """Whether there is any noise."""
        return any(_any_positive(x) for x in (self.noise, self.rate_noise))

    @property
    def exact(self) -> bool:
        """Whether it sees positions and rates as they are at its samples."""
        return not (self.noisy or self.resolution or self.rates != "measured")


def _any_positive(x: Any) -> bool:
    return any(v > 0.0 for v in x.values()) if isinstance(x, dict) else x > 0.0


@record
class OwnModel:
    """The model that the controller computes with, where it is not the mechanism itself."""

    set: dict[str, str] = key(
        Settings(),
        default=None,
        doc="Keys of the scene, as `--set` writes them, and the values in the model.",
    )
    friction: bool = key(
        Boolean(), default=True, doc="Whether the model has springs, dampers and friction of the joints."
    )


class ControlLaw:
    """What every kind of controller answers, with the answers of most. A field of the same name wins.

    numbers : fields whose values are numbers of the compiled code's table. shares : whether the driven joints of a
    mechanism with loops share a load, so that they must command all its freedoms. whole : whether the law needs to
    drive every joint of an open chain. at_point : whether it follows a point. follows : whether it follows a motion.
    reference : the motion that it follows, where it follows any. pose : positions by joint that it holds, where it
    names any. law, state : formulas of torques and states by name. call : gives the torques for t, q and v where a
    function in Python does.
    """

    numbers: ClassVar[tuple[str, ...]] = ("gains", "limit", "rate_limit", "sensors", "period", "directions")
    shares: ClassVar[bool] = False
    whole: ClassVar[bool] = False
    at_point: ClassVar[bool] = False
    follows: ClassVar[bool] = False
    reference: Any = None
    pose: Mapping[str, float] = MappingProxyType({})
    law: Mapping[str, Any] = MappingProxyType({})
    state: Mapping[str, Any] = MappingProxyType({})
    call: Callable[[float, Array, Array], Array] | None = None

    def problems(self) -> Problems:
        """Report what single keys cannot tell, as (path below ``control``, message)."""
        yield from ()

    def written(self, of: Leading) -> ControlDesign | None:
        """Return the gains that its keys give, as a matrix; None of a law without such gains."""
        return None

    def states(self, joints: Sequence[str]) -> list[tuple[str, float]]:
        """Return names and initial values of the law's own states, where it drives these joints."""
        return []

    def torques(self, at: Situation) -> list[Any]:
        """Return the torques (n,) of the law on the joints that it drives, before any limit [N m or N]."""
        raise NotImplementedError

    def rates(self, at: Situation, asked: Sequence[Any], given: Sequence[Any]) -> list[Any]:
        """Return the rates of its states; ``asked`` : what the law gave, ``given`` : what the limits leave of it."""
        return []

    def updated(self, at: Situation, asked: Sequence[Any], given: Sequence[Any], period: float) -> list[Any]:
        """Return the states after a sampling period: by Euler's method, unless a kind knows better."""
        return [s + period * rate for s, rate in zip(at.states, self.rates(at, asked, given))]


@record
class Controller(ControlLaw):
    """The keys that all kinds share.

    directions : (n, f) numbers of more driven joints than freedoms f, see ``DrivenJoints``. design : what it is, where
    that is found out before the equations are built.
    """

    joints: tuple[str, ...] | None = key(
        ListOf(Name(of="joint")),
        default=None,
        doc="Joints that it drives; by default `actuated`, or else all that are not prescribed.",
    )
    period: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="s",
        doc="Sampling period; the torques are held in between. Without it the law acts at every instant.",
    )
    delay: float = key(
        Number(minimum=0.0),
        default=0.0,
        unit="s",
        doc="Time from a sample to the torques that follow from it.",
    )
    model: OwnModel = key(
        Section(OwnModel), default=OwnModel(), doc="Where the controller's model differs from the mechanism."
    )
    limit: Any = key(
        POSITIVE_PER_JOINT,
        default=None,
        unit="N m or N",
        doc="Largest torque, either way; by default the joints' own `limits.effort`.",
    )
    rate_limit: Any = key(
        POSITIVE_PER_JOINT, default=None, unit="N m/s or N/s", doc="Largest change of the torque in a second."
    )
    sensors: Sensors = key(Section(Sensors), default=Sensors(), doc="How it sees the joints.")
    directions: Any = dataclasses.field(default=None, compare=False, repr=False)
    design: Any = dataclasses.field(default=None, compare=False, repr=False)


@record
class Follower(Controller):
    """A controller that follows a motion."""

    follows: ClassVar[bool] = True

    reference: Any = key(
        OrFile(Tagged(lambda: trajectory_types)),
        default=None,
        doc="Motion to follow; by default `trajectory`, or else the pose at the start.",
    )


class Situation(Protocol):
    """What a law sees at an instant. Lists (n,) belong to the joints that it drives, in their order.

    t : time [s]. joints : names. q, qd : measured positions and rates. reference : (q, qd, qdd) to follow.
    states : of the law. names : all values by the names that formulas have for them.
    """

    t: Scalar
    joints: tuple[str, ...]
    q: list[Any]
    qd: list[Any]
    reference: tuple[list[Any], list[Any], list[Any]]
    states: list[Any]

    def each(self, value: Any, name: str) -> list[Any]:
        """Return a gain for each joint; ``name`` : its key below ``control``."""
        ...

    def names(self) -> dict[str, Any]:
        """Return what formulas may ask for, by name."""
        ...

    def seen_of(self, name: str) -> tuple[Any, Any]:
        """Return measured position and rate of any joint of one coordinate."""
        ...

    def inverse_dynamics(self, accelerations: Sequence[Any]) -> list[Any]:
        """Return the model's torques that give the driven joints accelerations (n,) where they are measured to be;
        those of springs and friction included."""
        ...

    def feed_forward(self) -> list[Any]:
        """Return the same torques for the reference itself."""
        ...

    def gravity(self) -> list[Any]:
        """Return the model's torques that hold it where it is measured to be."""
        ...

    def point(self) -> PointTask:
        """Return the point that the reference leads."""
        ...


@record
class PointTask:
    """A point in world coordinates: where it is and how fast, and where it should be [m, m/s].

    torques : from a force on it (m,) to torques (n,): J^T F, in a mechanism with loops the share of the driven joints.
    """

    p: list[Any]
    pd: list[Any]
    wanted: list[Any]
    wanted_rate: list[Any]
    torques: Any


def tracking(at: Situation, kp: Any, kd: Any) -> list[Any]:
    """Return kp e + kd e-dot (n,) of the errors e = q_ref - q."""
    q, qd, _ = at.reference
    stiff, damped = at.each(kp, "gains.kp"), at.each(kd, "gains.kd")
    return [k * (r - x) + d * (rd - xd) for k, d, r, rd, x, xd in zip(stiff, damped, q, qd, at.q, at.qd)]

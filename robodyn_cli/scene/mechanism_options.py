"""Options of the commands that look at a mechanism without integrating it: their keys in the scene."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.scene.robot_types import Orientation
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Direction,
    Integer,
    ListOf,
    Name,
    Number,
    Section,
    Text,
    Vector,
    key,
)
from robodyn_cli.trajectories.base import BRANCHES


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
    start: float = key(Number(angle=True), unit="rad or m", doc="Where it begins.")
    stop: float = key(Number(angle=True), unit="rad or m", doc="Where it ends.")
    rate: float = key(
        Number(minimum=0.0, exclusive=True, angle=True), default=1.0, unit="rad/s or m/s", doc="Its speed."
    )


@record
class KinematicsOptions:
    """Options of ``kinematics``."""

    sweep: Sweep | None = key(
        Section(Sweep),
        default=None,
        doc="Motion of one joint; without it, `trajectory` or `prescribed` moves.",
    )
    samples: int = key(Integer(minimum=2, maximum=100_000_000), default=361, doc="Number of uniform samples.")
    transmission: tuple[str, ...] | None = key(
        ListOf(Text(), minimum=3, maximum=3),
        default=None,
        doc="Three points A, B, C: the transmission angle is the one at B between BA and BC.",
    )


@record
class AssembleOptions:
    """Options of ``assemble``."""

    branches: bool = key(Boolean(), default=False, doc="Find all the ways in which the loops close.")
    starts: int = key(
        Integer(minimum=1, maximum=1_000_000), default=400, doc="Starts of the search for branches, at most."
    )


@record
class ReachOptions:
    """The pose of ``reach``, and what decides between the ways to reach it."""

    frame: str = key(Text(), doc="What is brought there: a named point or frame, a link, or `LINK.end`.")
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
        doc="What decides between several ways: nearest to `initial.q`, else to the middle of the limits.",
    )
    limits: bool = key(Boolean(), default=True, doc="Whether the joints' limits are respected.")


@record
class StaticsOptions:
    """Options of ``statics``."""

    find: str = key(
        Choice(("balance", "hold")),
        default="balance",
        doc="`balance`: the configuration in which all forces balance; `hold`: the torques that hold the given one.",
    )

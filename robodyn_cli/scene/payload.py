"""Masses that links pick up and release: their keys in the scene; imported for scenes that have them."""

from __future__ import annotations

from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.record import record
from robodyn_cli.scene.robot_types import Inertia
from robodyn_cli.schema.fields import Formula, Name, Number, Section, Text, Vector, key


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
        found = {"from": self.start, "until": self.until}
        return {name: instant for name, instant in found.items() if instant is not None}

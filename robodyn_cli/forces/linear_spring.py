"""Linear spring and damper along the line between two points."""

from __future__ import annotations

from collections.abc import Iterable

from robodyn_cli.forces.element import Between, Effect, End, Line, Setting, along, between_key, idle_problems
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, Number, key
from robodyn_cli.spatial.algebra import dot


@record
class LinearSpring(Between):
    """Tension ``k (l - l0) + c dl/dt`` along the line between two points; potential energy ``k (l - l0)^2 / 2``."""

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("spring",)), doc="Kind of force.")
    between: tuple[str, ...] = between_key()
    stiffness: float = key(Number(minimum=0.0), default=0.0, unit="N/m", doc="Stiffness k.")
    length: float = key(
        Number(minimum=0.0), default=0.0, unit="m", doc="Length l0 at which the spring is free of force."
    )
    damping: float = key(Number(minimum=0.0), default=0.0, unit="N s/m", doc="Damping c.")

    def problems(self) -> Iterable[tuple[tuple[str, ...], str]]:
        return idle_problems(self.stiffness, self.damping)

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return forces, energy and power; the direction is lost where the points meet and ``length`` is not 0."""
        k, c = self.stiffness, self.damping
        if self.length == 0.0 and c == 0.0:
            # without a free length the force is linear in the distance and needs no direction
            d = ends[1].p - ends[0].p
            return Effect(along(d * k), 0.5 * k * dot(d, d))
        line = Line.of(ends)
        stretch = line.length - self.length
        loss = c * line.rate
        return Effect(line.pull(k * stretch + loss), 0.5 * k * stretch * stretch, -loss * line.rate)

"""Constant-force spring: the same tension at any length."""

from __future__ import annotations

from robodyn_cli.forces.element import Between, Effect, End, Line, Setting, between_key
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, Number, key


@record
class ConstantForce(Between):
    """Constant tension ``F`` along the line between two points; potential energy ``F l``."""

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("constant_force",)), doc="Kind of force.")
    between: tuple[str, ...] = between_key()
    force: float = key(Number(), unit="N", doc="Tension; positive pulls the points together.")

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return forces and energy; the direction is lost where the points meet."""
        line = Line.of(ends)
        return Effect(line.pull(self.force), self.force * line.length)

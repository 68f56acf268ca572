"""Weld that closes a loop."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import aligned, attitude_key, between_key, coincident
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class FixedLoop(LoopClosure):
    """Two links welded together: the points coincide and the links do not turn relative to each other."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("fixed",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    rpy: tuple[float, ...] = attitude_key()

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the six scalar constraints."""
        return [*coincident(self.name, first, second), *aligned(self.name, self.rpy, first, second)]

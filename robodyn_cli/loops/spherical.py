"""Ball joint that closes a loop."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import between_key, coincident
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class SphericalLoop(LoopClosure):
    """A ball between two links: the points coincide."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("spherical",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the three scalar constraints."""
        return coincident(self.name, first, second)

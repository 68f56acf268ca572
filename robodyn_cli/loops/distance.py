"""Massless bar: two points at a constant distance."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import between_key, distance
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, Number, key


@record
class DistanceLoop(LoopClosure):
    """A massless bar with a ball at each end: the points keep their distance."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("distance",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    length: float = key(Number(minimum=0.0, exclusive=True), unit="m", doc="Distance of the points.")

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the scalar constraint."""
        return [distance(f"{self.name}.length", self.length, first, second)]

"""Point on a plane."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import axis_key, between_key, direction, offset
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class PointOnPlaneLoop(LoopClosure):
    """The second point stays in a plane of the first link."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("point_on_plane",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    axis: tuple[float, ...] = axis_key(
        "Normal of the plane through the first point, in the first link's frame.", default=(0.0, 0.0, 1.0)
    )

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the scalar constraint."""
        return [offset(f"{self.name}.normal", direction(first, self.axis), first, second)]

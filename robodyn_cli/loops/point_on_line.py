"""Point on a line."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import axis_key, between_key, on_line
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class PointOnLineLoop(LoopClosure):
    """The second point stays on a line of the first link."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("point_on_line",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    axis: tuple[float, ...] = axis_key(
        "Direction of the line through the first point, in the first link's frame.", default=(0.0, 0.0, 1.0)
    )

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the two scalar constraints."""
        return on_line(self.name, self.axis, first, second)

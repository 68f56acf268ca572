"""Slider that closes a loop."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import aligned, attitude_key, axis_key, between_key, on_line
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class PrismaticLoop(LoopClosure):
    """The second link slides along an axis of the first and does not turn relative to it."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("prismatic",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    axis: tuple[float, ...] = axis_key(
        "Direction of sliding, through the first point, in the first link's frame.", default=(0.0, 0.0, 1.0)
    )
    rpy: tuple[float, ...] = attitude_key()

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the five scalar constraints."""
        line = on_line(self.name, self.axis, first, second)
        return [*line, *aligned(self.name, self.rpy, first, second)]

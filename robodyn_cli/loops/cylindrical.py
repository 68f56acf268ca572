"""Sliding and turning joint that closes a loop."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import axis_key, between_key, on_line, parallel
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class CylindricalLoop(LoopClosure):
    """The second link slides along an axis of the first and turns about it: the two axes are one line."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("cylindrical",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    axis: tuple[float, ...] = axis_key(
        "Axis through the first point, in the first link's frame.", default=(0.0, 0.0, 1.0)
    )
    axis2: tuple[float, ...] | None = axis_key(
        "Axis through the second point, in the second link's frame; default: the same components.",
        default=None,
    )

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the four scalar constraints."""
        found = on_line(self.name, self.axis, first, second)
        return [*found, *parallel(self.name, self.axis, self.axis2, first, second)]

"""Plane-on-plane joint that closes a loop."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import axis_key, between_key, direction, offset, parallel
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class PlanarLoop(LoopClosure):
    """A plane of the second link stays in a plane of the first: it slides and turns about the normal."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("planar",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    axis: tuple[float, ...] = axis_key(
        "Normal of the plane through the first point, in the first link's frame.", default=(0.0, 0.0, 1.0)
    )
    axis2: tuple[float, ...] | None = axis_key(
        "Normal in the second link's frame; default: the same components.", default=None
    )

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the three scalar constraints."""
        level = offset(f"{self.name}.normal", direction(first, self.axis), first, second)
        return [level, *parallel(self.name, self.axis, self.axis2, first, second)]

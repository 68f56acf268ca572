"""Pin joint that closes a loop."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import axis_key, between_key, coincident, parallel
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class RevoluteLoop(LoopClosure):
    """A pin between two links: the points coincide and the axes are parallel.

    Rows of eta: point on the first link minus point on the second (3), then the components of the second axis
    along two directions of the first link across its axis (2). Rows that vanish identically, as in a planar
    mechanism, are left out of the equations.
    """

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("revolute",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    axis: tuple[float, ...] = axis_key("Pin axis in the first link's frame.", default=(0.0, 0.0, 1.0))
    axis2: tuple[float, ...] | None = axis_key(
        "Pin axis in the second link's frame; default: the same components.", default=None
    )

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the five scalar constraints."""
        found = coincident(self.name, first, second)
        return [*found, *parallel(self.name, self.axis, self.axis2, first, second)]

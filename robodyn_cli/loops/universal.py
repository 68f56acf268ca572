"""Universal (Cardan) joint that closes a loop."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import axis_key, between_key, coincident, direction, perpendicular
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Name, key


@record
class UniversalLoop(LoopClosure):
    """The points coincide, and an arm of the cross in each link: the two arms are perpendicular."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("universal",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    axis: tuple[float, ...] = axis_key("Arm of the cross in the first link's frame.")
    axis2: tuple[float, ...] = axis_key("Arm of the cross in the second link's frame.")

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the four scalar constraints."""
        arms = direction(first, self.axis), direction(second, self.axis2)
        return [
            *coincident(self.name, first, second),
            perpendicular(f"{self.name}.arms", *arms, first, second),
        ]

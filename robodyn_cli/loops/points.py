"""Points that close a loop: at a constant distance, on a line, on a plane."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import axis_key, between_key, direction, distance, offset, on_line
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

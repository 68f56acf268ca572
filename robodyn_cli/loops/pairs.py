"""Joints that close a loop: lower pairs, the Cardan joint and the weld."""

from __future__ import annotations

from robodyn_cli.loops.base import LoopClosure, LoopFrame, Row
from robodyn_cli.loops.pieces import (
    aligned,
    attitude_key,
    axis_key,
    between_key,
    coincident,
    direction,
    offset,
    on_line,
    parallel,
    perpendicular,
)
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
        rows = coincident(self.name, first, second)
        return [*rows, *parallel(self.name, self.axis, self.axis2, first, second)]


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
        rows = on_line(self.name, self.axis, first, second)
        return [*rows, *parallel(self.name, self.axis, self.axis2, first, second)]


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


@record
class SphericalLoop(LoopClosure):
    """A ball between two links: the points coincide."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("spherical",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the three scalar constraints."""
        return coincident(self.name, first, second)


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


@record
class FixedLoop(LoopClosure):
    """Two links welded together: the points coincide and the links do not turn relative to each other."""

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("fixed",)), doc="Kind of closure.")
    between: tuple[str, ...] = between_key()
    rpy: tuple[float, ...] = attitude_key()

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the six scalar constraints."""
        return [*coincident(self.name, first, second), *aligned(self.name, self.rpy, first, second)]

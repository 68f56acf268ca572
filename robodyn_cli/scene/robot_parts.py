"""Parts of a robot that few scenes have: shapes to draw, couplers; imported for scenes that have them."""

from __future__ import annotations

from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.record import record
from robodyn_cli.schema.fields import (
    Formula,
    ListOf,
    MapOf,
    MeshFile,
    Name,
    Number,
    Placement,
    Section,
    Text,
    Vector,
    key,
)


@record
class Shape:
    """A shape that a link is drawn with: one of `box`, `sphere`, `cylinder`, `outline`, `mesh` and `obj`."""

    box: tuple[float, ...] | None = key(
        Vector(3), default=None, unit="m", doc="Sides of a cuboid, whose centre is the origin."
    )
    sphere: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="m",
        doc="Radius of a sphere about the origin.",
    )
    cylinder: tuple[float, ...] | None = key(
        Vector(2), default=None, unit="m", doc="Radius, and length along z, of a cylinder about the origin."
    )
    outline: tuple[tuple[float, ...], ...] | None = key(
        ListOf(Vector(2), minimum=3),
        default=None,
        unit="m",
        doc="Corners x, y of a plate in the x-y plane, one after another around it.",
    )
    thickness: float = key(
        Number(minimum=0.0), default=0.0, unit="m", doc="Thickness of an `outline`, along z."
    )
    mesh: str | None = key(
        MeshFile(), default=None, doc="Path of a mesh, relative to the file that names it: STL, OBJ or DAE."
    )
    obj: str | None = key(
        Text(), default=None, doc="A mesh as text: lines `v x y z` and `f i j k`, as in OBJ files."
    )
    scale: tuple[float, ...] = key(
        Vector(3), default=(1.0, 1.0, 1.0), unit="1", doc="Factors of the coordinates of a mesh."
    )
    origin: Placement | None = key(
        Section(Placement), default=None, doc="Placement of the shape in the link's frame."
    )


@record
class Coupler:
    """A linear relation between joint coordinates: gears, racks, belts. The sum of coefficient times q is a value."""

    name: str = key(Name(of="coupler"), doc="Name.")
    terms: dict[str, float] = key(
        MapOf(Number(), of="joint"), unit="1, m/rad or rad/m", doc="Coefficient of each joint's coordinate."
    )
    value: FormulaTree | None = key(
        Formula(("t",)),
        default=None,
        unit="rad or m",
        doc="Their sum: a number or a formula in t; default 0.",
    )

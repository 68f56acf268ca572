"""The kinds of loop closure: one file a kind, one line here."""

from __future__ import annotations

from robodyn_cli.loops.cylindrical import CylindricalLoop
from robodyn_cli.loops.distance import DistanceLoop
from robodyn_cli.loops.fixed import FixedLoop
from robodyn_cli.loops.planar import PlanarLoop
from robodyn_cli.loops.point_on_line import PointOnLineLoop
from robodyn_cli.loops.point_on_plane import PointOnPlaneLoop
from robodyn_cli.loops.prismatic import PrismaticLoop
from robodyn_cli.loops.revolute import RevoluteLoop
from robodyn_cli.loops.spherical import SphericalLoop
from robodyn_cli.loops.universal import UniversalLoop

loop_types: dict[str, type] = {
    "revolute": RevoluteLoop,
    "prismatic": PrismaticLoop,
    "cylindrical": CylindricalLoop,
    "universal": UniversalLoop,
    "spherical": SphericalLoop,
    "planar": PlanarLoop,
    "fixed": FixedLoop,
    "point_on_line": PointOnLineLoop,
    "point_on_plane": PointOnPlaneLoop,
    "distance": DistanceLoop,
}

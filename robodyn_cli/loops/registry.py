"""The kinds of loop closure: one file and one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.registry import Registry

loop_types: Registry[type] = Registry(
    "robodyn_cli.loops",
    {
        "revolute": "revolute:RevoluteLoop",
        "prismatic": "prismatic:PrismaticLoop",
        "cylindrical": "cylindrical:CylindricalLoop",
        "universal": "universal:UniversalLoop",
        "spherical": "spherical:SphericalLoop",
        "planar": "planar:PlanarLoop",
        "fixed": "fixed:FixedLoop",
        "point_on_line": "point_on_line:PointOnLineLoop",
        "point_on_plane": "point_on_plane:PointOnPlaneLoop",
        "distance": "distance:DistanceLoop",
    },
)

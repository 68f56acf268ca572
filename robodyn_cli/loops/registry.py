"""The kinds of loop closure: one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.registry import Registry

loop_types: Registry[type] = Registry(
    "robodyn_cli.loops",
    {
        "revolute": "pairs:RevoluteLoop",
        "prismatic": "pairs:PrismaticLoop",
        "cylindrical": "pairs:CylindricalLoop",
        "universal": "pairs:UniversalLoop",
        "spherical": "pairs:SphericalLoop",
        "planar": "pairs:PlanarLoop",
        "fixed": "pairs:FixedLoop",
        "point_on_line": "points:PointOnLineLoop",
        "point_on_plane": "points:PointOnPlaneLoop",
        "distance": "points:DistanceLoop",
    },
)

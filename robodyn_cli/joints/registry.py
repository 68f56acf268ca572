"""The kinds of joint: one file and one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.joints.base import Joint
from robodyn_cli.registry import Registry

joint_types: Registry[Joint] = Registry(
    "robodyn_cli.joints",
    {
        "revolute": "revolute:Revolute",
        "prismatic": "prismatic:Prismatic",
        "fixed": "fixed:Fixed",
        "helical": "helical:Helical",
        "cylindrical": "cylindrical:Cylindrical",
        "universal": "universal:Universal",
        "spherical": "spherical:Spherical",
        "planar": "planar:Planar",
        "floating": "floating:Floating",
    },
    made=True,
)

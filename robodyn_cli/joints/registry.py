"""The kinds of joint: one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.joints.base import Joint
from robodyn_cli.registry import Registry

joint_types: Registry[Joint] = Registry(
    "robodyn_cli.joints",
    {
        "revolute": "single_axis:Revolute",
        "prismatic": "single_axis:Prismatic",
        "fixed": "single_axis:FixedJoint",
        "helical": "single_axis:Helical",
        "cylindrical": "several_axes:Cylindrical",
        "universal": "several_axes:Universal",
        "spherical": "several_axes:Spherical",
        "planar": "several_axes:Planar",
        "floating": "several_axes:Floating",
    },
    made=True,
)

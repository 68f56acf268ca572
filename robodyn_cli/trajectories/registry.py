"""The kinds of trajectory: one file and one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.registry import Registry

trajectory_types: Registry[type] = Registry(
    "robodyn_cli.trajectories",
    {
        "joint": "joint:JointTrajectory",
        "quintic": "quintic:QuinticTrajectory",
        "table": "table:TableTrajectory",
        "circle": "circle:CircleTrajectory",
        "cartesian": "cartesian:CartesianTrajectory",
    },
)

"""The kinds of trajectory: one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.registry import Registry

PACKAGE = "robodyn_cli.trajectories"
PLACES = {
    "joint": "given:JointTrajectory",
    "quintic": "way_points:QuinticTrajectory",
    "cubic": "way_points:CubicTrajectory",
    "monotone": "way_points:MonotoneTrajectory",
    "trapezoid": "moves:TrapezoidTrajectory",
    "s_curve": "moves:SCurveTrajectory",
    "fourier": "given:FourierTrajectory",
    "sequence": "sequence:SequenceTrajectory",
    "fastest": "fastest:FastestTrajectory",
    "table": "given:TableTrajectory",
    "circle": "circle:CircleTrajectory",
    "path": "path:PathTrajectory",
    "cartesian": "cartesian:CartesianTrajectory",
}

trajectory_types: Registry[type] = Registry(PACKAGE, PLACES)

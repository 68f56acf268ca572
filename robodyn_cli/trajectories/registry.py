"""The kinds of trajectory: one file a kind, one line here."""

from __future__ import annotations

from robodyn_cli.trajectories.cartesian import CartesianTrajectory
from robodyn_cli.trajectories.circle import CircleTrajectory
from robodyn_cli.trajectories.joint import JointTrajectory
from robodyn_cli.trajectories.quintic import QuinticTrajectory
from robodyn_cli.trajectories.table import TableTrajectory

trajectory_types: dict[str, type] = {
    "joint": JointTrajectory,
    "quintic": QuinticTrajectory,
    "table": TableTrajectory,
    "circle": CircleTrajectory,
    "cartesian": CartesianTrajectory,
}

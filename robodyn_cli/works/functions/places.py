"""Where frames and the centre of mass are, and how rates move them, as expressions."""

from __future__ import annotations

import numpy as np

from robodyn_cli.algorithms.kinematics import world_jacobian
from robodyn_cli.equations.problem import Problem
from robodyn_cli.model.model import FixedFrame
from robodyn_cli.spatial.algebra import Matrix, Vector, zeros


def frame_jacobian(problem: Problem, frame: FixedFrame) -> Matrix:
    """Return J (6, nv) of a frame in world axes: rows of the angular velocity, then of its origin's velocity.

    J v is the frame's twist (w, v) as ``frames/NAME/twist`` of a result has it.
    """
    linear, angular = world_jacobian(problem.model, problem.q, problem.pose, frame)
    return np.concatenate([angular, linear])


def centre_of_mass(problem: Problem) -> Vector:
    """Return the centre of mass of all moving bodies (3,), world coordinates: sum h / sum m."""
    mass, moment = 0.0, zeros(3)
    for k, body in enumerate(problem.model.bodies):
        pose, inertia = problem.pose[k], body.inertia
        mass = mass + inertia.m
        moment = moment + inertia.m * pose.p + pose.R @ inertia.h
    return problem.model.base.point(moment / mass)

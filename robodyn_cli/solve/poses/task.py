"""What is asked of a frame: a pose, or parts of one, as expressions of the joint positions and of the target."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import poses, transforms, world_jacobian, world_pose
from robodyn_cli.expr.functions import maximum, sqrt, where
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.model.model import FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Vector, cross, dot, matrix, vector, zeros

ORIENTATIONS = ("full", "axis", "free")
TARGET = 12  # numbers of a target: position, then the rotation row by row
TINY = 1e-300


@record
class PoseTask:
    """Which parts of a frame's pose are asked for.

    frame : fixed to a body. position : the components (0, 1, 2: x, y, z of the world) that are asked for.
    orientation : ``full``; ``axis``, the direction of ``axis`` (in the frame's coordinates) alone; or ``free``.
    """

    frame: FixedFrame
    position: tuple[int, ...] = (0, 1, 2)
    orientation: str = "full"
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def rows(self) -> int:
        """Number of numbers that are asked for, dependent ones not counted."""
        return len(self.position) + {"full": 3, "axis": 2, "free": 0}[self.orientation]


@record
class Rows:
    """What is left of a task, e(q), as expressions, with J of e(q + dq) = e(q) - J dq to first order.

    error : (m,) in metres and radians. J : (m, nv). lengths : for each row whether it is a length.
    measure : the larger of the distance [m] and the angle [rad], as 2 sin(angle / 2), to the target.
    """

    error: list[Scalar]
    J: Matrix
    lengths: list[bool]
    measure: Scalar


def pose_rows(model: Model, q: Sequence[Expr], task: PoseTask, target: Sequence[Expr]) -> Rows:
    """Return the rows of a task over the symbols q (nq,) and target (12,).

    A turn by theta about the unit vector u is left as e = 2 sin(theta / 2) u, of which the derivative at the target
    is that of the turn: e = s sqrt(2 / (1 + c)) with s = sin(theta) u and c = cos(theta).
    """
    pose = poses(model, transforms(model, q))
    here = world_pose(model, pose, task.frame)
    linear, angular = world_jacobian(model, q, pose, task.frame)
    p, R = here.p, here.R
    places = list(task.position)
    e = [target[k] - p[k] for k in places]
    rows, lengths = [linear[k] for k in places], [True] * len(places)
    square = dot(e, e)
    if task.orientation != "free":
        wanted = matrix([target[3 + 3 * i : 6 + 3 * i] for i in range(3)])
        sine, cosine = _turn(R, wanted, task)
        turn = [s * sqrt(2.0 / maximum(1.0 + cosine, TINY)) for s in sine]
        if task.orientation == "axis":  # the frame may turn about it
            along = vector(wanted @ vector(task.axis))
            angular = angular - np.outer(along, along @ angular)
        chord = 2.0 * (1.0 - cosine)  # half a turn away the sine says nothing
        e, rows, lengths = [*e, *turn], [*rows, *angular], [*lengths, *[False] * 3]
        square = maximum(square, where(cosine, dot(turn, turn), chord))
    J = matrix(rows) if rows else zeros(0, model.nv)
    return Rows(e, J, lengths, sqrt(square))


def _turn(R: Matrix, wanted: Matrix, task: PoseTask) -> tuple[Vector, Any]:
    """Return sin(theta) u (3,) and cos(theta) of the turn by theta about u that is left to the wanted axes."""
    if task.orientation == "axis":
        here, there = R @ vector(task.axis), wanted @ vector(task.axis)
        return cross(here, there), dot(here, there)
    x, y, z = (cross(R[:, k], wanted[:, k]) for k in range(3))
    trace = dot(R.ravel(), wanted.ravel())
    return vector([0.5 * s for s in x + y + z]), 0.5 * (trace - 1.0)

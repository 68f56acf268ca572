"""What is asked of a frame: a pose, or parts of one, as expressions of the joint positions and of the target.

Steps towards a pose as expressions, for arms and mechanisms with loops alike.

With W e the rows in comparable units, the damped step solves J dq = e in the sense of Levenberg and Marquardt with the
damping of Chan and Lawrence (1988), which vanishes with the error:

    dq = J^T (J J^T + mu E)^-1 e,    mu = DAMPING e^T e / 2

It is the step of least norm where the mechanism is redundant, and converges quadratically. Joints on a limit that the
step would pass stand still (Bertsekas 1982).

A redundant mechanism then goes on to the pose with the smallest |c(q)|^2 of a criterion c by the steps of
sequential quadratic programming with C = dc/dq:

    [C^T C + s E   J^T] [ dq ]   [-C^T c]
    [J             0  ] [-lam] = [ e    ]

with a damping s, since the poses that meet the rows are curved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import moved, poses, transforms, world_jacobian, world_pose
from robodyn_cli.algorithms.linear import LdlFactor, minimum_degree
from robodyn_cli.expr.functions import absolute, maximum, minimum, sqrt, where
from robodyn_cli.expr.graph import Expr, Scalar, is_nonzero
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
class TaskRows:
    """What is left of a task, e(q), as expressions, with J of e(q + dq) = e(q) - J dq to first order.

    error : (m,) in metres and radians. J : (m, nv). lengths : for each row whether it is a length.
    measure : the larger of the distance [m] and the angle [rad], as 2 sin(angle / 2), to the target.
    """

    error: list[Scalar]
    J: Matrix
    lengths: list[bool]
    measure: Scalar


def pose_rows(model: Model, q: Sequence[Expr], task: PoseTask, target: Sequence[Expr]) -> TaskRows:
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
    return TaskRows(e, J, lengths, sqrt(square))


def _turn(R: Matrix, wanted: Matrix, task: PoseTask) -> tuple[Vector, Any]:
    """Return sin(theta) u (3,) and cos(theta) of the turn by theta about u that is left to the wanted axes."""
    if task.orientation == "axis":
        here, there = R @ vector(task.axis), wanted @ vector(task.axis)
        return cross(here, there), dot(here, there)
    x, y, z = (cross(R[:, k], wanted[:, k]) for k in range(3))
    trace = dot(R.ravel(), wanted.ravel())
    return vector([0.5 * s for s in x + y + z]), 0.5 * (trace - 1.0)


DAMPING = 0.1  # times half the square of the error, which counts a length in sizes of the mechanism and angles in rad
FLOOR = 1e-12  # of the damping, for rows that depend on each other and for singular poses
MOST_STEP = 1.0  # rad, or part of the size of the mechanism
CRITERION_STEP = 0.5  # the same, for a step of the criterion


@record
class StepBounds:
    """Limits as expressions by velocity coordinate; the positions in q that they hold for."""

    lower: dict[int, Expr]
    upper: dict[int, Expr]
    place: dict[int, int]

    def free(self, q: Sequence[Expr], direction: Vector) -> Vector:
        """Return 1 for each coordinate that may follow a direction (nv,), 0 for one that its limit stops."""
        out = vector([1.0] * len(direction))
        for k, low in self.lower.items():
            out[k] = where(q[self.place[k]] - low, 1.0, where(direction[k], 1.0, 0.0))
        for k, high in self.upper.items():
            out[k] = out[k] * where(high - q[self.place[k]], 1.0, where(-direction[k], 1.0, 0.0))
        return out

    def clamp(self, q: list[Scalar]) -> list[Scalar]:
        """Return positions (nq,) put back between the limits."""
        out = list(q)
        for k, low in self.lower.items():
            out[self.place[k]] = maximum(out[self.place[k]], low)
        for k, high in self.upper.items():
            out[self.place[k]] = minimum(out[self.place[k]], high)
        return out


def damped_step(e: Sequence[Scalar], J: Matrix) -> Vector:
    """Return dq (n,) for scaled rows e (m,) and J (m, n)."""
    mu = 0.5 * DAMPING * dot(e, e) + FLOOR
    if J.shape[0] <= J.shape[1]:
        A = _with_diagonal(J @ J.T, mu)
        return vector(J.T @ LdlFactor.of(A, minimum_degree(A)).solve(list(e)))
    A = _with_diagonal(J.T @ J, mu)
    return LdlFactor.of(A, minimum_degree(A)).solve(vector(J.T @ vector(e)))


def criterion_step(e: Sequence[Scalar], J: Matrix, c: Sequence[Scalar], C: Matrix, damping: Scalar) -> Vector:
    """Return dq (n,) towards the smallest |c|^2 (k,) among the poses that meet the rows e; C (k, n) is dc/dq.

    With H = C^T C + s E: lam = (J H^-1 J^T + mu E)^-1 (e + J H^-1 g), dq = H^-1 (J^T lam - g), g = C^T c.
    """
    H = LdlFactor.of(_with_diagonal(C.T @ C, damping))
    g = vector(C.T @ vector(c))
    m = J.shape[0]
    V = [H.solve(J[i]) for i in range(m)]  # H^-1 J^T, column by column
    A = zeros(m, m)
    for i in range(m):
        for j in range(i, m):
            A[i, j] = A[j, i] = dot(J[i], V[j])
    right = [x + dot(v, g) for x, v in zip(e, V)]
    lam = LdlFactor.of(_with_diagonal(A, 0.5 * DAMPING * dot(e, e) + FLOOR)).solve(right)
    return H.solve(vector([dot(J[:, k], lam) - g[k] for k in range(J.shape[1])]))


def position_after(
    model: Model, q: Sequence[Expr], dq: Vector, lengths: Sequence[float], bounds: StepBounds, most: float
) -> list[Scalar]:
    """Return the position (nq,) after a scaled step, shortened to ``most`` in its largest entry, within the bounds.

    A quasi-velocity joint's position is put back on its manifold.
    """
    largest: Scalar = most
    for x in dq:
        largest = maximum(largest, absolute(x)) if is_nonzero(x) else largest
    shorter = most / largest
    position = moved(model, q, [shorter * x * unit for x, unit in zip(dq, lengths)])
    for body in model.bodies:
        own = slice(body.q, body.q + body.joint.nq)
        if body.joint.quasi:
            position[own] = body.joint.normalise(vector(position[own]))
    return bounds.clamp(position)


def _with_diagonal(A: Matrix, x: Scalar) -> Matrix:
    out = A.copy()
    for k in range(len(out)):
        out[k, k] = out[k, k] + x
    return out

"""Forces on bodies from outside the joints: where they act, and what they are in the joints, J^T f.

Each group of forces is carried down the tree to ``root``, the last common ancestor of the bodies it acts on: below that
it has no effect (the wrenches cancel there), so nothing below is touched. The work grows with the length of the path.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.algorithms.kinematics import Pose, Velocity, slice_q, slice_v, step_velocity
from robodyn_cli.algorithms.rnea import Wrench, joint_torque
from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.spatial.algebra import Matrix, Transform, Values, Vector, cross, dot, rotation_to_z, snap, zeros

PARALLEL = 1e-12


class PathKinematics:
    """Poses and velocities relative to ``root``, in its coordinates, of the bodies that are asked for."""

    def __init__(self, model: Model, X: Sequence[Transform], q: Values, qd: Values, root: int) -> None:
        self.model, self.X, self.q, self.qd, self.root = model, X, q, qd, root
        self._pose: dict[int, Pose] = {root: Pose.identity(), BASE: Pose.identity()}
        self._velocity: dict[int, Velocity] = {root: Velocity.at_rest(), BASE: Velocity.at_rest()}

    def _reach(self, body: int) -> None:
        path = []
        while body not in self._pose:
            path.append(body)
            body = self.model.bodies[body].parent
        for k in reversed(path):
            b = self.model.bodies[k]
            self._pose[k] = self._pose[b.parent].after(self.X[k])
            self._velocity[k] = step_velocity(
                b, self.X[k], slice_q(b, self.q), slice_v(b, self.qd), self._velocity[b.parent]
            )

    def pose(self, body: int) -> Pose:
        """Return the pose of a body that hangs on the root."""
        self._reach(body)
        return self._pose[body]

    def place(self, frame: FixedFrame) -> tuple[Vector, Matrix, Vector, Vector]:
        """Return origin, axes, velocity of the origin and angular velocity of a frame fixed to a body."""
        pose = self.pose(frame.body)
        own = self._velocity[frame.body]
        v = pose.R @ (own.v + cross(own.w, frame.p))
        return pose.point(frame.p), pose.R @ frame.R, v, pose.R @ own.w


def path_torques(
    model: Model, q: Values, X: Sequence[Transform], wrenches: Mapping[int, Wrench], root: int = BASE
) -> Vector:
    """Return the joint torques (nv,) of wrenches on bodies, sum of J^T f, as far down as ``root``.

    Parameters
    ----------
    wrenches : moment [N m] about the body's origin and force [N] in body coordinates, by body; what acts on ``root``
        has no effect.
    """
    tau = zeros(model.nv)
    carried = {k: w for k, w in wrenches.items() if k not in (root, BASE)}
    while carried:
        k = max(carried)  # parents come first in the tree
        n, f = carried.pop(k)
        body = model.bodies[k]
        own = joint_torque(body, slice_q(body, q), (n, f))
        for j in range(body.joint.nv):
            tau[body.v + j] = tau[body.v + j] + own[j]
        if body.parent not in (root, BASE):
            n, f = X[k].force_to_parent(n, f)
            below = carried.get(body.parent)
            carried[body.parent] = (n, f) if below is None else (below[0] + n, below[1] + f)
    return tau


def turn_about(model: Model, q: Values, ends: Sequence[FixedFrame], axis: Sequence[float], root: int) -> Any:
    """Return the angle [rad] by which the second frame is turned against the first about ``axis``, or None.

    It is zero where the frames' transverse axes coincide. Not None only if every joint between them that turns does so
    about a parallel of ``axis`` (3,), which is given in the axes of each frame: then the angle is a sum of joint
    positions, and counts full turns.
    """
    A = rotation_to_z(axis)
    turned = [_turn_to(model, q, end, A, root) for end in ends]
    if any(t is None for t in turned):
        return None
    (first, R1), (second, R2) = turned
    R = R1.T @ R2
    if max(abs(R[0, 2]), abs(R[1, 2])) > PARALLEL:
        return None
    side = 1.0 if R[2, 2] > 0.0 else -1.0  # the second axis may point against the first
    return side * second - first + snap(math.atan2(R[1, 0], R[0, 0]))


def _turn_to(model: Model, q: Values, end: FixedFrame, A: Matrix, root: int) -> Any:
    """Return the turn of a frame with axes A about its z axis since q = 0, and those axes in ``root`` at q = 0.

    None where the joints between the two also turn the frame about other axes.
    """
    R, k = end.R @ A, end.body
    total: Any = 0.0
    while k not in (root, BASE):
        body = model.bodies[k]
        turn = body.joint.turn(slice_q(body, q))
        if turn is None or not _is_known(R):
            return None
        if isinstance(turn, Expr):
            if max(abs(R[0, 2]), abs(R[1, 2])) > PARALLEL:
                return None
            total = total + (turn if R[2, 2] > 0.0 else -turn)
        R = body.X_tree.E.T @ R
        k = body.parent
    return (total, R) if _is_known(R) else None


def common_axis(model: Model, q: Values, ends: Sequence[FixedFrame], root: int) -> Any:
    """Return the axis (3,), in the axes of the first frame, about which the second turns against it, None otherwise.

    That is: all joints between them that turn do so about parallels of one axis, and about it the two frames coincide
    at some turn.
    """
    for end in ends:
        R, k = end.R, end.body
        while k not in (root, BASE):
            body = model.bodies[k]
            if not _is_known(R):
                return None
            if isinstance(body.joint.turn(slice_q(body, q)), Expr):
                axis = [snap(x) for x in R[2]]
                A = rotation_to_z(axis)
                turned = [_turn_to(model, q, end, A, root) for end in ends]
                parallel = all(t is not None for t in turned) and dot(turned[0][1][:, 2], turned[1][1][:, 2]) > 0.0
                return axis if parallel and turn_about(model, q, ends, axis, root) is not None else None
            R = body.X_tree.E.T @ R
            k = body.parent
    return None


def _is_known(R: Matrix) -> bool:
    return not any(isinstance(x, Expr) for x in R.flat)

"""Forces on bodies from outside the joints: where they act, and the joint torques J^T f equivalent to them.

Each group of forces is carried down the tree to ``root``, the last common ancestor of the bodies on which it acts.
Below that the wrenches cancel, so no joint there is visited. The work grows with the length of the path.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.algorithms.kinematics import Pose, prescribed_motion, slice_q, slice_v, step_velocity
from robodyn_cli.algorithms.rnea import joint_torque
from robodyn_cli.expr.graph import Expr, is_nonzero
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.spatial.algebra import (
    PARALLEL,
    Matrix,
    Transform,
    Twist,
    Values,
    Vector,
    Wrench,
    rotation_to_z,
    snap,
    zeros,
)

if TYPE_CHECKING:
    from robodyn_cli.forces.element import End


class PathKinematics:
    """Poses and velocities relative to ``root``, in its coordinates, of the bodies that are asked for."""

    def __init__(self, model: Model, X: Sequence[Transform], q: Values, qd: Values, root: int) -> None:
        self.model, self.X, self.q, self.qd, self.root = model, X, q, qd, root
        self._pose: dict[int, Pose] = {root: Pose.identity(), BASE: Pose.identity()}
        self._velocity: dict[int, Twist] = {root: Twist.zero(), BASE: Twist.zero()}

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
        """Return the pose of a body that the root carries."""
        self._reach(body)
        return self._pose[body]

    def end(self, frame: FixedFrame) -> End:
        """Return place, axes and velocity of a frame fixed to a body."""
        from robodyn_cli.forces.element import End  # few scenes have forces

        pose = self.pose(frame.body)
        velocity = self._velocity[frame.body].shifted(frame.p).rotated(pose.R)
        drift, _ = prescribed_motion(self.model, frame)
        if any(is_nonzero(x) for x in drift):
            velocity = Twist(velocity.w, velocity.v + pose.R @ drift)
        return End(pose.point(frame.p), pose.R @ frame.R, velocity)


def path_torques(
    model: Model, q: Values, X: Sequence[Transform], wrenches: Mapping[int, Wrench], root: int = BASE
) -> Vector:
    """Return the joint torques (nv,) of wrenches on bodies, sum of J^T f, as far down as ``root``.

    Parameters
    ----------
    wrenches : about the body's origin in body coordinates, by body; a wrench on ``root`` has no effect.
    """
    tau = zeros(model.nv)
    carried = {k: w for k, w in wrenches.items() if k not in (root, BASE)}
    while carried:
        k = max(carried)  # parents come first in the tree
        wrench = carried.pop(k)
        body = model.bodies[k]
        tau[body.v : body.v + body.joint.nv] = joint_torque(body, slice_q(body, q), wrench)
        if body.parent not in (root, BASE):
            carried[body.parent] = carried.get(body.parent, Wrench.zero()) + wrench.to_parent(X[k])
    return tau


def turn_about(model: Model, q: Values, ends: Sequence[FixedFrame], axis: Sequence[float], root: int) -> Any:
    """Return the angle [rad] by which the second frame is turned against the first about ``axis``, or None.

    The angle is zero where the frames' transverse axes coincide. If all joints between the frames turn about parallels
    of ``axis`` only, it is a sum of joint angles and counts full turns; otherwise it is None.

    Parameters
    ----------
    axis : (3,) in the axes of each frame. root : last common ancestor of the two frames' bodies.
    """
    A = rotation_to_z(axis)
    ways = [way for end in ends if (way := _turn_from(model, q, end, A, root)) is not None]
    if len(ways) < len(ends):
        return None
    (first, R1), (second, R2) = ways
    R = R1.T @ R2
    if max(abs(R[0, 2]), abs(R[1, 2])) > PARALLEL:
        return None
    # the second frame's axis may point against that of the first
    return (second if R[2, 2] > 0.0 else -second) - first + snap(math.atan2(R[1, 0], R[0, 0]))


def common_axis(model: Model, q: Values, ends: Sequence[FixedFrame], root: int) -> Any:
    """Return the axis (3,), the same in the axes of both frames, about which alone one turns against the other.

    None where the joints between them turn about other axes too, or not at all, or where the frames do not share it.
    """
    for end in ends:
        R, k = end.R, end.body
        while k not in (root, BASE) and _is_known(R):
            body = model.bodies[k]
            if is_nonzero(body.joint.angle(slice_q(body, q))):
                axis = [snap(x) for x in R[2]]
                A = rotation_to_z(axis)
                ways = [w for e in ends if (w := _turn_from(model, q, e, A, root)) is not None]
                shared = len(ways) == 2 and np.abs(ways[0][1][:, 2] - ways[1][1][:, 2]).max() <= PARALLEL
                return axis if shared else None
            R = body.X_tree.E.T @ R
            k = body.parent
    return None


def _turn_from(model: Model, q: Values, end: FixedFrame, A: Matrix, root: int) -> tuple[Any, Matrix] | None:
    """Return how far a frame has turned since q = 0 about z of its axes A, and these axes in ``root`` at q = 0.

    None where it also turns about others.
    """
    R, k = end.R @ A, end.body
    total: Any = 0.0
    while k not in (root, BASE):
        body = model.bodies[k]
        angle = body.joint.angle(slice_q(body, q))
        if angle is None or not _is_known(R):
            return None
        if is_nonzero(angle):
            if max(abs(R[0, 2]), abs(R[1, 2])) > PARALLEL:
                return None
            total = total + (angle if R[2, 2] > 0.0 else -angle)
        R = body.X_tree.E.T @ R
        k = body.parent
    return (total, R) if _is_known(R) else None


def _is_known(R: Matrix) -> bool:
    return not any(isinstance(x, Expr) for x in R.flat)

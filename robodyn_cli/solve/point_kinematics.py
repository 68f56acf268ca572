"""Position, Jacobian and Jacobian rate of a point or a pose, as expressions and as functions of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from robodyn_cli.algorithms.kinematics import (
    point_jacobian,
    poses,
    position_rates,
    transforms,
    world_jacobian,
    world_pose,
)
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.model.model import FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array, Matrix, Vector

POSE = 12  # values of a pose: position and axes


class PointFunction(Protocol):
    """Values p (T, k), Jacobian J (T, m, n) and its rate J-dot (T, m, n) at q (T, n) and v (T, n).

    For a point k = m; for a pose p is followed by the frame's axes, 12 values and 6 rows. Columns of q that are given
    beside it follow.
    """

    def __call__(self, q: Array, v: Array) -> tuple[Array, Array, Array]: ...


@record
class Led:
    """What is led: a point fixed to a body, or a frame there, and columns of q beside it.

    components : of the point's coordinates that are led. oriented : whether the frame's axes are led too. relative_to :
    the frame of another moving body in whose coordinates that is; None for the world's.
    """

    frame: FixedFrame
    components: int = 3
    oriented: bool = False
    relative_to: FixedFrame | None = None
    columns: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """How many rows of J are those of the point or the frame, above those of ``columns``."""
        return self.components + (3 if self.oriented else 0)


@record
class PointKinematics:
    """Expressions for p-dot = J v and p-ddot = J v-dot + J-dot v of what is led (see ``Led``).

    p : the first m coordinates of x, y, z [m]; of a frame its axes R too, row by row; columns of q. J, J_rate : (m, nv)
    row by row; of a frame with the rows of the angular velocity w = J_w v below, then those of the columns of q.
    """

    p: tuple[Scalar, ...]
    J: tuple[Scalar, ...]
    J_rate: tuple[Scalar, ...]
    nq: int
    nv: int

    @staticmethod
    def of(model: Model, q: Sequence[Expr], v: Sequence[Expr], led: Led) -> PointKinematics:
        """Build the expressions over the symbols q (nq,) and v (nv,)."""
        at, R, linear, angular = _led_frame(model, q, led)
        p, entries = list(at[: led.components]), list(linear[: led.components].flat)
        if led.oriented:
            p += list(R.flat)
            entries += list(angular.flat)
        if led.columns:
            places = [model.q_names.index(name) for name in led.columns]
            p += [q[k] for k in places]
            unit = np.eye(model.nv)
            by_velocity = [position_rates(model, q, unit[k].tolist()) for k in range(model.nv)]
            entries += [rates[k] for k in places for rates in by_velocity]
        qd = position_rates(model, q, v)
        rate = tuple(directional(entries, q, qd))
        return PointKinematics(tuple(p), tuple(entries), rate, model.nq, model.nv)

    def outputs(self) -> dict[str, tuple[Scalar, ...]]:
        """Return the expressions by name, as a kernel takes them."""
        return {"p": self.p, "J": self.J, "J_rate": self.J_rate}

    def unpack(self, arrays: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Return p, J and J-dot from a kernel's arrays (T, entries)."""
        shape = (-1, len(self.J) // self.nv, self.nv)
        return arrays["p"], arrays["J"].reshape(shape), arrays["J_rate"].reshape(shape)

    def interpreted(self) -> PointFunction:
        """Return the function that evaluates the expressions without compiling; slow on single samples."""
        names = self.outputs()

        def function(q: Array, v: Array) -> tuple[Array, Array, Array]:
            arrays = {}
            for name, entries in names.items():
                values = evaluate(entries, {"q": q.T, "v": v.T})
                arrays[name] = np.stack([np.broadcast_to(x, len(q)) for x in values], axis=1)
            return self.unpack(arrays)

        return function


def _led_frame(model: Model, q: Sequence[Expr], led: Led) -> tuple[Vector, Matrix, Matrix, Matrix]:
    """Return a frame's origin p (3,) and axes R (3, 3), and the Jacobians (3, nv) of p-dot and of its angular velocity.

    Relative to a frame (R_0, p_0) on another body, in the coordinates of their last common ancestor:
    R_0^T (p - p_0) and R_0^T R, with R_0^T (J_p - J_0) and R_0^T (J_w - J_w0), where J_0 is that of the other body's
    point which is at p.
    """
    frame, reference, X = led.frame, led.relative_to, transforms(model, q)
    if reference is None:
        pose = poses(model, X)
        here = world_pose(model, pose, frame)
        return here.p, here.R, *world_jacobian(model, q, pose, frame)
    root = model.common_ancestor(frame.body, reference.body)
    pose = poses(model, X, root)
    p, p0 = (pose[x.body].point(x.p) for x in (frame, reference))
    linear, angular = point_jacobian(model, q, pose, frame.body, p, root)
    linear0, angular0 = point_jacobian(model, q, pose, reference.body, p, root)
    back = (pose[reference.body].R @ reference.R).T
    axes = back @ pose[frame.body].R @ frame.R
    return back @ (p - p0), axes, back @ (linear - linear0), back @ (angular - angular0)


def what_is_left(wanted: Array, actual: Array, oriented: bool) -> Array:
    """Return the rows (..., m) that lead from values to wanted ones: differences, of a pose's axes the rotation vector.

    wanted, found : (..., k). oriented : whether the first 12 are those of a pose: position, then the axes row by row.
    """
    left: Array = wanted - actual
    if not oriented:
        return left
    A, B = (x[..., 3:POSE].reshape(*x.shape[:-1], 3, 3) for x in (wanted, actual))
    turn = quaternion.logarithm(A @ np.swapaxes(B, -1, -2))
    return np.concatenate([left[..., :3], turn, left[..., POSE:]], axis=-1)

"""Position, Jacobian and Jacobian rate of a point or a pose, as expressions and as functions of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from robodyn_cli.algorithms.kinematics import (
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
from robodyn_cli.spatial.algebra import Array

POSE = 12  # values of a pose: position and axes


class PointFunction(Protocol):
    """Values p (T, k), Jacobian J (T, m, n) and its rate J-dot (T, m, n) at q (T, n) and v (T, n).

    For a point k = m; for a pose p is followed by the frame's axes, k = 12 and m = 6.
    """

    def __call__(self, q: Array, v: Array) -> tuple[Array, Array, Array]: ...


@record
class PointKinematics:
    """Expressions for p-dot = J v and p-ddot = J v-dot + J-dot v of a point fixed to a body, or of a frame.

    p : m world coordinates [m] (the first m of x, y, z); of a frame its axes R too, row by row. J, J_rate : (m, nv) row
    by row; of a frame with the rows of the angular velocity w = J_w v below.
    """

    p: tuple[Scalar, ...]
    J: tuple[Scalar, ...]
    J_rate: tuple[Scalar, ...]
    nv: int

    @staticmethod
    def of(
        model: Model,
        q: Sequence[Expr],
        v: Sequence[Expr],
        frame: FixedFrame,
        components: int = 3,
        oriented: bool = False,
    ) -> PointKinematics:
        """Build the expressions over the symbols q (nq,) and v (nv,)."""
        pose = poses(model, transforms(model, q))
        here = world_pose(model, pose, frame)
        linear, angular = world_jacobian(model, q, pose, frame)
        p, entries = list(here.p[:components]), list(linear[:components].flat)
        if oriented:
            p += list(here.R.flat)
            entries += list(angular.flat)
        qd = position_rates(model, q, v)
        return PointKinematics(tuple(p), tuple(entries), tuple(directional(entries, q, qd)), model.nv)

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


def what_is_left(wanted: Array, found: Array) -> Array:
    """Return the rows (..., m) that lead from values to wanted ones: differences, for poses the rotation vector last.

    wanted, found : (..., m) of points, or (..., 12) of poses: position, then the axes row by row.
    """
    if wanted.shape[-1] != POSE:
        left: Array = wanted - found
        return left
    A, B = (x[..., 3:].reshape(*x.shape[:-1], 3, 3) for x in (wanted, found))
    turn = quaternion.logarithm(A @ np.swapaxes(B, -1, -2))
    return np.concatenate([wanted[..., :3] - found[..., :3], turn], axis=-1)

"""Position, Jacobian and Jacobian rate of a point, as expressions and as functions of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from robodyn_cli.algorithms.kinematics import point_jacobian, poses, position_rates, transforms
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.model.model import FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


class PointFunction(Protocol):
    """Position p (T, m), Jacobian J (T, m, n) and its rate J-dot (T, m, n) at q (T, n) and v (T, n)."""

    def __call__(self, q: Array, v: Array) -> tuple[Array, Array, Array]: ...


@record
class PointKinematics:
    """Expressions for p-dot = J v and p-ddot = J v-dot + J-dot v of a point fixed to a body.

    p : m world coordinates [m] (the first m of x, y, z). J, J_rate : (m, nv) row by row.
    """

    p: tuple[Scalar, ...]
    J: tuple[Scalar, ...]
    J_rate: tuple[Scalar, ...]
    nv: int

    @staticmethod
    def of(
        model: Model, q: Sequence[Expr], v: Sequence[Expr], frame: FixedFrame, components: int = 3
    ) -> PointKinematics:
        """Build the expressions over the symbols q (nq,) and v (nv,)."""
        X = transforms(model, q)
        pose = poses(model, X)
        at = pose[frame.body].point(frame.p)
        linear, _ = point_jacobian(model, q, pose, frame.body, at)
        J = (model.base.E.T @ linear)[:components]
        entries, qd = list(J.flat), position_rates(model, q, v)
        p = tuple(model.base.point(at)[:components])
        return PointKinematics(p, tuple(entries), tuple(directional(entries, q, qd)), model.nv)

    def outputs(self) -> dict[str, tuple[Scalar, ...]]:
        """Return the expressions by name, as a kernel takes them."""
        return {"p": self.p, "J": self.J, "J_rate": self.J_rate}

    def unpack(self, arrays: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Return p, J and J-dot from a kernel's arrays (T, entries)."""
        shape = (-1, len(self.p), self.nv)
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

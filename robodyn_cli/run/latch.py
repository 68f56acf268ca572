"""A latch that closes: the jump of the rates, its impulses and the energy that it costs."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.kinematics import point_jacobian
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.run.singularity import psi_at

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class LatchImpact:
    """What the latch does at the instant it closes.

    qd_after : rates after it. impulse : of each constraint row [N s or N m s]. angular_impulse : of the latch on
    its second link, base axes [N m s]. energy_lost [J].
    """

    qd_before: Array
    qd_after: Array
    rows: tuple[str, ...]
    impulse: Array
    angular_impulse: Array
    energy_lost: float

    def as_dict(self, joints: tuple[str, ...]) -> dict[str, Any]:
        return {
            "rates_before": dict(zip(joints, self.qd_before.tolist())),
            "rates_after": dict(zip(joints, self.qd_after.tolist())),
            "impulse": dict(zip(self.rows, self.impulse.tolist())),
            "angular_impulse": float(np.linalg.norm(self.angular_impulse)),
            "angular_impulse_vector": self.angular_impulse.tolist(),
            "energy_lost": self.energy_lost,
        }


def close_latch(problem: Problem, first: str, second: str, q: Array, qd: Array, t: float) -> LatchImpact:
    """Lock two links to each other by an impulse (momentum balance, no bounce).

    M (v+ - v-) = Psi^T I + J^T Lambda with Psi v+ = Psi v- and J v+ = 0, J the relative angular velocity of the
    links. Least norm where the rows depend on each other.
    """
    model = problem.model
    values = {"q": q.tolist(), "t": [t], "p": []}
    nv = model.nv

    def numbers(entries: Any) -> Array:
        return np.array(evaluate(list(np.asarray(entries, dtype=object).ravel()), values), dtype=float)

    M = numbers(problem.mass_matrix).reshape(nv, nv)
    psi = psi_at(problem, q, t)
    J = np.zeros((3, nv))
    for link, sign in ((second, 1.0), (first, -1.0)):
        frame = model.links[link]
        if frame.body >= 0:
            here = problem.pose[frame.body]
            _, angular = point_jacobian(model, problem.q, problem.pose, frame.body, here.point(frame.p))
            J += sign * numbers(angular).reshape(3, nv)
    rows = np.vstack([psi, J])
    m = len(rows)
    # the rates in the metric of M: rows W = R M^-1 R^T, solved with least norm
    Minv_rows = np.linalg.solve(M, rows.T)
    target = np.concatenate([np.zeros(len(psi)), -J @ qd])
    impulse, *_ = np.linalg.lstsq(rows @ Minv_rows, target, rcond=1e-12)
    after = qd + Minv_rows @ impulse
    lost = 0.5 * qd @ M @ qd - 0.5 * after @ M @ after
    assert impulse.shape == (m,)
    names = [problem.constraints.rows[i].name for i in range(len(psi))]
    return LatchImpact(qd, after, tuple(names), impulse[: len(psi)], impulse[len(psi) :], float(lost))

"""The closure equations on numbers: the rank of their Jacobian, and the damped Gauss-Newton steps that solve them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.loops.base import Row
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.spatial.algebra import Array

MOST_STEP = 0.7  # rad, or part of the size of the mechanism
RANK = 1e-8  # ratio of singular values below which rank is lost, in comparable units


def rank(A: Array, tolerance: float = RANK) -> int:
    """Return the rank of a matrix A (m, n), or the largest of several (T, m, n).

    A singular value counts if it exceeds ``tolerance`` times the largest one of its matrix.
    """
    sigma = np.linalg.svd(A, compute_uv=False)
    counted = sigma > tolerance * np.maximum(sigma[..., :1], 1e-300)
    return int(counted.sum(axis=-1).max(initial=0))


class Equations(Protocol):
    """The equations that assembly uses (satisfied by ``equations.problem.Problem``)."""

    model: Model

    @property
    def constraint_rows(self) -> tuple[Row, ...]: ...


class Numbers:
    """eta (m,), Psi (m, nv) and eta_t (m,) as functions of numbers q (nq,) and t."""

    def __init__(self, equations: Equations, parameters: Sequence[float]) -> None:
        self.rows = equations.constraint_rows
        self.q_names = equations.model.q_names
        self.manifold = Manifold(equations.model)
        self.nv = equations.model.nv
        self._eta = Evaluator([row.eta for row in self.rows])
        self._eta_t = Evaluator([row.eta_t for row in self.rows])
        self._psi = Evaluator([x for row in self.rows for x in row.psi])
        self._cosines = Evaluator([row.cosine for row in self.rows])
        self.parameters = list(parameters)
        self.sizes = np.ones(len(self.rows))  # of the rows: 1 rad, or the size of the mechanism [m]

    def _evaluate(self, outputs: Evaluator, q: Array, t: float) -> Array:
        return np.array(outputs({"q": q.tolist(), "t": [t], "p": self.parameters}), dtype=float)

    def eta(self, q: Array, t: float = 0.0) -> Array:
        return self._evaluate(self._eta, q, t)

    def relative(self, q: Array) -> Array:
        return self.eta(q) / self.sizes

    def psi(self, q: Array, t: float = 0.0) -> Array:
        return self._evaluate(self._psi, q, t).reshape(len(self.rows), self.nv)

    def turned(self, q: Array) -> list[str]:
        """Return the loops whose links are half a turn away from the attitude that is asked for."""
        cosines = self._evaluate(self._cosines, q, 0.0)
        return sorted({row.closure for row, cosine in zip(self.rows, cosines) if cosine < 0.5})

    def eta_t(self, q: Array, t: float = 0.0) -> Array:
        return self._evaluate(self._eta_t, q, t)


def newton(
    numbers: Numbers, q: Array, free: Sequence[int], lengths: Array, iterations: int = 60
) -> tuple[Array, float]:
    """Solve eta = 0 by damped Gauss-Newton steps; return q and the largest residual, relative to the rows' sizes.

    Parameters
    ----------
    free : velocity coordinates that may move, on the joints' manifolds. lengths : (nv,) size of a large motion of each;
    steps are of least norm in coordinates divided by these, which makes rad and m comparable.
    """
    q = q.copy()
    residual = numbers.relative(q)
    size = float(np.abs(residual).max(initial=0.0))
    stalled = 0
    for _ in range(iterations):
        if size < 1e-300 or stalled > 3:
            break
        J = numbers.psi(q)[:, free] * lengths[free] / numbers.sizes[:, None]
        if not np.all(np.isfinite(J)):
            break
        step, *_ = np.linalg.lstsq(J, -residual, rcond=1e-12)
        largest = float(np.abs(step).max(initial=0.0))
        if largest > MOST_STEP:
            step *= MOST_STEP / largest
        scale = 1.0
        for _ in range(12):
            moved = np.zeros(numbers.nv)
            moved[free] = scale * step * lengths[free]
            trial = numbers.manifold.integrate(q, moved)
            new = numbers.relative(trial)
            if np.abs(new).max() < size:
                break
            scale *= 0.5
        else:
            break
        stalled = stalled + 1 if np.abs(new).max() > 0.5 * size else 0
        q, residual, size = trial, new, float(np.abs(new).max())
    return q, size

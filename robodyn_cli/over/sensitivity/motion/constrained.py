"""Derivatives of a motion that are kept on those of its constraints.

    Psi S_q + eta_k = 0,   d(Psi v + eta_t)/dx S + d(Psi v + eta_t)/dk = 0

Both hold at all times, but what integrates accelerations drifts from them: exponentially where rows depend on each
other, since these do so on the constraints alone. So S is put back with the least change behind each block of samples.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.over.sensitivity.gradients import Gradients
from robodyn_cli.over.sensitivity.motion.variational import StatePoint, Variational
from robodyn_cli.record import record
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.spatial.algebra import Array


@record
class ConstraintLevel:
    """Constraints of positions, or of rates, at P points: derivatives by the state (P, m, nx) and by keys (P, m, K).

    places : of the entries of x that take up what is left of them. back : the pseudoinverse (P, n, m) of their columns.
    """

    state: Array
    keys: Array
    places: slice
    back: Array

    def put_back(self, S: Array, keys: Array | float) -> None:
        """Move derivatives S (P, nx, K) onto these, in place; ``keys`` : those of the constraints by what S is by."""
        S[:, self.places] -= self.back @ (self.state @ S + keys)

    def sizes_of(self, S: Array) -> Array:
        """Return the sizes of the terms that this adds to derivatives S (P, nx, K) at its places."""
        sizes: Array = np.abs(self.back) @ (np.abs(self.state) @ np.abs(S) + np.abs(self.keys))
        return sizes


class ConstraintSlopes:
    """The constraints of a motion, differentiated. Rows that depend on each other are combined as its equations are."""

    def __init__(self, problem: Problem, variational: Variational) -> None:
        rows, self.system = problem.independent_rows, variational.system
        self.gradients = None
        if rows.rows:
            outputs = {"positions": rows.eta, "rates": rows.velocity_residual(problem.v)}
            columns = variational.columns([*outputs["positions"], *outputs["rates"]])
            self.gradients = Gradients(outputs, columns, STATE_GROUPS)

    def levels(self, t: Array, x: Array, p: Array) -> list[ConstraintLevel]:
        """Return the constraints of positions, then of rates, at times t (P,), states x (P, nx), parameters p (P, np);
        nothing where a mechanism has none."""
        if self.gradients is None:
            return []
        n, nq, found = self.system.size, self.system.nq, []
        along = self.gradients(len(t), self.system.own_groups(t, x, p))
        for level, (_, J) in enumerate(along.values()):
            places = slice(level * nq, level * nq + nq)
            back = np.linalg.pinv(J[:, :, places], rcond=RANK_TOLERANCE)
            found.append(ConstraintLevel(J[:, :, :n], J[:, :, n + 1 :], places, back))
        return found

    def keep(self, ways: Array, shares: Array, *at: Array) -> None:
        """Put back, in place, what S is multiplied by (P, nx, nx) and what is added (P, nx, K) on the way to each of
        the points ``at`` (t, x, p)."""
        for level in self.levels(*at):
            level.put_back(ways, 0.0)
            level.put_back(shares, level.keys)

    def end(self, end: StatePoint, p: Array) -> tuple[Array, Array]:
        """Return S (nx, K) put back at one point, and the sizes of the terms that it is a sum of."""
        S, sizes = end.S[None].copy(), np.abs(end.S)
        for level in self.levels(np.array([end.t]), end.x[None], p):
            sizes[level.places] += level.sizes_of(S)[0]
            level.put_back(S, level.keys)
        return S[0], sizes

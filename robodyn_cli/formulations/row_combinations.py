"""The choice of combinations of dependent constraint rows, at a pose, by singular value decomposition.

    Psi = U S V^T,   W = U_r^T

W spans the row space of Psi at the pose, so W Psi keeps rank r until the motion has turned that space by a right
angle. Long before, the smallest singular value of W Psi becomes small: at an event W is chosen anew.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.equations.dependence import closeness, threshold
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.formulations.events import EventFunction, EventKind
from robodyn_cli.formulations.system import Partition
from robodyn_cli.spatial.algebra import Array, zeros

WORN = 0.2  # of the closeness at the pose where W was chosen, at which it is chosen anew


class RowCombinations(Partition):
    """Parameters that make dependent rows independent around a pose (see ``formulations.system.Partition``)."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.groups = [(c, c.W.shape[0]) for c in problem.combinations]
        self.first = len(problem.model.parameters)
        self.count = sum(group.numbers for group in problem.dependent)
        self.shape = problem.psi.shape
        self.psi = Evaluator(list(problem.psi.ravel()))

    def choose(self, t: float, q: Array, before: Array | None) -> Array:
        """Return the parameters (count,) at a pose.

        before : those in use so far. W keeps their orientation, so that determinants keep their sign.
        """
        values = {"q": q.tolist(), "t": [t], "p": [0.0] * self.first}
        psi = np.array(self.psi(values), dtype=float).reshape(self.shape)
        found = []
        for combination, rank in self.groups:
            rows = psi[list(combination.rows)]
            if not np.all(np.isfinite(rows)):
                return np.zeros(self.count) if before is None else before
            U, s, _ = np.linalg.svd(rows)
            W = U[:, :rank].T
            if before is not None:
                place = combination.place - self.first
                old = before[place : place + W.size].reshape(W.shape)
                if np.linalg.det(old @ W.T) < 0.0:
                    W = W * np.append(-1.0, np.ones(rank - 1))[:, None]
            s = s[:rank]
            # rows that vanish but for rounding (rank 0) have no rank to lose
            found += [W.ravel(), [threshold(float((s**2).sum()), s, WORN) if rank else WORN]]
        return np.concatenate(found)

    @property
    def functions(self) -> tuple[EventFunction, ...]:
        """The events at which W is chosen anew: closeness of its rows to losing rank, at its threshold."""
        problem = self.problem
        found = []
        for k, (combination, group) in enumerate(zip(problem.combinations, problem.dependent), start=1):
            if group.rank == 0:
                continue
            psi: Any = zeros(group.rank, problem.model.nv)
            for i in range(group.rank):
                for w, row in zip(combination.W[i], combination.rows):
                    psi[i] = psi[i] + w * problem.psi[row]
            value = closeness(psi, problem.psi[list(combination.rows)]) - combination.threshold
            found.append(EventFunction(f"rows {k}", value, kind=EventKind.REPARTITION, owner=self))
        return tuple(found)

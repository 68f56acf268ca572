"""Independent coordinates: as many as there are degrees of freedom are integrated, the others follow from the loops.

At every evaluation the dependent coordinates are solved for, two Newton steps from where the integrator has them, and
the dependent velocities from Psi v + eta_t = 0; the accelerations are those of equation (36) there (Wehage and Haug
1982). So the dependent coordinates in the integrator's state only serve as a first guess, and loops are closed in the
stages of a step too.

Which coordinates depend is in parameters w (nv,), 1 for a dependent one and 0 for an independent one: with Psi_w =
Psi diag(w), the step dq = -Psi_w^T (Psi_w Psi_w^T)^-1 eta moves dependent ones only. They are chosen by pivoting on the
columns of Psi, and chosen anew (an event) where the closeness of Psi_w to losing rank has fallen by a factor.

The choice of combinations of dependent constraint rows, at a pose, by singular value decomposition.

    Psi = U S V^T,   W = U_r^T

W spans the row space of Psi at the pose, so W Psi keeps rank r until the motion has turned that space by a right
angle. Long before, the smallest singular value of W Psi becomes small: at an event W is chosen anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.constraints import correction
from robodyn_cli.equations.constraints import closeness, threshold
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import Evaluator, renamed
from robodyn_cli.formulations.dynamics import Expanded
from robodyn_cli.formulations.events import EventFunction, EventKind
from robodyn_cli.formulations.index1 import Formulated, projection
from robodyn_cli.formulations.system import Corrections, Partition
from robodyn_cli.model.model import PARAMETER_GROUP
from robodyn_cli.spatial.algebra import Array, Matrix, vector, zeros

NEWTON_STEPS = 2
HELD = 1e-3  # times the size of a column in the choice, of a coordinate that a latch may hold
WORN = 0.1  # of the closeness to losing rank at the choice: below it, the choice is made anew


class CoordinatePartition(Partition):
    """Chooses the dependent coordinates at a pose (see ``formulations.system.Partition``).

    w : 1 for a dependent coordinate (nv,), as parameters. masked : Psi diag(w).
    """

    def __init__(self, problem: Problem) -> None:
        nv = problem.model.nv
        self.first = problem.parameter_count
        self.count = nv + 1
        self.rows = problem.independent_rows.psi(nv)
        self.shape = self.rows.shape
        self.psi = Evaluator(list(self.rows.ravel()))
        w = [problem.graph.symbol(f"w[{k}]", PARAMETER_GROUP, self.first + k) for k in range(nv)]
        self.threshold = problem.graph.symbol(f"w[{nv}]", PARAMETER_GROUP, self.first + nv)
        self.masked = _masked(self.rows, w)
        # what a latch may hold is independent as long as others can depend, or it would stand but for their errors
        held = [row.v for row in problem.latches if row.rigid and row.v is not None]
        self.weights = np.where(np.isin(np.arange(nv), held), HELD, 1.0)

    @property
    def functions(self) -> tuple[EventFunction, ...]:
        """The event at which the coordinates are chosen anew: closeness of Psi_w to losing rank, at its threshold."""
        value = closeness(self.masked, self.rows) - self.threshold
        return (EventFunction("repartition", value, kind=EventKind.REPARTITION, owner=self),)

    def choose(self, t: float, q: Array, before: Array | None) -> Array:
        """Return w (nv,) and the threshold of closeness at which the choice is made anew."""
        values = {"q": q.tolist(), "t": [t], "p": [0.0] * self.first}
        psi = np.array(self.psi(values), dtype=float).reshape(self.shape)
        if not np.all(np.isfinite(psi)):
            return np.append(np.ones(self.shape[1]), 0.0) if before is None else before
        w = np.zeros(self.shape[1])
        rest = psi.copy()
        for _ in range(self.shape[0]):
            size = np.linalg.norm(rest, axis=0) * (1.0 - w)
            k = int(np.argmax(size * self.weights))
            w[k] = 1.0
            if size[k] > 0.0:
                axis = rest[:, k] / size[k]
                rest -= np.outer(axis, axis @ rest)
        s = np.linalg.svd(psi[:, w > 0.0], compute_uv=False)
        return np.append(w, threshold(float((psi**2).sum()), s, WORN))


def independent(problem: Problem, z_rate: Sequence[Scalar], asked: object = None) -> Formulated:
    """Return the equations in independent coordinates.

    Raises
    ------
    CapabilityError : rows depend on each other, or joints stick and slip: their parameters change on the way.
    """
    if problem.dependent or problem.contact_joints:
        why = "redundant rows" if problem.dependent else "joints that stick or meet rigid stops"
        raise CapabilityError(
            f"independent coordinates do not go with {why}; allowed: projection, none, "
            "Baumgarte's {alpha, beta}",
            ("simulate.stabilisation",),
            key="simulate.stabilisation",
        )
    nv, choice = problem.model.nv, CoordinatePartition(problem)
    corrected = correction(choice.masked)
    q_step = problem.moved(corrected(problem.independent_rows.eta))
    rate = problem.independent_rows.velocity_residual(problem.v)
    v_step: list[Scalar] = [x - d for x, d in zip(problem.v, corrected(rate))]
    q: list[Any] = list(problem.q)
    for _ in range(NEWTON_STEPS):
        q = _at(problem, q_step, q, problem.v)
    v = _at(problem, v_step, q, problem.v)
    rates = _at(problem, [*problem.forward.qdd, *z_rate], q, v)
    samples = projection(problem)
    return Formulated(
        Expanded(tuple(rates[:nv]), tuple(rates[nv:])),
        Corrections(
            position=tuple(q_step),
            velocity=tuple(v_step),
            sample_position=tuple(samples[0]),
            sample_velocity=tuple(samples[1]),
        ),
        partition=choice,
    )


def _masked(psi: Matrix, w: Sequence[Expr]) -> Matrix:
    out = zeros(*psi.shape)
    for i in range(psi.shape[0]):
        out[i] = vector([x * y for x, y in zip(psi[i], w)])
    return out


def _at(problem: Problem, entries: Sequence[Scalar], q: Sequence[Scalar], v: Sequence[Scalar]) -> list[Any]:
    """Return expressions of (t, q, v, p) with other expressions in the place of q and v."""
    return renamed(entries, {"q": dict(enumerate(q)), "v": dict(enumerate(v))})


WORN_ROWS = 0.2  # of the closeness at the pose where W was chosen, at which it is chosen anew


class RowCombinations(Partition):
    """Parameters that make dependent rows independent around a pose (see ``formulations.system.Partition``)."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.groups = [(c, c.W.shape[0]) for c in problem.combinations]
        self.first = problem.parameter_count
        self.count = sum(group.numbers for group in problem.dependent)
        self.shape = problem.psi.shape
        self.psi = Evaluator(list(problem.psi.ravel()))

    def choose(self, t: float, q: Array, before: Array | None) -> Array:
        """Return the parameters (count,) at a pose.

        before : those in use so far. W keeps their orientation, so that determinants keep their sign.
        """
        values = {"q": q.tolist(), "t": [t], "p": [0.0] * self.first}
        psi = np.array(self.psi(values), dtype=float).reshape(self.shape)
        parts = []
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
            parts += [W.ravel(), [threshold(float((s**2).sum()), s, WORN_ROWS) if rank else WORN_ROWS]]
        return np.concatenate(parts)

    @property
    def functions(self) -> tuple[EventFunction, ...]:
        """The events at which W is chosen anew: closeness of its rows to losing rank, at its threshold."""
        problem = self.problem
        events = []
        for k, (combination, group) in enumerate(zip(problem.combinations, problem.dependent), start=1):
            if group.rank == 0:
                continue
            psi: Any = zeros(group.rank, problem.model.nv)
            for i in range(group.rank):
                for w, row in zip(combination.W[i], combination.rows):
                    psi[i] = psi[i] + w * problem.psi[row]
            value = closeness(psi, problem.psi[list(combination.rows)]) - combination.threshold
            events.append(EventFunction(f"rows {k}", value, kind=EventKind.REPARTITION, owner=self))
        return tuple(events)

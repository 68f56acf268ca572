"""Eigenvalues of the equations of motion along a run: how fast its modes decay and oscillate."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Expr, free_symbols
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.dynamics import Rolled
from robodyn_cli.formulations.system import System
from robodyn_cli.kernels.rolled import RolledForwardDynamics

Array = NDArray[Any]
DENSE = 120  # velocities up to which all eigenvalues are worth their time
LARGEST = 8  # eigenvalues of greatest magnitude that are looked for beyond
DIFFERENCE = 1e-6  # for long chains, whose compiled loops have no exact Jacobian
ZERO = 1e-9  # an eigenvalue this small beside the largest is rounding


@dataclasses.dataclass(frozen=True)
class Spectrum:
    """Eigenvalues [1/s] at some instants of a run.

    times : (T,). eigenvalues : (T, k) complex, of the linearised (q, v)-dot; with loops, of its part along the
    constraints; 0 where a state has fewer. complete : whether these are all, or the largest only.
    duration : of the run [s].
    """

    times: Array
    eigenvalues: Array
    complete: bool
    duration: float

    @property
    def fastest_decay(self) -> float:
        """Largest -Re of any eigenvalue [1/s]."""
        return float(max(0.0, -self.eigenvalues.real.min(initial=0.0)))

    @property
    def fastest_oscillation(self) -> float:
        """Largest |Im| of any eigenvalue [rad/s]."""
        return float(np.abs(self.eigenvalues.imag).max(initial=0.0))

    @property
    def fastest_growth(self) -> float:
        """Largest Re of any eigenvalue [1/s]: how fast a small change may grow at its worst instant."""
        return float(max(0.0, self.eigenvalues.real.max(initial=0.0)))

    @property
    def slowest(self) -> float:
        """The slowest rate that matters: the smallest eigenvalue above rounding, but no less than 1 / duration."""
        size = np.abs(self.eigenvalues)
        kept = size[size > ZERO * size.max(initial=0.0)]
        return max(float(kept.min(initial=np.inf)) if kept.size else 0.0, 1.0 / self.duration)

    def ratios(self) -> Array:
        """Return the stiffness ratio at each instant: the fastest decay over the slowest rate of the run (T,)."""
        decay = np.maximum(0.0, -self.eigenvalues.real.min(axis=1, initial=0.0))
        ratio: Array = decay / self.slowest
        return ratio

    @property
    def stiffness_ratio(self) -> float:
        """Largest stiffness ratio along the run."""
        return float(self.ratios().max(initial=0.0))


def spectrum(problem: Problem, system: System, times: Array, states: Array, duration: float) -> Spectrum:
    """Return the eigenvalues of the equations of motion at states (T, nx).

    Instants at which the Jacobian is not finite (a singular configuration) are left out.
    """
    J = jacobians(problem, system, times, states)
    rows = [(t, _reduce(j, tangent)) for t, j, tangent in zip(times, J, tangents(problem, times, states))]
    kept = [(t, j) for t, j in rows if np.all(np.isfinite(j))]
    complete = system.nv <= DENSE
    found = [_eigenvalues(j, complete) for _, j in kept]
    width = max((len(x) for x in found), default=0)
    table = np.zeros((len(found), width), dtype=complex)
    for row, values in zip(table, found):
        row[: len(values)] = values
    return Spectrum(np.array([t for t, _ in kept]), table, complete, duration)


def _eigenvalues(J: Array, complete: bool) -> Array:
    if complete:
        return np.linalg.eigvals(J)
    from scipy.sparse.linalg import ArpackNoConvergence, eigs

    start = np.linspace(1.0, 2.0, len(J))  # not random: two reports of a scene are the same
    try:
        return np.asarray(eigs(J, k=LARGEST, which="LM", v0=start, return_eigenvectors=False))
    except ArpackNoConvergence as error:
        return np.asarray(error.eigenvalues)


def _reduce(J: Array, tangent: Array | None) -> Array:
    """Return J seen along the constraints, whose directions are the orthonormal columns of ``tangent``."""
    return J if tangent is None else tangent.T @ J @ tangent


def jacobians(problem: Problem, system: System, times: Array, states: Array) -> Array:
    """Return d(v, v-dot)/d(q, v) at states (T, nx), shape (T, nq + nv, nq + nv)."""
    if isinstance(system.dynamics, Rolled):
        lower = np.stack([_differences(problem, system.dynamics, t, x) for t, x in zip(times, states)])
    else:
        lower = _exact(list(system.acceleration), problem, system, times, states)
    n = system.nq + system.nv
    J = np.zeros((len(times), n, n))
    J[:, : system.nq, system.nq :] = np.eye(system.nq, system.nv)
    J[:, system.nq :, :] = lower
    return J


def _groups(problem: Problem, system: System, times: Array, states: Array) -> dict[str, Any]:
    nq, nv = system.nq, system.nv
    columns = np.ascontiguousarray(states.T)
    return {
        "t": [np.asarray(times, dtype=float)],
        "q": columns[:nq],
        "v": columns[nq : nq + nv],
        "z": columns[nq + nv :] if len(columns) > nq + nv else np.zeros((system.nz, len(times))),
        "p": np.zeros(max(1, len(problem.model.parameters))),
    }


@np.errstate(all="ignore")
def _exact(
    rows: list[Any], problem: Problem, system: System, times: Array, states: Array
) -> Array:
    """Return the derivatives of expressions with respect to (q, v) at states, shape (T, len(rows), nq + nv)."""
    found = {e.value[1:]: e for e in free_symbols(rows)}
    places: list[tuple[int, Expr]] = []
    for group, count, offset in (("q", system.nq, 0), ("v", system.nv, system.nq)):
        places += [(offset + k, found[group, k]) for k in range(count) if (group, k) in found]
    out = np.zeros((len(times), len(rows), system.nq + system.nv))
    entries: list[Any] = []
    where: list[tuple[int, int]] = []
    for i, row in enumerate(jacobian(rows, [e for _, e in places])):
        for k, entry in row.items():
            entries.append(entry)
            where.append((i, places[k][0]))
    values = evaluate(entries, _groups(problem, system, times, states))
    for (i, k), value in zip(where, values):
        out[:, i, k] = value
    return out


def _differences(problem: Problem, dynamics: Rolled, time: float, x: Array) -> Array:
    """Return d(v-dot)/d(q, v) of a long chain by central differences, all columns in one sweep of the lanes."""
    nv = problem.model.nv
    n = 2 * nv
    steps = DIFFERENCE * (1.0 + np.abs(x[:n]))
    moved = np.repeat(x[None, :n], 2 * n, axis=0)
    moved[np.arange(n), np.arange(n)] += steps
    moved[n + np.arange(n), np.arange(n)] -= steps
    q, v = moved[:, :nv], moved[:, nv:]
    tau = np.zeros((2 * n, nv), order="F")
    groups = {"t": [np.full(2 * n, time)], "q": q.T, "v": v.T, "z": np.zeros((1, 2 * n)), "p": np.zeros(1)}
    for k, f in zip(dynamics.places, evaluate([dynamics.forces[k] for k in dynamics.places], groups)):
        tau[:, k] = f
    a = RolledForwardDynamics(problem.model)(np.asfortranarray(q), np.asfortranarray(v), tau)
    lower: Array = (a[:n] - a[n:]).T / (2.0 * steps)
    return lower


def tangents(problem: Problem, times: Array, states: Array) -> list[Array | None]:
    """Return orthonormal bases of the directions (dq, dv) along the constraints; None without constraints.

    Psi dq = 0 and Psi dv + d(Psi v + eta_t)/dq dq = 0.
    """
    rows = problem.constraints.rows
    if not rows:
        return [None] * len(times)
    nv, m = problem.model.nv, len(rows)
    rates = [sum((x * v for x, v in zip(row.psi, problem.v)), row.eta_t) for row in rows]
    groups = {
        "t": [np.asarray(times, dtype=float)],
        "q": states.T[:nv],
        "v": states.T[nv : 2 * nv],
        "p": np.zeros(max(1, len(problem.model.parameters))),
    }
    found: list[Array | None] = []
    psi = np.zeros((len(times), m, nv))
    for k, value in enumerate(evaluate(list(problem.psi.ravel()), groups)):
        psi[:, k // nv, k % nv] = value
    turn = np.zeros((len(times), m, nv))
    symbols = {e.value[1:]: e for e in free_symbols(rates)}
    places = [(k, symbols["q", k]) for k in range(nv) if ("q", k) in symbols]
    for i, row in enumerate(jacobian(rates, [e for _, e in places])):
        for k, value in zip(row, evaluate(list(row.values()), groups)):
            turn[:, i, places[k][0]] = value
    for one, two in zip(psi, turn):
        C = np.block([[one, np.zeros((m, nv))], [two, one]])
        if not np.all(np.isfinite(C)):
            found.append(None)
            continue
        _, s, vt = np.linalg.svd(C)
        rank = int((s > 1e-9 * s.max(initial=0.0)).sum())
        found.append(vt[rank:].T)
    return found

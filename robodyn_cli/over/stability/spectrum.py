"""Eigenvalues of the equations of motion along a run: how fast its modes decay and oscillate.

The instants lie at equal distances and where steps end, so that no spike is missed.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import RobodynError
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import free_symbols, is_nonzero
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.methods.stability_region import limits
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.kernels.rolled.kernels import RolledForwardDynamics
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.driver import Driver, MethodChange
from robodyn_cli.over.references import TrialReference
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.record import record
from robodyn_cli.results.result import evenly
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.stability import SpectrumKeys

DENSE = 120  # velocities up to which all eigenvalues are worth their time
LARGEST = 8  # eigenvalues of greatest magnitude that are looked for beyond
DIFFERENCE = 1e-6  # for long chains, whose compiled loops have no exact Jacobian
ZERO = 1e-9  # an eigenvalue this small beside the largest is rounding
HALVINGS = 24  # of the range of steps in which a contraction is looked for
NEAREST, FARTHEST = 1e-6, 1e3  # its ends, over the time in which rates change
TINY = 1e-150  # [1/s]: rates that change more slowly depend on no state
TOLERANCE = 1e-6  # of the run whose steps are looked at: loose steps follow every spike too
EVENLY = 65  # instants at equal distances, too
MOST = 1024  # ends of steps that are kept
WORK = 3e7  # instants times the cube of the states: what eigenvalues of all of them may cost
LONG_CHAIN, FEW = 30, 3  # velocities beyond which so few instants are worth their time


@record
class Spectrum:
    """Eigenvalues [1/s] at some instants of a run.

    times : (T,). eigenvalues : (T, k) complex, of the linearised equations of motion; with loops, of its part along the
    constraints; 0 where a state has fewer. jacobians : of the whole state there (T, n, n). nv : velocities in it.
    complete : whether these are all eigenvalues, or the largest only. duration : of the run [s].
    """

    times: Array
    eigenvalues: Array
    jacobians: Array
    nv: int
    complete: bool
    duration: float

    @cached_property
    def step_limits(self) -> Array:
        """The largest step of each of ``limits()`` at each instant (T, methods) [s]; infinite without a limit."""
        table = limits()
        needed = {limit.contraction for limit in table if limit.contraction is not None}
        reaches = {contraction: reach(self.jacobians, self.nv, contraction) for contraction in needed}
        columns = [
            [limit.largest_step(row) for row in self.eigenvalues]
            if limit.contraction is None
            else limit.real * reaches[limit.contraction]
            for limit in table
        ]
        return np.array(columns).T.reshape(len(self.times), len(table))

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
        return abs(float(self.ratios().max(initial=0.0)))

    @property
    def keys(self) -> SpectrumKeys:
        """What the summary says of it."""
        return SpectrumKeys(
            self.stiffness_ratio, self.fastest_decay, self.fastest_oscillation, self.fastest_growth,
            self.slowest, len(self.times), self.complete,
        )  # fmt: skip


def spectrum(problem: Problem, system: System, times: Array, states: Array, duration: float) -> Spectrum:
    """Return the eigenvalues of the equations of motion at states (T, nx).

    Instants at which the Jacobian is not finite (a singular configuration) are left out.
    """
    J = jacobians(problem, system, times, states)
    rows = [
        (t, _reduce(j, tangent)) for t, j, tangent in zip(times, J, tangents(problem, system, times, states))
    ]
    kept = [(t, j) for t, j in rows if np.all(np.isfinite(j))]
    complete = system.nv <= DENSE
    eigenvalues = [_eigenvalues(j, complete) for _, j in kept]
    whole = J[[bool(np.all(np.isfinite(j))) for _, j in rows]]
    width = max((len(x) for x in eigenvalues), default=0)
    table = np.zeros((len(eigenvalues), width), dtype=complex)
    for row, values in zip(table, eigenvalues):
        row[: len(values)] = values
    return Spectrum(np.array([t for t, _ in kept]), table, whole, system.nv, complete, duration)


def _eigenvalues(J: Array, complete: bool) -> Array:
    if complete:
        return np.linalg.eigvals(J)
    from scipy.sparse.linalg import ArpackNoConvergence, eigs

    start = np.linspace(1.0, 2.0, len(J))  # not random: two reports of a scene are the same
    try:
        return np.asarray(eigs(J, k=LARGEST, which="LM", v0=start, return_eigenvectors=False))
    except ArpackNoConvergence as error:
        return np.asarray(error.eigenvalues)


def reach(J: Array, nv: int, contraction: float) -> Array:
    """Return up to which h rho(A) the iteration for the stages of a collocation contracts that fast (T,) [s].

    The stages' rates (v-dot, z-dot) = f(q, v, z) enter q by h^2 A^2 and v, z by h A, so that one round multiplies their
    error by s^2 f_q + s f_(v, z) for s = h times each eigenvalue of A. Directions across the constraints take part.
    """
    rates = J[:, nv:]
    first = rates[:, :, nv:]  # by v and z
    second = np.zeros_like(first)
    second[:, :, :nv] = rates[:, :, :nv]  # by q
    bound = np.linalg.norm(first, axis=(1, 2)) + np.sqrt(np.linalg.norm(second, axis=(1, 2)))
    idle = ~(bound > TINY)  # rates that depend on no state
    bound[idle] = 1.0
    # s times the bound is what is looked for: so no rate is too fast or too slow
    by_bound = 1.0 / bound[:, None, None]
    first, second = first * by_bound, second * by_bound * by_bound
    low, high = np.full(len(J), np.log(NEAREST * contraction)), np.full(len(J), np.log(FARTHEST))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        s = np.exp(middle)[:, None, None]
        radius = np.abs(np.linalg.eigvals(s * s * second + s * first)).max(axis=1)
        beyond = ~(radius <= contraction)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    unlimited = idle | (high >= np.log(FARTHEST))
    return np.where(unlimited, np.inf, np.exp(low) / bound)


def _reduce(J: Array, tangent: Array | None) -> Array:
    """Return J seen along the constraints, whose directions are the orthonormal columns of ``tangent``."""
    return J if tangent is None else tangent.T @ J @ tangent


@np.errstate(all="ignore")
def jacobians(problem: Problem, system: System, times: Array, states: Array) -> Array:
    """Return the Jacobian of the whole state at states (T, nx), shape (T, nx, nx)."""
    n = system.size
    J = np.zeros((len(times), n, n))
    if isinstance(system.dynamics, Rolled):
        J[:, : system.nq, system.nq :] = np.eye(system.nq)
        for row, t, x in zip(J, times, states):
            row[system.nq :] = _differences(problem, system.dynamics, t, x)
        return J
    entries = system.jacobian.J
    places = [(i, k) for i in range(n) for k in range(n) if is_nonzero(entries[i, k])]
    p = _parameters(system, times, states)
    groups = _samples(system.own_groups(np.asarray(times, dtype=float), states, p))
    for (i, k), value in zip(places, evaluate([entries[place] for place in places], groups)):
        J[:, i, k] = value
    return J


def _parameters(system: System, times: Array, states: Array) -> Array:
    """Return the values of p that a run starts with, and beside them, a column a state, what its partition chooses."""
    if system.partition is None:
        return np.array(system.parameters) if system.parameters else np.zeros(1)
    chosen = [system.partition.choose(float(t), q, None) for t, q in zip(times, system.split(states)[0])]
    return np.concatenate([np.tile(system.parameters, (len(chosen), 1)), chosen], axis=1).T


def _samples(groups: dict[str, Any]) -> dict[str, Any]:
    """Return groups of samples (T, n) as the interpreter takes them: a row a symbol."""
    return {name: x if name == "p" else np.atleast_2d(x.T) for name, x in groups.items()}


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


def tangents(problem: Problem, system: System, times: Array, states: Array) -> list[Array | None]:
    """Return orthonormal bases of the directions (dq, dv, dz) along the constraints; None where there are none.

    Psi dq = 0 and Psi dv + d(Psi v + eta_t)/dq dq = 0. For mechanisms with quasi-velocities None too: there the
    directions across the constraints stay in, as eigenvalues 0.
    """
    rows = problem.constraints.rows
    if not rows or system.layout is not None:
        return [None] * len(times)
    nv, nz, m = problem.model.nv, system.nz, len(rows)
    rates = [sum((x * v for x, v in zip(row.psi, problem.v)), row.eta_t) for row in rows]
    groups = _samples(
        system.groups(np.asarray(times, dtype=float), states, _parameters(system, times, states))
    )
    bases: list[Array | None] = []
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
            bases.append(None)
            continue
        _, s, vt = np.linalg.svd(C)
        rank = int((s > 1e-9 * s.max(initial=0.0)).sum())
        along = vt[rank:].T
        free = np.zeros((2 * nv, nz)), np.zeros((nz, along.shape[1])), np.eye(nz)  # states of a controller
        bases.append(np.block([[along, free[0]], [free[1], free[2]]]))
    return bases


class StepEnds:
    """Supervisor that notes where steps end: each of them, or each 2nd, 4th, ... once there are very many."""

    def __init__(self, most: int) -> None:
        self.most, self.every, self.steps = most, 1, 1
        self.times: list[float] = []
        self.states: list[Array] = []

    def reconsider(self, driver: Driver) -> MethodChange | None:
        """Note the present state."""
        self.steps = driver.attempts + self.every
        if not self.times or driver.time > self.times[-1]:
            self.times.append(driver.time)
            self.states.append(driver.state)
        if len(self.times) >= 2 * self.most:
            del self.times[::2], self.states[::2]
            self.every *= 2
        return None


def instants(scene: Scene, ref: TrialReference, nq: int, nv: int) -> tuple[Array, Array, Array]:
    """Return times (T,), q (T, nq) and v (T, nv) of the reference at equal distances and where steps end."""
    count = EVENLY if nv <= LONG_CHAIN else FEW
    places = evenly(len(ref.times), count)
    q, v = np.split(ref.states[places], [nq], axis=1)
    if nv > LONG_CHAIN:
        return ref.times[places], q, v
    try:
        times, more_q, more_v = step_ends(scene, ref, int(max(EVENLY, min(MOST, WORK / (nq + nv) ** 3))))
    except RobodynError:
        return ref.times[places], q, v
    times = np.concatenate([ref.times[places], times])
    order = np.argsort(times, kind="stable")
    return times[order], np.concatenate([q, more_q])[order], np.concatenate([v, more_v])[order]


def step_ends(scene: Scene, ref: TrialReference, most: int) -> tuple[Array, Array, Array]:
    """Return times, q and v where steps of the reference's method end, ``most`` at most.

    Raises
    ------
    RobodynError : the method does not get through.
    """
    method = ref.methods[0].partition(" ")[0]
    changed = dataclasses.replace(scene.simulate, integrator=method, step=None)
    motion = build_motion(integrable(dataclasses.replace(scene, simulate=changed)), work=False)
    looks = StepEnds(most)
    options = Options(TOLERANCE, TOLERANCE, max_steps=scene.simulate.max_steps)
    driver = Driver(motion.system, method, options, motion.watchers, looks)
    driver.start(0.0, motion.start)
    driver.run(ref.until, Grid(ref.until, 0.0, 0), lambda t, x: None)
    kept = evenly(len(looks.times), most)
    q, v, _ = motion.system.split(np.array(looks.states)[kept])
    return np.array(looks.times)[kept], q, v

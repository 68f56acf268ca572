"""What a leap over a singular pose must not step over: contacts, jumps of the equations with the state, dead points.

A leap over a pose in which the loops' constraints lose rank, along the branch that the motion is on.

In the pose the constraints leave more freedom than before, multipliers may have a pole, and no method that needs them
at its stages can pass. The motion itself is smooth. So it is followed by collocation at Gauss nodes on both sides of
the pose, none of them close to it. At each node the constraints are well conditioned; positions lie on them, and the
accelerations come from the equations of motion projected on the directions that they leave free,

    N^T (M a + h - tau) = 0,   Psi a + gamma = 0,   Psi N = 0,

which contain no multipliers. Coefficients that decay and constraints that hold between the nodes, on the pose too,
prove that both sides belong to one smooth branch.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import moved, position_rates, slice_q
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import applied_powers, total
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.events import EventFunction, EventKind
from robodyn_cli.integrators.methods.collocation_tables import gauss_table
from robodyn_cli.kernels.samples import SampleKernel, compile_together
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

TIMES = 97  # at which a leap is looked at
AT_THE_POSE = 0.02  # part of a leap about the pose, where the input loses its grip in any case


class BesidePose:
    """Event functions of a run, to be evaluated along a leap, which no event ends.

    Parameters
    ----------
    functions : of all watchers of the run.
    """

    def __init__(self, problem: Problem, functions: Iterable[EventFunction]) -> None:
        self.problem = problem
        known = [f for f in functions if f.turns_motion or f.kind is EventKind.DEAD_POINT]
        switches = problem.switching.with_state
        self.names = [f.name for f in known] + [f"{key} switches" for key, _ in switches]
        self.direction = np.array([f.direction * f.turns_motion for f in known] + [0] * len(switches))
        self.grip = np.array(
            [f.kind is EventKind.DEAD_POINT for f in known] + [False] * len(switches), dtype=bool
        )
        values: list[Scalar] = [*(f.value for f in known), *(switch for _, switch in switches)]
        self.kernel = SampleKernel({"g": values}, STATE_GROUPS) if values else None

    def refuse_held(self, parameters: Array) -> str:
        """Return why no leap starts in the contact states and with the latches of ``parameters``, "" where one may."""
        for joint in self.problem.contact_joints:
            if parameters[joint.place]:
                return f"joint {joint.name!r} sticks or lies on its stop there"
        for latch in self.problem.latches:
            if latch.rigid and parameters[latch.place]:
                return f"latch {latch.name!r} is closed there"
        return ""

    def check(self, equations: LeapEquations, leap: PoseLeap, pose: float) -> None:
        """Refuse a leap in which a function changes its sign.

        Raises
        ------
        NotSmooth : names it, and the time.
        """
        if self.kernel is None:
            return
        t = np.linspace(leap.start.time, leap.end, TIMES)
        g = np.sign(equations.values(self.kernel, t, *leap.at(t))["g"])
        crossed = (g[:-1] * g[1:] < 0.0) & (g[:-1] * self.direction <= 0.0)
        near = np.abs(0.5 * (t[:-1] + t[1:]) - pose) < AT_THE_POSE * leap.length
        crossed &= ~(near[:, None] & self.grip)
        if crossed.any():
            k, which = np.argwhere(crossed)[0]
            raise NotSmooth(f"{self.names[which]} at t = {t[k]:.6g} s, too close to the pose")


EPS = float(np.finfo(float).eps)
LOST = 1e-6  # ratio of singular values at a located pose below which a direction counts as lost
HISTORY = 9  # points through which a guess is extrapolated
ROUNDS = 60
CLOSING = 9  # Newton steps that may close the loops at a node


class NotSmooth(Exception):
    """No smooth branch was found over the pose; says why."""


@record
class LeapState:
    """A moment of the motion: time [s], positions (nq,), velocities (nv,), further states (nz,) of the mechanism."""

    time: float
    q: Array
    v: Array
    z: Array


class LeapEquations:
    """The parts of the equations of motion as numbers, at many states at once."""

    def __init__(self, problem: Problem, work: bool = False) -> None:
        rows, nv = problem.constraints, problem.model.nv
        self.nv, self.m = nv, len(rows.rows)
        # rows of loops and of prescribed joints together: both constrain the motion
        self.rank = len(problem.independent_rows.rows)
        self.loops, self.loop_rank = rows.of_loops, problem.loop_rank
        geometry = {"eta": rows.eta, "psi": list(problem.psi.ravel())}
        rates: dict[str, list[Any]] = {
            "M": list(problem.mass_matrix.ravel()),
            "f": list(problem.applied - problem.bias),
            "gamma": rows.gamma,
            "eta_t": rows.eta_t,
            "qd": position_rates(problem.model, problem.q, problem.v),
            "power": [total(applied_powers(problem).values())] if work else [],
        }
        self.work = work
        self.geometry = SampleKernel(geometry, STATE_GROUPS)
        self.rates = SampleKernel({k: x for k, x in rates.items() if x}, STATE_GROUPS)
        self.shift = SampleKernel({"q": _moved(problem)}, STATE_GROUPS)
        compile_together(self.geometry, self.rates, self.shift)
        self.p = np.zeros(max(1, len(problem.model.parameters)))

    def in_contact(self, parameters: Array) -> None:
        """Take the values of p that say which joints slip and how; joints that are held count as free."""
        if len(parameters):
            self.p = parameters

    def values(
        self, kernel: SampleKernel, t: Array, q: Array, v: Array, z: Array | None = None
    ) -> dict[str, Array]:
        """Return what a kernel gives at times (T,) and states (T, ...), in the present contact states."""
        groups = {"t": t, "q": q, "v": v, "z": np.zeros((len(t), 1)) if z is None else z, "p": self.p}
        return kernel.evaluate(len(t), groups)

    def constraints(self, t: Array, q: Array) -> tuple[Array, Array]:
        """Return eta (T, m) and Psi (T, m, nv)."""
        values = self.values(self.geometry, t, q, np.zeros((len(t), self.nv)))
        return values["eta"], values["psi"].reshape(len(t), self.m, self.nv)

    def singular_values(self, t: Array, q: Array) -> Array:
        """Return those of the loops' Psi (T, r), largest first, but for the ones that are zero in every pose."""
        psi = self.constraints(t, q)[1][:, self.loops]
        sigma: Array = np.asarray(np.linalg.svd(psi, compute_uv=False), dtype=float)
        return sigma[:, : self.loop_rank]

    def moved(self, q: Array, dq: Array) -> Array:
        """Return positions (T, nq) after steps dq (T, nv) along the joints' manifolds."""
        return self.values(self.shift, np.zeros(len(q)), q, dq)["q"]


def _moved(problem: Problem) -> list[Any]:
    """Return q (nq,) after a step, given in place of v, on the joints' manifolds."""
    q = moved(problem.model, problem.q, problem.v)
    for body in problem.model.bodies:
        if body.joint.quasi:
            q[body.q : body.q + body.joint.nq] = body.joint.normalise(slice_q(body, q))
    return q


@record
class Bases:
    """At each node: r independent combinations of the constraint rows, and the directions E that they leave free.

    combination : (n, r, m). free : (n, nv - r, nv).
    """

    combination: Array
    free: Array

    @staticmethod
    def at(psi: Array, rank: int) -> Bases:
        """Return the bases of Psi (n, m, nv) by singular value decomposition."""
        U, _, Vt = np.linalg.svd(psi)
        return Bases(np.swapaxes(U[:, :, :rank], 1, 2), Vt[:, rank:])

    def inverse(self, psi: Array) -> Array:
        """Return the inverse (n, nv, nv) of the rows W Psi and E together."""
        return np.linalg.inv(np.concatenate([self.combination @ psi, self.free], axis=1))

    def step(self, inverse: Array, residual: Array) -> Array:
        """Return the step (n, nv) that takes the rows by ``residual`` (n, m), nothing along E."""
        rank = self.combination.shape[1]
        return np.einsum(
            "nij,nj->ni", inverse[:, :, :rank], np.einsum("nij,nj->ni", self.combination, residual)
        )


class Collocation:
    """One leap: from a state over ``length`` [s], n nodes."""

    def __init__(self, equations: LeapEquations, start: LeapState, length: float, nodes: int) -> None:
        self.equations, self.start, self.length, self.n = equations, start, length, nodes
        table = gauss_table(nodes)
        self.A, self.c = table.A[:nodes, :nodes], table.c[:nodes]
        self.times = start.time + length * self.c

    # -- the curve ------------------------------------------------------------------------------------
    def guess(self, history: Sequence[LeapState]) -> tuple[Array, Array, Bases]:
        """Extrapolate from node to node, closing the loops at each: q (n, nq), v (n, nv) and the bases."""
        times = [s.time for s in history]
        known_q, known_v = [s.q for s in history], [s.v for s in history]
        bases = []
        for t in self.times.tolist():
            q, v = extrapolated(times, known_q, t)[None], extrapolated(times, known_v, t)[None]
            at = np.array([t])
            base = Bases.at(self.equations.constraints(at, q)[1], self.equations.rank)
            q = self.closed(at, q, base)
            bases.append(base)
            times.append(t)
            known_q.append(q[0])
            known_v.append(v[0])
        n = self.n
        base = Bases(*(np.concatenate([getattr(f, k) for f in bases]) for k in ("combination", "free")))
        return np.array(known_q[-n:]), np.array(known_v[-n:]), base

    def closed(self, t: Array, q: Array, bases: Bases) -> Array:
        """Return q (n, nq) on the constraints, moved across E only.

        Raises
        ------
        NotSmooth : Newton's steps do not contract.
        """
        last = np.inf
        for _ in range(CLOSING):
            eta, psi = self.equations.constraints(t, q)
            dq = -bases.step(bases.inverse(psi), eta)
            size = float(np.abs(dq).max())
            if not np.isfinite(size) or (size > 0.5 * last and size > 1e-7):
                raise NotSmooth("the loops do not close beside the pose")
            if size > 0.3 * last:
                return q  # at rounding
            q, last = self.equations.moved(q, dq), size
            if size < 4 * EPS:
                return q
        if last > 1e-7:
            raise NotSmooth("the loops do not close beside the pose")
        return q

    # -- the motion -----------------------------------------------------------------------------------
    def rates(self, q: Array, v: Array, z: Array, bases: Bases) -> tuple[Array, Array, Array, Array]:
        """Return v put on the constraints, q-dot, v-dot and z-dot at the nodes."""
        e, n = self.equations, self.n
        _, psi = e.constraints(self.times, q)
        values = e.values(e.rates, self.times, q, v, z)
        inverse = bases.inverse(psi)
        drift = np.einsum("nij,nj->ni", psi, v) + values["eta_t"]
        v = v - bases.step(inverse, drift)
        values = e.values(e.rates, self.times, q, v, z)
        M = values["M"].reshape(n, e.nv, e.nv)
        bound = -bases.step(inverse, values["gamma"])
        N = inverse[:, :, e.rank :]
        Nt = np.swapaxes(N, 1, 2)
        force = values["f"] - np.einsum("nij,nj->ni", M, bound)
        free = np.linalg.solve(Nt @ M @ N, (Nt @ force[:, :, None]))[:, :, 0]
        a = bound + np.einsum("nij,nj->ni", N, free)
        return v, values["qd"], a, self._work_rate(values, inverse, bases, np.einsum("nij,nj->ni", M, a))

    def _work_rate(self, values: dict[str, Array], inverse: Array, bases: Bases, Ma: Array) -> Array:
        """Return z-dot (n, nz): the power of what is applied, and -lambda eta_t of rows that depend on time."""
        if not self.equations.work:
            return np.zeros((self.n, 0))
        power = values["power"][:, 0] if "power" in values else np.zeros(self.n)
        if np.any(values["eta_t"] != 0.0):
            given = np.einsum("nji,nj->ni", inverse[:, :, : self.equations.rank], Ma - values["f"])
            power = power - np.einsum("nr,nrm,nm->n", given, bases.combination, values["eta_t"])
        return power[:, None]

    def solve(self, history: Sequence[LeapState]) -> PoseLeap:
        """Return the leap.

        Raises
        ------
        NotSmooth : no smooth branch leads over the pose.
        """
        q, v, bases = self.guess(history)
        z = np.repeat(self.start.z[None], self.n, axis=0)
        size = 1.0 + float(np.abs(q).max())
        A, h, s = self.A, self.length, self.start
        last, self.rounds = np.inf, 0
        for self.rounds in range(1, ROUNDS + 1):
            v, qd, a, zd = self.rates(q, v, z, bases)
            new_v, z = s.v + h * (A @ a), s.z + h * (A @ zd)
            new_q = self.closed(self.times, s.q + h * (A @ qd), bases)
            change = float(np.abs(new_q - q).max()) + h * float(np.abs(new_v - v).max())
            q, v = new_q, new_v
            if not np.isfinite(change) or change > 1e3 * size:
                raise NotSmooth("the motion over the pose does not settle")
            if (change < 1e-9 * size and change > 0.3 * last) or change < 4 * EPS * size:
                break
            last = change
        else:
            raise NotSmooth(f"the motion over the pose does not settle (change {change:.1g})")
        self.change = change
        v, qd, a, zd = self.rates(q, v, z, bases)
        return PoseLeap(s, h, *(self._series(x) for x in (qd, a, zd)))

    def _series(self, x: Array) -> Array:
        """Return the Legendre coefficients (n, k) of what has the values x (n, k) at the nodes."""
        if not x.shape[1]:
            return x
        coefficients: Array = np.asarray(
            np.polynomial.legendre.legfit(2 * self.c - 1, x, self.n - 1), dtype=float
        )
        return coefficients


@record
class PoseLeap:
    """A motion over a pose: Legendre coefficients (n, ...) of q-dot, v-dot and z-dot over the step."""

    start: LeapState
    length: float
    qd: Array
    a: Array
    zd: Array

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, v and z at times t (T,) within the step."""
        x = 2.0 * (t - self.start.time) / self.length - 1.0
        every = np.polynomial.legendre.legvander(x, len(self._integrals) - 1) @ self._integrals
        s, h = self.start, 0.5 * self.length
        q, v, z = np.split(every, np.cumsum([len(s.q), len(s.v)]), axis=1)
        return s.q + h * q, s.v + h * v, s.z + h * z

    @cached_property
    def _integrals(self) -> Array:
        """The Legendre coefficients (n + 1, nq + nv + nz) of the integrals of q-dot, v-dot and z-dot."""
        rates = np.concatenate([self.qd, self.a, self.zd], axis=1)
        integrals: Array = np.polynomial.legendre.legint(rates, lbnd=-1)
        return integrals

    @property
    def end(self) -> float:
        """The time at which it ends [s]."""
        return self.start.time + self.length

    @property
    def middle(self) -> Array:
        """The times of the two nodes beside the pose [s]."""
        n = len(self.qd)
        return self.start.time + self.length * gauss_table(n).c[n // 2 - 1 : n // 2 + 1]

    @property
    def tail(self) -> float:
        """The last coefficients of positions [rad, m]."""
        n = len(self.qd)
        return float(0.5 * self.length * np.abs(self.qd[-2:]).max() / n)


def leap_rounding(equations: LeapEquations, leap: PoseLeap) -> float:
    """Return the rounding that the nodes close to the pose bring into v over a leap, by the last coefficients of v-dot.

    There the constraints are ill conditioned: rounding of v-dot is many times that of the motion, and does not fall
    with the tolerance. n values with errors of size e have coefficients of size e, and a mean with an error
    e / sqrt(n). Behind the leap the loops are closed again, which leaves what is along them.
    """
    end = np.array([leap.end])
    free = Bases.at(equations.constraints(end, leap.at(end)[0])[1], equations.rank).free[0]
    along = leap.a[-2:] @ free.T @ free
    return float(0.5 * leap.length * np.abs(along).max(initial=0.0) / np.sqrt(len(leap.a)))


def extrapolated(times: Sequence[float], values: Sequence[Array], t: float) -> Array:
    """Return values at t by Neville's scheme, of the degree whose last correction is smallest."""
    near = np.argsort(np.abs(np.array(times) - t))[:HISTORY]
    x, T = np.array(times)[near], np.array(values)[near]
    best, estimate = np.inf, T[0]
    for k in range(1, len(x)):
        span = (x[:-k] - x[k:])[:, None]
        before = T[0]
        T = ((t - x[k:])[:, None] * T[:-1] + (x[:-k] - t)[:, None] * T[1:]) / span
        change = float(np.abs(T[0] - before).max())
        if change < best:
            best, estimate = change, T[0]
    return estimate

"""Linear differential equations on blocks of equidistant samples, all blocks at once.

    x = (q, v, z),  q-dot = v,  (v, z)-dot = A(t) x + B(t)

On a block of nine samples the rates are the polynomial of degree 8 that satisfies the equations at each of them: the
block implicit one-step method with eight new values, of order 10 and A-stable (Watts and Shampine 1972, "A-stable block
implicit one-step methods", BIT 12). As the equations are linear, each block gives its end as a linear function of its
beginning, so that the blocks need not wait for one another.

The variational equations of a motion: how its states change with keys of the scene.

    x-dot = f(t, x, k),  S = dx/dk:  S-dot = f_x S + f_k

(Hairer, Norsett and Wanner 1993, "Solving Ordinary Differential Equations I", section I.14). The equations are those
without any stabilisation: the loops hold for all k, so S satisfies their derivatives by itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.system import System
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.sensitivity.gradients import Columns, Gradients, at_one_point
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

NEW = 8  # samples of a block behind its first: the largest number with which the method is A-stable


@cache
def integrals() -> Array:
    """Return Q (9, 9): integrals from 0 to k/8 of the polynomials that are 1 at one of nine nodes, 0 at the others."""
    nodes = np.arange(NEW + 1) / NEW
    powers = np.vander(nodes, NEW + 1, increasing=True)
    of_powers = nodes[:, None] ** np.arange(1, NEW + 2) / np.arange(1, NEW + 2)
    Q: Array = np.linalg.solve(powers.T, of_powers.T).T
    return Q


def nodes_of(samples: Sequence[int]) -> NDArray[np.int64]:
    """Return the numbers of the samples of each block (P, 9), where parts of a motion have so many samples each, 8
    blocks + 1.
    """
    nodes, first = [], 0
    for count in samples:
        nodes.append(first + np.arange(0, count - 1, NEW)[:, None] + np.arange(NEW + 1))
        first += count
    return np.concatenate(nodes)


def transfers(A: Array, B: Array, lengths: Array, nq: int) -> tuple[Array, Array]:
    """Return for each block what x at its beginning is multiplied by (P, nx, nx), and what is added (P, nx, K).

    Parameters
    ----------
    A, B : at the nodes of the blocks (P, 9, nr, nx) and (P, 9, nr, K). lengths : of the blocks (P,) [s]. nq : how many
        positions lead x.
    """
    blocks, _, nr, nx = A.shape
    # states that stay, as those of a sampled controller do between its updates, have no part in the solution
    moving = np.array([k for k in range(nr) if k < nq or A[:, :, k].any() or B[:, :, k].any()], dtype=int)
    A, B, nr = A[:, :, moving], B[:, :, moving], len(moving)
    Q, h = integrals(), lengths[:, None, None, None]
    QQ = Q @ Q
    # x at the nodes is ``begin`` times x at the beginning and h Q, for positions h^2 QQ, times the rates
    begin = np.tile(np.eye(nx), (blocks, NEW + 1, 1, 1))
    begin[:, :, :nq, nq : 2 * nq] += h * (np.arange(NEW + 1) / NEW)[:, None, None] * np.eye(nq)
    scaled, of_q = h * A[..., nq + moving], h * h * A[..., :nq]
    by_rates = Q[None, :, None, :, None] * scaled[:, :, :, None, :]
    by_rates[..., :nq] += QQ[None, :, None, :, None] * of_q[:, :, :, None, :]
    size = (NEW + 1) * nr
    matrix = np.eye(size) - by_rates.reshape(blocks, size, size)
    right = np.concatenate([A @ begin, B], axis=3).reshape(blocks, size, -1)
    rates = np.linalg.solve(matrix, right).reshape(blocks, NEW + 1, -1)
    h = lengths[:, None, None]
    ends = np.zeros((blocks, nx, right.shape[2]))
    ends[:, :, :nx] = begin[:, -1]
    ends[:, nq + moving] += h * (Q[-1] @ rates).reshape(blocks, nr, -1)
    ends[:, :nq] += h * h * (QQ[-1] @ rates).reshape(blocks, nr, -1)[:, :nq]
    return ends[:, :, :nx], ends[:, :, nx:]


@record
class Slopes:
    """Expressions at one point: values (n,), derivatives by the state (n, nx), by keys (n, K), by time (n,)."""

    values: Array
    state: Array
    keys: Array
    time: Array


@record
class StatePoint:
    """A point of a motion: time t, x (nx,), x-dot, S (nx, K), and the rates of x-dot and S."""

    t: float
    x: Array
    rate: Array
    S: Array
    rate_rate: Array
    S_rate: Array

    def moved(self, dt: float) -> StatePoint:
        """Return the point a very short time later."""
        x, rate, S = self.x + dt * self.rate, self.rate + dt * self.rate_rate, self.S + dt * self.S_rate
        return dataclasses.replace(self, t=self.t + dt, x=x, rate=rate, S=S)


@record
class FigureSlopes:
    """Figures at a point of a motion: values and rates along it (n,), derivatives by keys and the sizes of their terms
    (n, K)."""

    values: Array
    rates: Array
    slopes: Array
    sizes: Array


@record
class EndSlopes:
    """Derivatives at the end of a motion: of its time (K,), of positions (nq, K), rates (nv, K), figures (n, K)."""

    time: Array
    q: Array
    v: Array
    figures: Array


@record
class SlopesAtEnd:
    """Rows of derivatives by keys (1 + nq + nv + n, K): of the end's time, positions, rates and figures.

    sizes : of the terms that they are sums of, which rounding leaves its share of. doubts : what the error of the end's
    time leaves of them.
    """

    values: Array
    sizes: Array
    doubts: Array


@record
class Linearised:
    """Equations at times t (T,) and states x (T, nx): x-dot (T, nx), and for the rates of v and z their derivatives by
    the state, A (T, nr, nx), by keys, B (T, nr, K), and by time (T, nr).

    nq : positions, which lead x.
    """

    t: Array
    x: Array
    rate: Array
    A: Array
    B: Array
    time: Array
    nq: int

    def point(self, k: int, S: Array) -> StatePoint:
        """Return sample k as a point of the motion with S = dx/dk there."""
        rate, lead = self.rate[k], slice(self.nq, 2 * self.nq)
        rate_rate = np.concatenate([rate[lead], self.A[k] @ rate + self.time[k]])
        S_rate = np.concatenate([S[lead], self.A[k] @ S + self.B[k]])
        return StatePoint(float(self.t[k]), self.x[k], rate, S, rate_rate, S_rate)


class Variational:
    """The equations of a motion with their derivatives by the state and by numbers at places of the scene.

    Parameters
    ----------
    places : of the numbers, such as ``robot.links.link1.mass``; an empty one stands for a key that is no number of the
        equations.

    Raises
    ------
    CapabilityError : an operation, or a number, has no derivative.
    """

    def __init__(self, motion: Motion, places: Sequence[str]) -> None:
        self.system = _plain(motion)
        self.keys = len(places)
        self._places = tuple(places)
        self._known: dict[tuple[int, ...], tuple[Any, ...]] = {}  # gradients, by the identity of expressions
        rates = self.system.rates
        self._rates = Gradients({"f": rates}, self.columns(rates), STATE_GROUPS)

    def columns(self, outputs: Sequence[Scalar]) -> Columns:
        """Return what expressions are differentiated by: the state, time, then the keys."""
        system, n = self.system, self.system.size
        first = {"q": 0, "v": system.nq, "z": system.nq + system.nv, "t": n}
        symbols = [e for e in free_symbols(outputs) if e.value[1] in first]
        return Columns({e.index: first[e.value[1]] + e.value[2] for e in symbols}, n + 1, self._places)

    def along(self, t: Array, x: Array, p: Array) -> Linearised:
        """Return the equations linearised at times t (T,) and states x (T, nx), with the motion's parameters p (T, np).

        Raises
        ------
        CapabilityError : something there is not finite.
        """
        system, n = self.system, self.system.size
        f, J = self._rates(len(t), system.own_groups(t, x, p))["f"]
        rate = np.concatenate([x[:, system.nq : system.nq + system.nv], f], axis=1)
        if not (np.isfinite(J).all() and np.isfinite(rate).all()):
            raise CapabilityError("derivatives along the motion are not finite")
        return Linearised(t, x, rate, J[:, :, :n], J[:, :, n + 1 :], J[:, :, n], system.nq)

    def slopes(self, outputs: Sequence[Scalar], t: float, x: Array, **more: Array) -> Slopes:
        """Return the derivatives of expressions of the integrator's symbols at time t and state x (nx,).

        more : values of symbols that nothing is differentiated by, by group.
        """
        n = self.system.size
        identity = tuple(map(id, outputs))
        if identity not in self._known:
            self._known[identity] = outputs, at_one_point(outputs, self.columns(outputs))
        _, function = self._known[identity]
        values, J = function({**self.system.own_groups([t], x, np.zeros(0)), **more})
        return Slopes(values, J[:, :n], J[:, n + 1 :], J[:, n])

    def figures(
        self,
        figures: Sequence[Scalar],
        at: StatePoint,
        shift: Array,
        sizes: tuple[Array, Array],
        p: Array,
    ) -> FigureSlopes:
        """Return figures at a point of the motion whose time moves by ``shift`` (K,) with the keys.

        sizes : of the terms of S (nx, K), and of ``shift``. p : parameters of latches.

        Raises
        ------
        CapabilityError : a figure has no derivative that is finite.
        """
        if not figures:
            return FigureSlopes(*np.zeros((2, 0)), *np.zeros((2, 0, len(shift))))
        own = self.slopes(figures, at.t, at.x, p=p)
        rates, parts = own.time + own.state @ at.rate, np.abs(own.time) + np.abs(own.state) @ np.abs(at.rate)
        slopes = own.keys + own.state @ at.S + np.outer(rates, shift)
        if not np.isfinite(slopes).all():
            raise CapabilityError("derivatives at the end are not finite")
        terms = np.abs(own.keys) + np.abs(own.state) @ sizes[0] + np.outer(parts, sizes[1])
        return FigureSlopes(own.values, rates, slopes, terms)


def programs_of(motion: Motion) -> list[Program]:
    """Return the code of the rates of a motion, and of what a sampled controller sets."""
    system = _plain(motion)
    updates = () if system.updates is None else system.updates.programs
    return [make_program({"f": system.rates}, STATE_GROUPS), *updates]


def _plain(motion: Motion) -> System:
    """Return the equations of a motion as they are: no stabilisation, no events, no work."""
    return build_system(motion.problem, "none", work=False, expanded=True)

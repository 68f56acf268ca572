"""Radau IIA collocation for stiff motion, stages and eigenvalues side by side in the SIMD lanes.

The stage increments Z solve Z = h A F(x0 + Z). Newton's matrix (h A)^-1 x E - E x J falls apart into one system
g_l / h E - J for each eigenvalue g_l of A^-1 (Hairer and Wanner 1996, IV.8); one sweep of complex elimination solves
them all, with one eigenvalue in each lane. The Jacobian is exact and new in each step. The method is L-stable, and its
order inside a stiff step is at least that of its stages.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.methods.radau_tables import radau_table
from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.control import (
    Attempt,
    Controller,
    mean_squares,
    tolerance,
)
from robodyn_cli.integrators.stepping.factors import ComplexFactors, Pair
from robodyn_cli.integrators.stepping.newton import Limits, Rounds
from robodyn_cli.integrators.stepping.stepper import Method, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Block, Function, Value
from robodyn_cli.kernels.program import Program

ITERATIONS = 12
LIMITS = Limits(ITERATIONS, converged=0.01, rounding=0.1, shorter=0.4, remembers=True)
SAFETY = 0.9


class Radau(Method):
    """Radau IIA with s stages: order 2 s - 1, L-stable, dense output of order s."""

    def __init__(self, facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.stages = self.dense_order = (facts.order + 1) // 2

    def linearisation(self, system: System) -> Program:
        return system.complex_linearisation

    def dense_size(self, system: System) -> int:
        return system.size * (radau_table(self.stages).lanes + 1)

    def stepper(self, w: Writer) -> RadauStepper:
        return RadauStepper(self, w)


class RadauStepper(Stepper[Array]):
    """Writes steps of Radau IIA; the stage increments Z are what dense output needs."""

    def __init__(self, method: Radau, w: Writer) -> None:
        super().__init__(method, w)
        f, n = w.f, w.system.size
        self.stages, self.table = method.stages, radau_table(method.stages)
        T = self.table
        self.Z, self.x, self.F, self.D = (Array(f, f.slot(T.lanes, n), T.lanes) for _ in range(4))
        self.start = Array(f, f.slot(T.shifts, n), T.shifts)
        self.rate0, self.error = Array(f, f.slot(1, n)), Array(f, f.slot(1, n))
        self.square = f.slot()
        self.rounds = Rounds(w, LIMITS)
        self.control = Controller(
            self.stages + 1, safety=SAFETY, floor=1e-9, least=0.2, most=8.0, trend_safety=SAFETY
        )

    # -- the step -------------------------------------------------------------------------------------
    def attempt(self, t: Value, h: Value, failed: Block) -> Attempt[Array]:
        f, w, T = self.f, self.w, self.table
        n = w.system.size
        per_h = 1.0 / h
        for c in range(n):
            self.start[c] = f.splat(w.state[c], T.shifts)
        wide = f.splat(per_h, T.shifts)
        g = (f.constant(list(T.g.real)) * wide, f.constant(list(T.g.imag)) * wide)
        factors = ComplexFactors(w, f.splat(t, T.shifts), self.start, g)
        w.rate(t, w.state, self.rate0)
        w.count(IntegerSlot.EVALUATIONS, 2)
        self._predict(h)
        self._iterate(factors, t, h, failed)
        for c in range(n):
            w.new[c] = w.state[c] + f.lane(self.Z[c], self.stages - 1)
        square = self._error(factors, t, h)
        # a step that took many rounds wants a shorter one (Hairer and Wanner 1996, IV.8)
        most = 2.0 * ITERATIONS + 1.0
        with f.strict():
            scale = most / (f.to_double(f.load_int(self.rounds.done)) + most)
        return Attempt(square, self.Z, scale=scale)

    def _iterate(self, factors: ComplexFactors, t: Value, h: Value, failed: Block) -> None:
        """Solve for the increments by simplified Newton iteration; ``failed`` is left where it does not converge."""
        f, w, T = self.f, self.w, self.table
        n, lanes = w.system.size, T.lanes
        times = f.muladd(f.splat(h, lanes), f.constant(list(T.c)), f.splat(t, lanes))
        with self.rounds.repeat(h, failed) as judge:
            for c in range(n):
                self.x[c] = self.Z[c] + f.splat(w.state[c], lanes)
            w.rate(times, self.x, self.F)
            w.count(IntegerSlot.EVALUATIONS)
            wide_h = f.splat(h, lanes)
            for c in range(n):
                self.D[c] = f.muladd(wide_h, combine(f, self.F[c], T.A, lanes), -self.Z[c])
            per_h = f.splat(1.0 / h, 2 * T.shifts)
            pairs = [halves(f, combine(f, self.D[c], T.to, 2 * T.shifts) * per_h) for c in range(n)]
            changes = [combine(f, joined(f, x), T.back, lanes) for x in factors.solve(pairs)]
            judge(self._update(changes))

    def _update(self, changes: Sequence[Value]) -> Value:
        """Add a round's changes to the increments; return their norm in units of the tolerance."""
        f, w, lanes = self.f, self.w, self.table.lanes
        with f.strict():
            square = Total(f, lanes)
            for c, change in enumerate(changes):
                Z = self.Z[c] + change
                self.Z[c] = Z
                size = f.max(f.abs(w.state[c]), f.reduce("maximum", f.abs(Z)))
                d = change * f.splat(1.0 / tolerance(w, size), lanes)
                square.add_product(d, d)
            return f.sqrt(f.reduce("add", square.value) * (1.0 / (lanes * len(changes))))

    def _predict(self, h: Value) -> None:
        """Extrapolate the last step's polynomial to the new stages."""
        f, T = self.f, self.table
        u = f.splat(h / self.w.get(DoubleSlot.H_OLD), T.lanes) * f.constant(list(T.c))
        for c in range(self.w.system.size):
            self.Z[c] = self._polynomial(c, u)

    # -- error ----------------------------------------------------------------------------------------
    def _error(self, factors: ComplexFactors, t: Value, h: Value) -> Value:
        """Return the mean square of the error in units of the tolerance."""
        f, w = self.f, self.w
        self._estimate(factors, h)
        fresh = f.compare_int("eq", f.load_int(w.integer_at(IntegerSlot.ACCEPTED)), 0)
        large = f.compare("oge", f.load(self.square), 1.0)
        # once more from where the estimate leads, which damps what is stiff (Hairer and Wanner 1996, IV.8.20)
        with f.when(large & (w.rejected_before() | fresh)):
            for c in range(w.system.size):
                self.error[c] = w.state[c] + self.error[c]
            w.rate(t, self.error, self.rate0)
            w.count(IntegerSlot.EVALUATIONS)
            self._estimate(factors, h)
        return f.load(self.square)

    def _estimate(self, factors: ComplexFactors, h: Value) -> None:
        """Set the error of each component, filtered, and their mean square in units of the tolerance."""
        f, w, T = self.f, self.w, self.table
        n = w.system.size
        pairs: list[Pair] = []
        g = f.constant(float(T.g[0].real)) / h
        weights = f.constant([*T.e, *[0.0] * (T.lanes - self.stages)])
        for c in range(n):
            raw = f.muladd(h * T.gamma, self.rate0[c], f.reduce("add", self.Z[c] * weights)) * g
            pairs.append((f.splat(raw, T.shifts), f.constant(0.0, T.shifts)))
        for c, (re, _) in enumerate(factors.solve(pairs)):
            self.error[c] = f.lane(re, 0)
        f.store(mean_squares(w, 1, lambda c: [self.error[c]])[0], self.square)

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: Array) -> None:
        f, w, T = self.f, self.w, self.table
        n = w.system.size
        for c in range(n):
            f.store(combine(f, kept[c], T.P, T.lanes), f.offset("%dense", c * T.lanes))
            f.store(w.new[c], f.offset("%dense", n * T.lanes + c))

    def _polynomial(self, c: int, u: Value) -> Value:
        """Return by how much component c differs at u from the end of the last step."""
        f, lanes = self.f, self.table.lanes
        p: Value | None = None
        for k in reversed(range(self.stages)):
            d = f.splat(f.load(f.offset("%dense", c * lanes + k)), u.width)
            p = d if p is None else f.muladd(p, u, d)
        assert p is not None
        return p * u

    def dense(self, u: Value, h: Value, out: Array) -> None:
        f, n = self.f, self.w.system.size
        for c in range(n):
            end = f.splat(f.load(f.offset("%dense", n * self.table.lanes + c)), u.width)
            out[c] = end + self._polynomial(c, u)


def combine(f: Function, x: Value, matrix: np.ndarray, width: int) -> Value:
    """Return matrix (width, m) times the first m lanes of x; two sums to shorten the chain."""
    sums: list[Value | None] = [None, None]
    for i in range(matrix.shape[1]):
        column = f.constant([float(e) for e in matrix[:, i]])
        entry = f.splat(f.lane(x, i), width)
        part = sums[i & 1]
        sums[i & 1] = entry * column if part is None else f.muladd(entry, column, part)
    total = sums[0]
    assert total is not None
    return total if sums[1] is None else total + sums[1]


def halves(f: Function, x: Value) -> Pair:
    """Return the lower and the upper half of the lanes."""
    width = x.width // 2
    if width == 1:
        return f.lane(x, 0), f.lane(x, 1)
    return f.shuffle(x, x, range(width)), f.shuffle(x, x, range(width, 2 * width))


def joined(f: Function, pair: Pair) -> Value:
    """Return two vectors as one, the first in the lower lanes."""
    width = pair[0].width
    if width == 1:
        return f.pack(list(pair), 2)
    return f.shuffle(*pair, range(2 * width))

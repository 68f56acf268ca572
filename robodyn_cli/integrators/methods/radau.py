"""Radau IIA collocation for stiff motion, stages and eigenvalues side by side in the SIMD lanes.

The stage increments Z solve Z = h A F(x0 + Z). Newton's matrix (h A)^-1 x E - E x J falls apart into one system
g_l / h E - J for each eigenvalue g_l of A^-1 (Hairer and Wanner 1996, IV.8); one sweep of complex elimination solves
them all, an eigenvalue a lane. The Jacobian is exact and new in each step. The method is L-stable, and its order
inside a stiff step is at least that of its stages.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.methods.radau_tables import radau_table
from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.factors import ComplexFactors, Pair
from robodyn_cli.integrators.stepping.newton import Limits, Rounds
from robodyn_cli.integrators.stepping.stepper import Attempt, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Function, Value, double_type
from robodyn_cli.kernels.mathematics import rough_power
from robodyn_cli.kernels.program import Program

ITERATIONS = 12
LIMITS = Limits(ITERATIONS, converged=0.01, rounding=0.1, shorter=0.4, remembers=True)
ROUNDING = 1e-15  # part of a state below which an update means nothing
SAFETY = 0.9
LARGEST_GROWTH = 8.0


class Radau(Stepper):
    """Radau IIA with 3 stages: order 5, L-stable, dense output of order 3."""

    name = "radau"
    order = 5
    dense_order = 3
    stages = 3
    needs_jacobian = True

    def linearisation(self, system: System) -> Program:
        return system.complex_linearisation

    def dense_size(self, system: System) -> int:
        return system.size * (radau_table(self.stages).lanes + 1)

    def prepare(self, w: Writer) -> None:
        f = w.f
        T = self.table = radau_table(self.stages)
        n = w.system.size
        self.Z, self.x, self.F, self.D = (Array(f, f.slot(T.lanes, n), T.lanes) for _ in range(4))
        self.start = Array(f, f.slot(T.shifts, n), T.shifts)
        self.rate0, self.error = Array(f, f.slot(1, n)), Array(f, f.slot(1, n))
        self.total = f.slot()
        self.rounds = Rounds(w, LIMITS)

    # -- the step -------------------------------------------------------------------------------------
    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, n, T = w.f, w.system.size, self.table
        per_h = 1.0 / h
        for c in range(n):
            self.start[c] = f.splat(w.state[c], T.shifts)
        wide = f.splat(per_h, T.shifts)
        g = (f.constant(list(T.g.real)) * wide, f.constant(list(T.g.imag)) * wide)
        factors = ComplexFactors(w, f.splat(t, T.shifts), self.start, g)
        w.rate(t, w.state, self.rate0)
        w.count(IntegerSlot.EVALUATIONS, 2)
        self._predict(w, h)
        self._iterate(w, factors, t, h, failed)
        for c in range(n):
            w.new[c] = w.state[c] + f.lane(self.Z[c], self.stages - 1)
        return self._judge(w, factors, t, h)

    def _iterate(self, w: Writer, factors: ComplexFactors, t: Value, h: Value, failed: str) -> None:
        """Solve for the increments by simplified Newton iteration; jumps to ``failed`` where it does not converge."""
        f, n, T = w.f, w.system.size, self.table
        lanes = T.lanes
        times = f.muladd(f.splat(h, lanes), f.constant(list(T.c)), f.splat(t, lanes))
        self.rounds.begin()
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
        with f.strict():
            square = Total(f, lanes)
            for c, change in enumerate(changes):
                Z = self.Z[c] + change
                self.Z[c] = Z
                d = change * f.splat(1.0 / self._scale(w, c, f.reduce("maximum", f.abs(Z))), lanes)
                square.add_product(d, d)
            update = f.sqrt(f.reduce("add", square.value) * (1.0 / (lanes * n)))
        self.rounds.judge(update, h, failed)

    def _scale(self, w: Writer, c: int, gained: Value) -> Value:
        """Return the error that is allowed in a component which changes by so much."""
        f = w.f
        size = f.max(f.abs(w.state[c]), gained)
        return f.max(
            f.muladd(size, w.get(DoubleSlot.RTOL), w.get(DoubleSlot.ATOL)), f.muladd(size, ROUNDING, 1e-300)
        )

    def _predict(self, w: Writer, h: Value) -> None:
        """Extrapolate the last step's polynomial to the new stages."""
        f, T = w.f, self.table
        u = f.splat(h / w.get(DoubleSlot.H_OLD), T.lanes) * f.constant(list(T.c))
        for c in range(w.system.size):
            self.Z[c] = self._polynomial(w, c, u)

    # -- error ----------------------------------------------------------------------------------------
    def _judge(self, w: Writer, factors: ComplexFactors, t: Value, h: Value) -> Attempt:
        f = w.f
        power = 1.0 / (self.stages + 1)
        self._estimate(w, factors, h)
        error = f.load(self.total)
        rejected = f.compare_int("sgt", f.load_int(w.integer_at(IntegerSlot.REJECTED_IN_ROW)), 0)
        fresh = f.compare_int("eq", f.load_int(w.integer_at(IntegerSlot.ACCEPTED)), 0)
        # once more from where the estimate leads, which damps what is stiff (Hairer and Wanner 1996, IV.8.20)
        with f.when(f.compare("oge", error, 1.0) & (rejected | fresh)):
            for c in range(w.system.size):
                self.error[c] = w.state[c] + self.error[c]
            w.rate(t, self.error, self.rate0)
            w.count(IntegerSlot.EVALUATIONS)
            self._estimate(w, factors, h)
        with f.strict():
            error = f.load(self.total)
            bounded = f.max(error, 1e-18)
            work = f.to_double(f.load_int(self.rounds.done)) + (2.0 * ITERATIONS + 1.0)
            factor = rough_power(f, bounded, -0.5 * power) * (SAFETY * (2 * ITERATIONS + 1)) / work
            # also from the trend of the last two errors (Gustafsson 1994)
            last, old_h = w.get(DoubleSlot.LAST_ERROR), w.get(DoubleSlot.H_OLD)
            trend = rough_power(f, last / (bounded * bounded), 0.5 * power) * SAFETY * (h / old_h)
            steady = f.compare("oeq", last, 1.0) | rejected | fresh
            factor = f.select(steady, factor, f.min(factor, trend))
            self.last_error = f.max(bounded, 1e-4)
            growth = f.select(rejected, f.constant(1.0), f.constant(LARGEST_GROWTH))
            factor = f.min(f.max(factor, 0.2), growth)
        return Attempt(error, factor)

    def _estimate(self, w: Writer, factors: ComplexFactors, h: Value) -> None:
        """Set the error of each component, filtered, and their mean square in units of the tolerance."""
        f, n, T = w.f, w.system.size, self.table
        pairs: list[Pair] = []
        g = f.constant(float(T.g[0].real)) / h
        weights = f.constant([*T.e, *[0.0] * (T.lanes - self.stages)])
        for c in range(n):
            raw = f.muladd(h * T.gamma, self.rate0[c], f.reduce("add", self.Z[c] * weights)) * g
            pairs.append((f.splat(raw, T.shifts), f.constant(0.0, T.shifts)))
        with f.strict():
            square = Total(f)
            for c, (re, _) in enumerate(factors.solve(pairs)):
                error = f.lane(re, 0)
                self.error[c] = error
                d = error / self._scale(w, c, f.abs(w.new[c]))
                square.add_product(d, d)
            f.store(square.value * (1.0 / n), self.total)

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, n, T = w.f, w.system.size, self.table
        w.put(DoubleSlot.LAST_ERROR, self.last_error)
        for c in range(n):
            f.store(combine(f, self.Z[c], T.P, T.lanes), f.offset("%dense", c * T.lanes))
            f.store(w.new[c], f.offset("%dense", n * T.lanes + c))

    def _polynomial(self, w: Writer, c: int, u: Value) -> Value:
        """Return by how much component c differs at u from the end of the last step."""
        f, lanes = w.f, self.table.lanes
        p: Value | None = None
        for k in reversed(range(self.stages)):
            d = f.splat(f.load(f.offset("%dense", c * lanes + k)), u.width)
            p = d if p is None else f.muladd(p, u, d)
        assert p is not None
        return p * u

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        f, n = w.f, w.system.size
        for c in range(n):
            end = f.splat(f.load(f.offset("%dense", n * self.table.lanes + c)), u.width)
            out[c] = end + self._polynomial(w, c, u)


class Radau9(Radau):
    """Radau IIA with 5 stages: order 9, L-stable, dense output of order 5."""

    name = "radau9"
    order = 9
    dense_order = 5
    stages = 5


class Radau13(Radau):
    """Radau IIA with 7 stages: order 13, L-stable, dense output of order 7."""

    name = "radau13"
    order = 13
    dense_order = 7
    stages = 7


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

    def part(first: int) -> Value:
        picks = ", ".join(f"i32 {first + k}" for k in range(width))
        t = double_type(x.width)
        return f.emit(f"shufflevector {t} {x.ref}, {t} poison, <{width} x i32> <{picks}>", width)

    return part(0), part(width)


def joined(f: Function, pair: Pair) -> Value:
    """Return two vectors as one, the first in the lower lanes."""
    width = pair[0].width
    if width == 1:
        return f.pack(list(pair), 2)
    t = double_type(width)
    picks = ", ".join(f"i32 {k}" for k in range(2 * width))
    return f.emit(
        f"shufflevector {t} {pair[0].ref}, {t} {pair[1].ref}, <{2 * width} x i32> <{picks}>", 2 * width
    )

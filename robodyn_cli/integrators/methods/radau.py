"""Radau IIA collocation for stiff motion, stages and eigenvalues side by side in the SIMD lanes.

The stage increments Z solve Z = h A F(x0 + Z). Newton's matrix (h A)^-1 x E - E x J falls apart into one system
g_l / h E - J for each eigenvalue g_l of A^-1 (Hairer and Wanner 1996, IV.8); one sweep of complex elimination solves
them all, with one eigenvalue in each lane. The Jacobian is exact and new in each step. The method is L-stable, and its
order inside a stiff step is at least that of its stages.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.algorithms.linear import Complex
from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.methods.collocation_tables import radau_table
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.control import (
    StepAttempt,
    StepController,
    mean_squares,
    tolerance,
)
from robodyn_cli.integrators.stepping.factors import (
    ComplexArray,
    ComplexFactors,
    NewtonLimits,
    Rounds,
    complex_factors,
    derivatives_of,
)
from robodyn_cli.integrators.stepping.stepper import Method, Stepper, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Block, Function, Int, Value

ITERATIONS = 12
LIMITS = NewtonLimits(ITERATIONS, converged=0.01, rounding=0.1, shorter=0.4, remembers=True)
SAFETY = 0.9


class Radau(Method):
    """Radau IIA with s stages: order 2 s - 1, L-stable, dense output of order s."""

    def __init__(self, facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.stages = self.dense_order = (facts.order + 1) // 2

    def linearisation(self, system: System) -> StepProgram:
        return derivatives_of(system, complex_g=True)

    def dense_size(self, system: System) -> int:
        return system.size * (radau_table(self.stages).lanes + 1)

    def stepper(self, w: Writer) -> RadauStepper:
        return RadauStepper(self, w)


class RadauStepper(Stepper[Array]):
    """Writes steps of Radau IIA; the stage increments Z are what dense output needs."""

    def __init__(self, method: Radau, w: Writer) -> None:
        super().__init__(method, w)
        f = w.f
        self.stages, self.table = method.stages, radau_table(method.stages)
        T = self.table
        self.Z, self.x, self.F = (w.array(2, 1, T.lanes) for _ in range(3))
        self.right = ComplexArray(w.array(2, 1, 2 * T.shifts))
        self.rate0, self.error = w.array(2, 1), w.array(2, 1)
        self.square = f.slot()
        self.rounds = Rounds(w, LIMITS)
        self.control = StepController(
            self.stages + 1, safety=SAFETY, floor=1e-9, least=0.2, most=8.0, trend_safety=SAFETY
        )

    # -- the step -------------------------------------------------------------------------------------
    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Array]:
        f, w, T = self.f, self.w, self.table
        wide = f.splat(1.0 / h, T.shifts)
        g = Complex(f.constant(list(T.g.real)) * wide, f.constant(list(T.g.imag)) * wide)
        factors = complex_factors(w, t, w.state, g)
        w.rate(t, w.state, self.rate0)
        w.count(IntegerSlot.EVALUATIONS, 2)
        self._predict(h)
        self._iterate(factors, t, h, failed)
        for c in w.each(w.size):
            w.new[c] = w.state[c] + f.lane(self.Z[c], self.stages - 1)
        square = self._error(factors, t, h)
        # a step that took many rounds wants a shorter one (Hairer and Wanner 1996, IV.8)
        most = 2.0 * ITERATIONS + 1.0
        with f.strict():
            scale = most / (f.to_double(f.load_int(self.rounds.done)) + most)
        return StepAttempt(square, self.Z, scale=scale)

    def _iterate(self, factors: ComplexFactors, t: Value, h: Value, failed: Block) -> None:
        """Solve for the increments by simplified Newton iteration; ``failed`` is left where it does not converge."""
        f, w, T = self.f, self.w, self.table
        lanes = T.lanes
        times = f.muladd(f.splat(h, lanes), f.constant(list(T.c)), f.splat(t, lanes))
        with self.rounds.repeat(h, failed) as judge:
            for c in w.each(w.size):
                self.x[c] = self.Z[c] + f.splat(w.state[c], lanes)
            w.rate(times, self.x, self.F)
            w.count(IntegerSlot.EVALUATIONS)
            wide_h = f.splat(h, lanes)
            per_h = f.splat(1.0 / h, 2 * T.shifts)
            for c in w.each(w.size):
                defect = f.muladd(wide_h, combine(f, self.F[c], T.A, lanes), -self.Z[c])
                self.right.array[c] = combine(f, defect, T.to, 2 * T.shifts) * per_h
            factors.solve(self.right)
            judge(self._update())

    def _update(self) -> Value:
        """Add a round's changes to the increments; return their norm in units of the tolerance."""
        f, w, lanes = self.f, self.w, self.table.lanes
        square = Total(f, lanes)
        for c in w.each(w.size):
            change = combine(f, self.right.array[c], self.table.back, lanes)
            with f.strict():
                Z = self.Z[c] + change
                self.Z[c] = Z
                size = f.max(f.abs(w.state[c]), f.reduce("maximum", f.abs(Z)))
                d = change * f.splat(1.0 / tolerance(w, c, size), lanes)
                square.add_product(d, d)
        with f.strict():
            return f.sqrt(f.reduce("add", square.value) * (1.0 / (lanes * w.system.size)))

    def _predict(self, h: Value) -> None:
        """Extrapolate the last step's polynomial to the new stages."""
        f, T = self.f, self.table
        u = f.splat(h / self.w.get(DoubleSlot.H_OLD), T.lanes) * f.constant(list(T.c))
        for c in self.w.each(self.w.size):
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
            for c in w.each(w.size):
                self.error[c] = w.state[c] + self.error[c]
            w.rate(t, self.error, self.rate0)
            w.count(IntegerSlot.EVALUATIONS)
            self._estimate(factors, h)
        return f.load(self.square)

    def _estimate(self, factors: ComplexFactors, h: Value) -> None:
        """Set the error of each component, filtered, and their mean square in units of the tolerance."""
        f, w, T = self.f, self.w, self.table
        g = f.constant(float(T.g[0].real)) / h
        weights = f.constant([*T.e, *[0.0] * (T.lanes - self.stages)])
        for c in w.each(w.size):
            raw = f.muladd(h * T.gamma, self.rate0[c], f.reduce("add", self.Z[c] * weights)) * g
            self.right[c] = Complex(f.splat(raw, T.shifts), f.constant(0.0, T.shifts))
        factors.solve(self.right)
        for c in w.each(w.size):
            self.error[c] = f.lane(self.right.array[c], 0)
        f.store(mean_squares(w, 1, lambda c: [self.error[c]])[0], self.square)

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: Array) -> None:
        f, w, T = self.f, self.w, self.table
        n = w.system.size
        for c in w.each(w.size):
            f.store(combine(f, kept[c], T.P, T.lanes), f.offset("%dense", c * T.lanes))
            f.store(w.new[c], f.offset("%dense", c + n * T.lanes))

    def _polynomial(self, c: Int | int, u: Value) -> Value:
        """Return by how much component c differs at u from the end of the last step."""
        f, lanes = self.f, self.table.lanes
        p: Value | None = None
        for k in reversed(range(self.stages)):
            d = f.splat(f.load(f.offset("%dense", c * lanes + k)), u.width)
            p = d if p is None else f.muladd(p, u, d)
        assert p is not None
        return p * u

    def dense(self, u: Value, h: Value, out: Array) -> None:
        f, w, n = self.f, self.w, self.w.system.size
        for c in w.each(w.size):
            end = f.splat(f.load(f.offset("%dense", c + n * self.table.lanes)), u.width)
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

"""Linearly implicit methods for stiff motion: no iteration, one factored matrix a step, exact Jacobian."""

from __future__ import annotations

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.methods.rosenbrock_tables import RODAS5P, ROSENBROCK23, RosenbrockTable
from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.factors import RealFactors
from robodyn_cli.integrators.stepping.stepper import Attempt, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Value
from robodyn_cli.kernels.mathematics import rough_power
from robodyn_cli.kernels.program import Program

SAFETY = 0.9


class Rosenbrock(Stepper):
    """Rosenbrock method given by its table; dense output from its stages."""

    table: RosenbrockTable
    needs_jacobian = True

    def linearisation(self, system: System) -> Program:
        return system.linearisation

    def dense_size(self, system: System) -> int:
        return (2 + len(self.table.dense)) * system.size

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, s, T = w.f, w.system, self.table
        stages = len(T.m)
        x0 = [w.state[c] for c in range(s.size)]
        factors = RealFactors(w, t, w.state, (1.0 / T.gamma) / h)
        w.count(IntegerSlot.EVALUATIONS, stages + 1)
        per_h = 1.0 / h
        U: list[list[Value]] = []
        for i in range(stages):
            x = [self._sum(w, T.a[i], U, c, x0[c]) for c in range(s.size)]
            rate = w.rate_of(f.muladd(h, float(T.alpha[i]), t), x)
            right = []
            for c, ft in enumerate(factors.ft):
                total = f.muladd(per_h, self._sum(w, T.C[i], U, c, None), rate[c]) if i else rate[c]
                if ft is not None and T.gamma_sums[i] != 0.0:
                    total = f.muladd(h * float(T.gamma_sums[i]), ft, total)
                right.append(total)
            U.append(factors.solve(right))
        # increments apart: in short steps dense output would lose their digits in the difference of two states
        self.increments = [self._sum(w, T.m, U, c, None) for c in range(s.size)]
        x1 = [x + d for x, d in zip(x0, self.increments)]
        for k in range(s.size):
            w.new[k] = x1[k]
        self.x0, self.stages = x0, U
        return self._judge(w, x0, x1, [self._sum(w, T.e, U, c, None) for c in range(s.size)])

    def _sum(
        self, w: Writer, weights: tuple[float, ...], U: list[list[Value]], c: int, start: Value | None
    ) -> Value:
        f = w.f
        total = start
        for weight, u in zip(weights, U):
            if weight != 0.0:
                total = u[c] * weight if total is None else f.muladd(u[c], weight, total)
        return f.constant(0.0) if total is None else total

    def _judge(self, w: Writer, x0: list[Value], x1: list[Value], e: list[Value]) -> Attempt:
        f, s = w.f, w.system
        n = s.size
        with f.strict():
            rtol, atol = w.get(DoubleSlot.RTOL), w.get(DoubleSlot.ATOL)
            total: Value | None = None
            for c in range(n):
                d = e[c] / f.muladd(f.max(f.abs(x0[c]), f.abs(x1[c])), rtol, atol)
                total = d * d if total is None else f.muladd(d, d, total)
            assert total is not None
            error = total * (1.0 / n)
            bounded = f.max(error, 1e-20)
            factor = rough_power(f, bounded, -0.5 / self.table.error_order) * SAFETY
            after_reject = f.compare_int("sgt", f.load_int(w.integer_at(IntegerSlot.REJECTED_IN_ROW)), 0)
            factor = f.min(f.max(factor, 0.2), f.select(after_reject, f.constant(1.0), f.constant(6.0)))
        return Attempt(error, factor)

    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, s = w.f, w.system
        with self.used(w, t, h):
            kept = [*self.x0, *self.increments]
            for row in self.table.dense:
                kept += [self._sum(w, row, self.stages, c, None) for c in range(s.size)]
            for k, value in enumerate(kept):
                f.store(value, f.offset("%dense", k))

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        """The method's own continuous extension, from its stages.

        Rates at the ends of the step have no place in it: in a stiff component they are the rounding error of the
        state times the fastest decay, which would show at every sample.
        """
        f, s = w.f, w.system
        x = u + 1.0
        for c in range(s.size):
            x0, gained, *rest = (
                f.splat(f.load(f.offset("%dense", place * s.size + c)), u.width)
                for place in range(2 + len(self.table.dense))
            )
            bend = rest[-1]
            for d in reversed(rest[:-1]):
                bend = f.muladd(bend, x, d)
            out[c] = f.muladd(f.muladd(-u, bend, gained), x, x0)


class Rodas5P(Rosenbrock):
    """Steinebach's Rodas5P: order 5, L-stable, for stiff springs and dampers."""

    name = "rodas5p"
    order = 5
    dense_order = 4
    table = RODAS5P


class Rosenbrock23(Rosenbrock):
    """Shampine and Reichelt's pair of MATLAB's ode23s: order 2, L-stable, for stiff motion at loose tolerances."""

    name = "rosenbrock23"
    order = 2
    dense_order = 2
    proportion = 2.0 / 3.0
    table = ROSENBROCK23

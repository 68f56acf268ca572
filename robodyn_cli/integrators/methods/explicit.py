"""Explicit Runge-Kutta methods: one loop over a tableau, written out by the compiler."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.methods.tableaus import (
    DOP853,
    DOP853_DENSE,
    DOPRI5,
    DOPRI5_DENSE,
    RK4,
    ExplicitTable,
)
from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.stepper import Attempt, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Int, Value
from robodyn_cli.kernels.mathematics import rough_power

SAFETY = 0.9
# of the step controller that also looks at the previous error (Hairer and Wanner 1996, IV.2)
MEMORY_GAIN = 0.32


class ExplicitRungeKutta(Stepper):
    """Explicit Runge-Kutta pair given by its tableau."""

    table: ExplicitTable
    stages: int

    def prepare(self, w: Writer) -> None:
        self.K = [w.array(2, 1) for _ in range(self.stages)]
        self.x = w.array(2, 1)

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f = w.f
        for i in range(self.stages):
            self._stage(w, t, h, i)
        w.count(IntegerSlot.EVALUATIONS, self.stages)
        for c in w.each(w.size):
            w.new[c] = f.muladd(h, self._sum(w, self.table.b, c), w.state[c])
        return self._judge(w, h)

    def _stage(self, w: Writer, t: Value, h: Value, i: int) -> None:
        f = w.f
        row = self.table.A[i]
        x = w.state
        if any(row):
            x = self.x
            for c in w.each(w.size):
                x[c] = f.muladd(h, self._sum(w, row, c), w.state[c])
        w.rate(f.muladd(h, self.table.c[i], t), x, self.K[i])

    def _sum(self, w: Writer, weights: Sequence[float], component: Int | int) -> Value:
        """Return the weighted sum of the stages' rates of one component."""
        f = w.f
        total: Value | None = None
        for weight, rates in zip(weights, self.K):
            if weight != 0.0:
                k = rates[component]
                total = k * weight if total is None else f.muladd(k, weight, total)
        return f.constant(0.0) if total is None else total

    def _judge(self, w: Writer, h: Value) -> Attempt:
        f = w.f
        with f.strict():
            rtol, atol = w.get(DoubleSlot.RTOL), w.get(DoubleSlot.ATOL)
            sums = [Total(f) for _ in self.table.errors]
            for c in w.each(w.size):
                scale = 1.0 / f.muladd(f.max(f.abs(w.state[c]), f.abs(w.new[c])), rtol, atol)
                for total, weights in zip(sums, self.table.errors):
                    e = self._sum(w, weights, c) * scale
                    total.add_product(e, e)
            totals = [x.value for x in sums]
            n = w.number(w.size)
            h2 = h * h
            if len(totals) == 2:
                error = h2 * totals[0] * totals[0] / (f.muladd(totals[1], 0.01, totals[0]) * n + 1e-300)
            else:
                error = h2 * totals[0] / n
            bounded = f.max(error, 1e-20)
            q = self.table.error_order
            gain = MEMORY_GAIN / q
            previous = w.get(DoubleSlot.LAST_ERROR)
            factor = rough_power(f, bounded, -0.5 * (1.0 / q - 0.75 * gain))
            factor = factor * rough_power(f, f.max(previous, 1e-8), 0.5 * gain) * SAFETY
            self.last_error = bounded
            growth = f.select(
                f.compare_int("sgt", f.load_int(w.integer_at(IntegerSlot.REJECTED_IN_ROW)), 0),
                f.constant(1.0),
                f.constant(10.0),
            )
            factor = f.min(f.max(factor, 0.2), growth)
        return Attempt(error, factor)

    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f = w.f
        if self.adaptive:
            w.put(DoubleSlot.LAST_ERROR, f.max(self.last_error, 1e-8))
        with self.used(w, t, h):
            self._store_dense(w, t, h)

    def _store_dense(self, w: Writer, t: Value, h: Value) -> None:
        raise NotImplementedError

    def _put(self, w: Writer, row: int, component: Int | int, value: Value) -> None:
        w.f.store(value, w.f.offset("%dense", w.size * row + component))

    def _get(self, w: Writer, row: int, component: Int | int) -> Value:
        return w.f.load(w.f.offset("%dense", w.size * row + component))


class Dop853(ExplicitRungeKutta):
    """Dormand and Prince's pair of order 8 (Hairer, Norsett and Wanner 1993), dense output of order 7."""

    name = "dop853"
    order = 8
    dense_order = 7
    table = DOP853
    stages = 12

    def prepare(self, w: Writer) -> None:
        super().prepare(w)
        # dense output takes four more stages
        self.K += [w.array(2, 1) for _ in range(4)]

    def dense_size(self, system: System) -> int:
        return 8 * system.size

    def _store_dense(self, w: Writer, t: Value, h: Value) -> None:
        w.rate(t + h, w.new, self.K[12])
        for i in range(13, 16):
            self._stage(w, t, h, i)
        w.count(IntegerSlot.EVALUATIONS, 4)
        for c in w.each(w.size):
            delta = w.new[c] - w.state[c]
            first, last = h * self.K[0][c], h * self.K[12][c]
            rows = [w.state[c], delta, first - delta, 2.0 * delta - (first + last)]
            rows += [h * self._sum(w, weights, c) for weights in DOP853_DENSE]
            for k, value in enumerate(rows):
                self._put(w, k, c, value)

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        f = w.f
        x = u + 1.0
        for c in w.each(w.size):
            value = f.splat(self._get(w, 7, c), u.width) * x
            for k in range(6, 0, -1):
                value = (value + f.splat(self._get(w, k, c), u.width)) * (x if k % 2 else -u)
            out[c] = value + f.splat(self._get(w, 0, c), u.width)


class Dopri5(ExplicitRungeKutta):
    """Dormand and Prince's pair of order 5, the method of MATLAB's ode45; dense output of order 4."""

    name = "dopri5"
    order = 5
    dense_order = 4
    table = DOPRI5
    stages = 7

    def dense_size(self, system: System) -> int:
        return 5 * system.size

    def _store_dense(self, w: Writer, t: Value, h: Value) -> None:
        for c in w.each(w.size):
            self._put(w, 0, c, w.state[c])
            for k in range(4):
                self._put(w, k + 1, c, h * self._sum(w, [row[k] for row in DOPRI5_DENSE], c))

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        f = w.f
        x = u + 1.0
        for c in w.each(w.size):
            value = f.splat(self._get(w, 4, c), u.width)
            for k in (3, 2, 1, 0):
                value = f.muladd(value, x, f.splat(self._get(w, k, c), u.width))
            out[c] = value


class ClassicalRungeKutta(ExplicitRungeKutta):
    """The classical method of order 4 with a fixed step; dense output is the cubic Hermite polynomial."""

    name = "rk4"
    order = 4
    dense_order = 3
    adaptive = False
    table = RK4
    stages = 4

    def dense_size(self, system: System) -> int:
        return 4 * system.size

    def _judge(self, w: Writer, h: Value) -> Attempt:
        """Accept every step; only a state that is not finite is refused."""
        f = w.f
        with f.strict():
            total = Total(f)
            for c in w.each(w.size):
                total.add_product(w.new[c], 0.0)
            finite = f.compare("ord", total.value, 0.0)
            error = f.select(finite, f.constant(0.0), total.value)
        return Attempt(error, f.constant(1.0))

    def _store_dense(self, w: Writer, t: Value, h: Value) -> None:
        last = w.array(2, 1)
        w.rate(t + h, w.new, last)
        w.count(IntegerSlot.EVALUATIONS)
        for c in w.each(w.size):
            for k, value in enumerate((w.state[c], w.new[c], h * self.K[0][c], h * last[c])):
                self._put(w, k, c, value)

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        f = w.f
        x = u + 1.0
        for c in w.each(w.size):
            a, b, da, db = (f.splat(self._get(w, k, c), u.width) for k in range(4))
            # x^2 (3 - 2 x) goes from 0 to 1; the slopes enter with x (1 - x)
            out[c] = a + (b - a) * x * x * (3.0 - 2.0 * x) - x * u * (-u * da - x * db)

"""Explicit Runge-Kutta methods: one loop over a tableau, written out by the compiler."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.layout import Real, Whole
from robodyn_cli.integrators.loop import SLACK, Attempt, Stepper, Writer
from robodyn_cli.integrators.tableaus import DOP853, DOP853_DENSE, DOPRI5, DOPRI5_DENSE, RK4, ExplicitTable
from robodyn_cli.kernels.ir import Value
from robodyn_cli.kernels.mathematics import rough_power

SAFETY = 0.9
MEMORY_GAIN = 0.32  # of the step controller that also looks at the previous error (Hairer and Wanner 1996, IV.2)

class ExplicitRungeKutta(Stepper):
    """Explicit Runge-Kutta pair given by its tableau."""

    table: ExplicitTable
    stages: int

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, s = w.f, w.system
        self.x0 = [f.load(a) for a in w.state]
        self.K: list[list[Value]] = []
        for i in range(self.stages):
            self._stage(w, t, h, i)
        w.count(Whole.EVALUATIONS, self.stages)
        x1 = [f.muladd(h, self._sum(w, self.table.b, c), self.x0[c]) for c in range(s.size)]
        for k in range(s.size):
            f.store(x1[k], w.new[k])
        return self._judge(w, h, x1)

    def _stage(self, w: Writer, t: Value, h: Value, i: int) -> None:
        f = w.f
        row = self.table.A[i]
        x = self.x0
        if any(row):
            x = [f.muladd(h, self._sum(w, row, c), self.x0[c]) for c in range(w.system.size)]
        self.K.append(w.rate(f.muladd(h, self.table.c[i], t), x))

    def _sum(self, w: Writer, weights: Sequence[float], component: int) -> Value:
        """Return the weighted sum of the stages' rates of one component."""
        f = w.f
        total: Value | None = None
        for i, weight in enumerate(weights):
            if weight != 0.0 and i < len(self.K):
                k = self.K[i][component]
                total = k * weight if total is None else f.muladd(k, weight, total)
        return f.constant(0.0) if total is None else total

    def _judge(self, w: Writer, h: Value, x1: list[Value]) -> Attempt:
        f, s = w.f, w.system
        n = s.size
        with f.strict():
            rtol, atol = w.get(Real.RTOL), w.get(Real.ATOL)
            sums: list[Value | None] = [None] * len(self.table.errors)
            for c in range(n):
                scale = 1.0 / f.muladd(f.max(f.abs(self.x0[c]), f.abs(x1[c])), rtol, atol)
                for j, weights in enumerate(self.table.errors):
                    e = self._sum(w, weights, c) * scale
                    part = sums[j]
                    sums[j] = e * e if part is None else f.muladd(e, e, part)
            totals = [x for x in sums if x is not None]
            h2 = h * h
            if len(totals) == 2:
                error = h2 * totals[0] * totals[0] / (f.muladd(totals[1], 0.01, totals[0]) * float(n) + 1e-300)
            else:
                error = h2 * totals[0] * (1.0 / n)
            bounded = f.max(error, 1e-20)
            q = self.table.error_order
            gain = MEMORY_GAIN / q
            previous = w.get(Real.MEMORY_2)
            factor = rough_power(f, bounded, -0.5 * (1.0 / q - 0.75 * gain))
            factor = factor * rough_power(f, f.max(previous, 1e-8), 0.5 * gain) * SAFETY
            self.last_error = bounded
            growth = f.select(f.compare_int("sgt", f.load_int(w.whole(Whole.REJECTED_IN_ROW)), 0), f.constant(1.0),
                              f.constant(10.0))
            factor = f.min(f.max(factor, 0.2), growth)
        return Attempt(error, factor)

    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f = w.f
        if self.adaptive:
            w.put(Real.MEMORY_2, f.max(self.last_error, 1e-8))
        wanted = f.compare_int("sle", f.load_int(w.whole(Whole.NEXT_SAMPLE)), f.load_int(w.whole(Whole.LAST_SAMPLE)))
        watched = f.compare_int("ne", f.load_int(w.whole(Whole.WATCH)), 0)
        with f.when(wanted | watched), f.when(w.due(t + h, 2.0 * SLACK) | watched):
            self._store_dense(w, t, h)

    def _store_dense(self, w: Writer, t: Value, h: Value) -> None:
        raise NotImplementedError

    def _put(self, w: Writer, row: int, component: int, value: Value) -> None:
        w.f.store(value, w.f.offset("%dense", row * w.system.size + component))

    def _get(self, w: Writer, row: int, component: int) -> Value:
        return w.f.load(w.f.offset("%dense", row * w.system.size + component))


class Dop853(ExplicitRungeKutta):
    """Dormand and Prince's pair of order 8 (Hairer, Norsett and Wanner 1993), dense output of order 7."""

    name = "dop853"
    order = 8
    dense_order = 7
    table = DOP853
    stages = 12

    def dense_size(self, system: System) -> int:
        return 8 * system.size

    def _store_dense(self, w: Writer, t: Value, h: Value) -> None:
        f = w.f
        kept = list(self.K)
        x1 = [f.load(a) for a in w.new]
        self.K.append(w.rate(t + h, x1))
        for i in range(13, 16):
            self._stage(w, t, h, i)
        w.count(Whole.EVALUATIONS, 4)
        for c in range(w.system.size):
            delta = x1[c] - self.x0[c]
            first, last = h * self.K[0][c], h * self.K[12][c]
            rows = [self.x0[c], delta, first - delta, 2.0 * delta - (first + last)]
            rows += [h * self._sum(w, weights, c) for weights in DOP853_DENSE]
            for k, value in enumerate(rows):
                self._put(w, k, c, value)
        self.K = kept

    def dense(self, w: Writer, u: Value, h: Value) -> list[Value]:
        f = w.f
        x = u + 1.0
        out = []
        for c in range(w.system.size):
            value = f.splat(self._get(w, 7, c), u.width) * x
            for k in range(6, 0, -1):
                value = (value + f.splat(self._get(w, k, c), u.width)) * (x if k % 2 else -u)
            out.append(value + f.splat(self._get(w, 0, c), u.width))
        return out


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
        for c in range(w.system.size):
            self._put(w, 0, c, self.x0[c])
            for k in range(4):
                self._put(w, k + 1, c, h * self._sum(w, [row[k] for row in DOPRI5_DENSE], c))

    def dense(self, w: Writer, u: Value, h: Value) -> list[Value]:
        f = w.f
        x = u + 1.0
        out = []
        for c in range(w.system.size):
            value = f.splat(self._get(w, 4, c), u.width)
            for k in (3, 2, 1, 0):
                value = f.muladd(value, x, f.splat(self._get(w, k, c), u.width))
            out.append(value)
        return out


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

    def _judge(self, w: Writer, h: Value, x1: list[Value]) -> Attempt:
        """Accept every step; only a state that is not finite is refused."""
        f = w.f
        total = x1[0] * 0.0
        for x in x1[1:]:
            total = f.muladd(x, 0.0, total)
        with f.strict():
            finite = f.compare("ord", total, 0.0)
            error = f.select(finite, f.constant(0.0), total)
        return Attempt(error, f.constant(1.0))

    def _store_dense(self, w: Writer, t: Value, h: Value) -> None:
        f = w.f
        x1 = [f.load(a) for a in w.new]
        last = w.rate(t + h, x1)
        w.count(Whole.EVALUATIONS)
        for c in range(w.system.size):
            for k, value in enumerate((self.x0[c], x1[c], h * self.K[0][c], h * last[c])):
                self._put(w, k, c, value)

    def dense(self, w: Writer, u: Value, h: Value) -> list[Value]:
        f = w.f
        x = u + 1.0
        out = []
        for c in range(w.system.size):
            a, b, da, db = (f.splat(self._get(w, k, c), u.width) for k in range(4))
            # x^2 (3 - 2 x) goes from 0 to 1; the slopes enter with x (1 - x)
            out.append(a + (b - a) * x * x * (3.0 - 2.0 * x) - x * u * (-u * da - x * db))
        return out

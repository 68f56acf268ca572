"""Explicit Runge-Kutta methods: one loop over a tableau, written out by the compiler."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.methods.tableaus import DOP853, DOPRI5, RK4, ExplicitTable
from robodyn_cli.integrators.runtime.layout import IntegerSlot
from robodyn_cli.integrators.stepping.control import Attempt, Controller, mean_squares
from robodyn_cli.integrators.stepping.stepper import Method, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Int, Value

# of the step controller that also looks at the last error (Hairer and Wanner 1996, IV.2)
SAFETY, GAIN = 0.9, 0.32


class ExplicitRungeKutta(Method):
    """Explicit Runge-Kutta method given by its tableau and its kind of dense output."""

    def __init__(self, table: ExplicitTable, output: type[ExplicitStepper], facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.table, self.output = table, output
        self.dense_order = table.dense_order
        self.vectors = self.adaptive

    def dense_size(self, system: System) -> int:
        return (self.output.rows + 1) * system.size

    def stepper(self, w: Writer) -> ExplicitStepper:
        return self.output(self, w)


class ExplicitStepper(Stepper[Sequence[Array]]):
    """Writes steps from a tableau; K are the rates at the stages, which dense output takes over.

    The first stage is evaluated only where it is not known (``RATE_KNOWN``): it is after a rejection, and where the
    rate at the end of the last step was evaluated and the state has stayed what it was there. It lies behind dense
    output.

    rows : of numbers, one a component, that dense output keeps.
    """

    rows: int

    def __init__(self, method: ExplicitRungeKutta, w: Writer) -> None:
        super().__init__(method, w)
        self.table = method.table
        self.K = [w.behind_dense(w.size * self.rows), *(w.array(2, 1) for _ in self.table.A[1:])]
        self.x = w.array(2, 1)
        self.known = w.integer_at(IntegerSlot.RATE_KNOWN)
        self.control = Controller(
            self.table.error_order, safety=SAFETY, floor=1e-10, least=0.2, most=10.0, gain=GAIN
        )

    def attempt(self, t: Value, h: Value, failed: Block) -> Attempt[Sequence[Array]]:
        f, w = self.f, self.w
        with f.when(f.compare_int("eq", f.load_int(self.known), 0)):
            w.rate(t, w.state, self.K[0])
            w.count(IntegerSlot.EVALUATIONS)
        f.store_int(1, self.known)
        for i in range(1, self.table.stages):
            self._stage(t, h, i)
        w.count(IntegerSlot.EVALUATIONS, self.table.stages - 1)
        for c in w.each(w.size):
            w.new[c] = f.muladd(h, self._sum(self.table.b, c), w.state[c])
        return Attempt(self._error(h), self.K)

    def _stage(self, t: Value, h: Value, i: int) -> None:
        f, w = self.f, self.w
        for c in w.each(w.size):
            self.x[c] = f.muladd(h, self._sum(self.table.A[i], c), w.state[c])
        w.rate(f.muladd(h, self.table.c[i], t), self.x, self.K[i])

    def _sum(self, weights: Sequence[float], component: Int | int) -> Value:
        """Return the weighted sum of the stages' rates of one component."""
        f = self.f
        total: Value | None = None
        for weight, rates in zip(weights, self.K):
            if weight != 0.0:
                k = rates[component]
                total = k * weight if total is None else f.muladd(k, weight, total)
        return f.constant(0.0) if total is None else total

    def _error(self, h: Value) -> Value | None:
        """Return the mean square of the error; a pair with two estimates takes them together (Hairer's DOP853)."""
        f, estimates = self.f, self.table.errors
        if not estimates:
            return None
        squares = mean_squares(self.w, len(estimates), lambda c: [self._sum(e, c) for e in estimates])
        with f.strict():
            if len(squares) == 1:
                return h * h * squares[0]
            return h * h * squares[0] * squares[0] / (f.muladd(squares[1], 0.01, squares[0]) + 1e-300)

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: Sequence[Array]) -> None:
        self.f.store_int(0, self.known)
        with self.used(t, h):
            self._carry_over(self._store_dense(t, h, kept))
        if self.table.first_same_as_last:
            self._carry_over(kept[self.table.stages - 1])

    def _carry_over(self, last: Array | None) -> None:
        """Make the rate at the end of the step the first stage of the next, unless the state is projected."""
        w = self.w
        if last is not None and not self.method.moves_state(w.system):
            for c in w.each(w.size):
                self.K[0][c] = last[c]
            self.f.store_int(1, self.known)

    def _end_rate(self, t: Value, h: Value, room: Array) -> Array:
        """Return the rate at the end of the step, evaluated in ``room`` where no stage has it."""
        w, table = self.w, self.table
        if table.first_same_as_last:
            return self.K[table.stages - 1]
        w.rate(t + h, w.new, room)
        w.count(IntegerSlot.EVALUATIONS)
        return room

    def _store_dense(self, t: Value, h: Value, K: Sequence[Array]) -> Array | None:
        """Store the numbers of dense output; return the rate at the end of the step where it was evaluated."""
        raise NotImplementedError

    def _put(self, component: Int | int, values: Sequence[Value]) -> None:
        f, w = self.f, self.w
        for row, value in enumerate(values):
            f.store(value, f.offset("%dense", w.size * row + component))

    def _get(self, component: Int | int, width: int) -> list[Value]:
        f, w = self.f, self.w
        places = [f.offset("%dense", w.size * row + component) for row in range(self.rows)]
        return [f.splat(f.load(place), width) for place in places]


class CubicOutput(ExplicitStepper):
    """Dense output by the cubic Hermite polynomial from states and rates at the ends of a step: order 3."""

    rows = 4

    def _store_dense(self, t: Value, h: Value, K: Sequence[Array]) -> Array | None:
        w = self.w
        last = self._end_rate(t, h, w.array(2, 1))
        for c in w.each(w.size):
            self._put(c, (w.state[c], w.new[c], h * K[0][c], h * last[c]))
        return last

    def dense(self, u: Value, h: Value, out: Array) -> None:
        x = u + 1.0
        for c in self.w.each(self.w.size):
            a, b, da, db = self._get(c, u.width)
            # x^2 (3 - 2 x) goes from 0 to 1; the slopes enter with x (1 - x)
            out[c] = a + (b - a) * x * x * (3.0 - 2.0 * x) - x * u * (-u * da - x * db)


class QuarticOutput(ExplicitStepper):
    """Dense output by a polynomial of degree 4 from the stages, whose coefficients are ``table.dense``."""

    rows = 5

    def _store_dense(self, t: Value, h: Value, K: Sequence[Array]) -> Array | None:
        w, columns = self.w, list(zip(*self.table.dense))
        for c in w.each(w.size):
            self._put(c, [w.state[c], *(h * self._sum(column, c) for column in columns)])
        return None

    def dense(self, u: Value, h: Value, out: Array) -> None:
        x = u + 1.0
        for c in self.w.each(self.w.size):
            *lower, value = self._get(c, u.width)
            for coefficient in reversed(lower):
                value = self.f.muladd(value, x, coefficient)
            out[c] = value


class Dop853Output(ExplicitStepper):
    """Dense output of order 7 of DOP853, which takes four more stages (Hairer, Norsett and Wanner 1993, II.6)."""

    rows = 8

    def _store_dense(self, t: Value, h: Value, K: Sequence[Array]) -> Array | None:
        w, last = self.w, self.table.stages
        self._end_rate(t, h, K[last])
        for i in range(last + 1, len(K)):
            self._stage(t, h, i)
        w.count(IntegerSlot.EVALUATIONS, len(K) - last - 1)
        for c in w.each(w.size):
            delta = w.new[c] - w.state[c]
            start, end = h * K[0][c], h * K[last][c]
            rows = [w.state[c], delta, start - delta, 2.0 * delta - (start + end)]
            self._put(c, rows + [h * self._sum(weights, c) for weights in self.table.dense])
        return K[last]

    def dense(self, u: Value, h: Value, out: Array) -> None:
        x = u + 1.0
        for c in self.w.each(self.w.size):
            start, *rows = self._get(c, u.width)
            value = rows[-1] * x
            for k in range(6, 0, -1):
                value = (value + rows[k - 1]) * (x if k % 2 else -u)
            out[c] = value + start


dop853 = partial(ExplicitRungeKutta, DOP853, Dop853Output)  # of Dormand and Prince (Hairer et al. 1993)
dopri5 = partial(ExplicitRungeKutta, DOPRI5, QuarticOutput)  # of Dormand and Prince, MATLAB's ode45
rk4 = partial(ExplicitRungeKutta, RK4, CubicOutput)  # the classical method

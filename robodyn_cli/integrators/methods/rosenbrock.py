"""Linearly implicit methods for stiff motion: no iteration, one factored matrix per step, exact Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.methods.rosenbrock_tables import RODAS5P, ROSENBROCK23, RosenbrockTable
from robodyn_cli.integrators.runtime.memory import IntegerSlot
from robodyn_cli.integrators.stepping.control import StepAttempt, StepController, mean_squares
from robodyn_cli.integrators.stepping.factors import derivatives_of, real_factors
from robodyn_cli.integrators.stepping.stepper import Method, Stepper, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Int, Value
from robodyn_cli.record import mutable_record

SAFETY = 0.9


class Rosenbrock(Method):
    """Rosenbrock method given by its table; dense output from its stages."""

    def __init__(self, table: RosenbrockTable, facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.table = table
        self.dense_order = table.dense_order
        self.proportion = min(1.0, table.order / table.error_order)

    def linearisation(self, system: System) -> StepProgram:
        return derivatives_of(system)

    def dense_size(self, system: System) -> int:
        return (2 + len(self.table.dense)) * system.size

    def stepper(self, w: Writer) -> RosenbrockStepper:
        return RosenbrockStepper(self, w)


@mutable_record
class Stages:
    """A step: what it adds to the state, and the stages u_i."""

    increments: Array
    u: list[Array]


class RosenbrockStepper(Stepper[Stages]):
    """Writes steps from a table."""

    def __init__(self, method: Rosenbrock, w: Writer) -> None:
        super().__init__(method, w)
        self.table = method.table
        self.u = [w.array(2, 1) for _ in self.table.m]
        self.x, self.rates, self.increments, self.errors = (w.array(2, 1) for _ in range(4))
        self.control = StepController(self.table.error_order, safety=SAFETY, floor=1e-10, least=0.2, most=6.0)

    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Stages]:
        f, w, T = self.f, self.w, self.table
        factors = real_factors(w, t, w.state, (1.0 / T.gamma) / h)
        w.count(IntegerSlot.EVALUATIONS, len(T.m) + 1)
        per_h = 1.0 / h
        for i, stage in enumerate(self.u):
            before = self.u[:i]
            for c in w.each(w.size):
                self.x[c] = self._sum(T.a[i], before, c, w.state[c])
            w.rate(f.muladd(h, float(T.alpha[i]), t), self.x, self.rates)
            for c in w.each(w.size):
                right = f.muladd(per_h, self._sum(T.C[i], before, c), self.rates[c]) if i else self.rates[c]
                ft = factors.time_derivative(c) if T.gamma_sums[i] != 0.0 else None
                if ft is not None:
                    right = f.muladd(h * float(T.gamma_sums[i]), ft, right)
                stage[c] = right
            factors.solve(stage)
        # increments apart: in short steps dense output would lose their digits in the difference of two states
        for c in w.each(w.size):
            self.increments[c] = self._sum(T.m, self.u, c)
            w.new[c] = w.state[c] + self.increments[c]
            self.errors[c] = self._sum(T.e, self.u, c)
        square = mean_squares(w, 1, lambda c: [self.errors[c]])[0]
        return StepAttempt(square, Stages(self.increments, self.u))

    def _sum(
        self, weights: Sequence[float], u: Sequence[Array], c: Int | int, start: Value | None = None
    ) -> Value:
        f = self.f
        total = start
        for weight, stage in zip(weights, u):
            if weight != 0.0:
                total = stage[c] * weight if total is None else f.muladd(stage[c], weight, total)
        return f.constant(0.0) if total is None else total

    def save_dense(self, t: Value, h: Value, kept: Stages) -> None:
        w = self.w
        with self.used(t, h):
            for c in w.each(w.size):
                numbers = [w.state[c], kept.increments[c]]
                numbers += [self._sum(row, kept.u, c) for row in self.table.dense]
                for place, value in enumerate(numbers):
                    self._dense(place)[c] = value

    def _dense(self, place: int) -> Array:
        """Return the numbers of dense output at a place: start, increment, then what bends the way between."""
        return Array(self.f, self.f.offset("%dense", place * self.w.system.size))

    def dense(self, u: Value, h: Value, out: Array) -> None:
        """The method's own continuous extension, from its stages.

        Rates at the ends of the step have no place in it: in a stiff component they are the rounding error of the
        state times the fastest decay, which would show at every sample.
        """
        f, w = self.f, self.w
        x = u + 1.0
        kept = [self._dense(place) for place in range(2 + len(self.table.dense))]
        for c in w.each(w.size):
            x0, gained, *rest = (f.splat(numbers[c], u.width) for numbers in kept)
            bend = rest[-1]
            for d in reversed(rest[:-1]):
                bend = f.muladd(bend, x, d)
            out[c] = f.muladd(f.muladd(-u, bend, gained), x, x0)


rodas5p = partial(Rosenbrock, RODAS5P)  # of Steinebach: L-stable, for stiff springs and dampers
rosenbrock23 = partial(Rosenbrock, ROSENBROCK23)  # MATLAB's ode23s: L-stable, at loose tolerances

"""Linearly implicit methods for stiff motion: no iteration, one factored matrix per step, exact Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.methods.rosenbrock_tables import RODAS5P, ROSENBROCK23, RosenbrockTable
from robodyn_cli.integrators.runtime.layout import IntegerSlot
from robodyn_cli.integrators.stepping.control import Attempt, Controller, mean_squares
from robodyn_cli.integrators.stepping.factors import RealFactors
from robodyn_cli.integrators.stepping.stepper import Method, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Value
from robodyn_cli.kernels.program import Program
from robodyn_cli.record import mutable_record

SAFETY = 0.9


class Rosenbrock(Method):
    """Rosenbrock method given by its table; dense output from its stages."""

    def __init__(self, table: RosenbrockTable, facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.table = table
        self.dense_order = table.dense_order
        self.proportion = min(1.0, table.order / table.error_order)

    def linearisation(self, system: System) -> Program:
        return system.linearisation

    def dense_size(self, system: System) -> int:
        return (2 + len(self.table.dense)) * system.size

    def stepper(self, w: Writer) -> RosenbrockStepper:
        return RosenbrockStepper(self, w)


@mutable_record
class Stages:
    """A step: its start, what it adds to the state, and the stages u_i, lists of components."""

    x0: list[Value]
    increments: list[Value]
    u: list[list[Value]]


class RosenbrockStepper(Stepper[Stages]):
    """Writes steps from a table."""

    def __init__(self, method: Rosenbrock, w: Writer) -> None:
        super().__init__(method, w)
        self.table = method.table
        self.components = range(w.system.size)
        self.errors = w.array(2, 1)
        self.control = Controller(self.table.error_order, safety=SAFETY, floor=1e-10, least=0.2, most=6.0)

    def attempt(self, t: Value, h: Value, failed: Block) -> Attempt[Stages]:
        f, w, T = self.f, self.w, self.table
        x0 = [w.state[c] for c in self.components]
        factors = RealFactors(w, t, w.state, (1.0 / T.gamma) / h)
        w.count(IntegerSlot.EVALUATIONS, len(T.m) + 1)
        per_h = 1.0 / h
        u: list[list[Value]] = []
        for i in range(len(T.m)):
            x = [self._sum(T.a[i], u, c, x0[c]) for c in self.components]
            rate = w.rate_of(f.muladd(h, float(T.alpha[i]), t), x)
            right = []
            for c, ft in enumerate(factors.ft):
                total = f.muladd(per_h, self._sum(T.C[i], u, c), rate[c]) if i else rate[c]
                if ft is not None and T.gamma_sums[i] != 0.0:
                    total = f.muladd(h * float(T.gamma_sums[i]), ft, total)
                right.append(total)
            u.append(factors.solve(right))
        # increments apart: in short steps dense output would lose their digits in the difference of two states
        increments = [self._sum(T.m, u, c) for c in self.components]
        for c in self.components:
            w.new[c] = x0[c] + increments[c]
            self.errors[c] = self._sum(T.e, u, c)
        square = mean_squares(w, 1, lambda c: [self.errors[c]])[0]
        return Attempt(square, Stages(x0, increments, u))

    def _sum(
        self, weights: Sequence[float], u: list[list[Value]], c: int, start: Value | None = None
    ) -> Value:
        f = self.f
        total = start
        for weight, stage in zip(weights, u):
            if weight != 0.0:
                total = stage[c] * weight if total is None else f.muladd(stage[c], weight, total)
        return f.constant(0.0) if total is None else total

    def save_dense(self, t: Value, h: Value, kept: Stages) -> None:
        f = self.f
        with self.used(t, h):
            numbers = [*kept.x0, *kept.increments]
            for row in self.table.dense:
                numbers += [self._sum(row, kept.u, c) for c in self.components]
            for k, value in enumerate(numbers):
                f.store(value, f.offset("%dense", k))

    def dense(self, u: Value, h: Value, out: Array) -> None:
        """The method's own continuous extension, from its stages.

        Rates at the ends of the step have no place in it: in a stiff component they are the rounding error of the
        state times the fastest decay, which would show at every sample.
        """
        f, n = self.f, self.w.system.size
        x = u + 1.0
        for c in self.components:
            x0, gained, *rest = (
                f.splat(f.load(f.offset("%dense", place * n + c)), u.width)
                for place in range(2 + len(self.table.dense))
            )
            bend = rest[-1]
            for d in reversed(rest[:-1]):
                bend = f.muladd(bend, x, d)
            out[c] = f.muladd(f.muladd(-u, bend, gained), x, x0)


rodas5p = partial(Rosenbrock, RODAS5P)  # of Steinebach: L-stable, for stiff springs and dampers
rosenbrock23 = partial(Rosenbrock, ROSENBROCK23)  # MATLAB's ode23s: L-stable, at loose tolerances

"""Taylor series methods: all coefficients of the solution up to an order follow from the equations by recurrences.

The step that a tolerance allows is known before it is taken, from the last two coefficients (Jorba and Zou 2005). What
they leave is judged at its end by the defect of the series there, v-dot(t + h) - a(t + h).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.runtime.memory import IntegerSlot
from robodyn_cli.integrators.stepping.control import StepAttempt, StepController, tolerance
from robodyn_cli.integrators.stepping.stepper import Method, Stepper
from robodyn_cli.integrators.stepping.writer import LONG, Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Value
from robodyn_cli.kernels.mathematics import rough_exp2, rough_log2
from robodyn_cli.kernels.series.jets import Jets

MOST = 256  # operations of the equations: at order 16 these take four seconds to compile
# times the last two coefficients are below the tolerance at a step's end: errors are those of the other methods of high
# order at this tolerance, and hardly a step is tried again
BELOW = 30.0
ACCEPTED = 0.05  # of the tolerance, that a step may leave: some 30 times what it leaves where nothing kinks
Coefficients = list["list[Value | None]"]


class Taylor(Method):
    """The Taylor series of an order."""

    vectors = True

    def __init__(self, facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.dense_order = facts.order

    def obstacle(self, system: System) -> str:
        if why := super().obstacle(system):
            return why
        if system.dynamics.any_size:
            return f"a chain of {system.nv} joints is integrated by loops over its bodies, which have no Taylor series"
        operations = system.dynamics.program.operations
        if operations > MOST or max(system.nv, system.nz) > LONG:
            return f"its equations take {operations} operations, and a Taylor series is written out for {MOST} at most"
        return ""

    def dense_size(self, system: System) -> int:
        return system.size * (self.order + 2)

    def stepper(self, w: Writer) -> TaylorStepper:
        return TaylorStepper(self, w)


class TaylorStepper(Stepper[Coefficients]):
    """Writes steps along a Taylor series."""

    def __init__(self, method: Taylor, w: Writer) -> None:
        super().__init__(method, w)
        self.rates = w.array(1, 1)
        self.coefficients: Coefficients = []
        self.weights: list[Value] = []
        self.integrated = range(w.system.nq, w.system.size)
        self.control = StepController(
            method.order + 1.0, safety=0.9, floor=1e-10, least=0.2, most=8.0, accept=ACCEPTED
        )

    def begin(self, t: Value) -> Value | None:
        """Emit the coefficients; return the step at whose end the last two are so far below the tolerance."""
        f, w, order = self.f, self.w, self.method.order
        self.coefficients = self._jets(t)
        with f.strict():
            self.weights = [1.0 / tolerance(w, f.abs(w.state[c])) for c in self.integrated]
            last = [
                (
                    rough_log2(f, self._square([self.coefficients[c][n] for c in self.integrated]) + 1e-300)
                    + 2.0 * math.log2(BELOW)
                )
                * (-0.5 / n)
                for n in (order, order - 1)
            ]
            return rough_exp2(f, f.min(*last))

    def _square(self, errors: Sequence[Value | None]) -> Value:
        """Return the mean square of errors of what is integrated in units of the tolerance."""
        total = self.f.constant(0.0, self.w.width)
        for error, weight in zip(errors, self.weights):
            if error is not None:
                e = error * weight
                total = self.f.muladd(e, e, total)
        return total * (1.0 / max(len(self.weights), 1))

    def _jets(self, t: Value) -> Coefficients:
        w, s = self.w, self.w.system
        w.count(IntegerSlot.EVALUATIONS, self.method.order)  # a coefficient of the rates counts as one
        program, state = s.dynamics.program, [w.state[k] for k in range(s.size)]
        jets = Jets(self.f, program, w.inputs(program, t, w.state), state, s.nv, w.programs.fused)
        return jets.up_to(self.method.order)

    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Coefficients]:
        f, w, s = self.f, self.w, self.w.system
        slopes = []
        for c, coefficients in enumerate(self.coefficients):
            w.new[c], slope = self._along(coefficients, h)
            slopes.append(slope)
        w.dynamics(t + h, w.new, self.rates)
        w.count(IntegerSlot.EVALUATIONS)
        with f.strict():
            defects = [slopes[c] - self.rates[c - s.nq] for c in self.integrated]
            left = h * (1.0 / (self.method.order + 1))
            return StepAttempt(self._square(defects) * left * left, self.coefficients)

    def _along(self, coefficients: Sequence[Value | None], h: Value) -> tuple[Value, Value]:
        """Return a polynomial and its slope at h by Horner's scheme."""
        f, zero = self.f, self.f.constant(0.0, h.width)
        *others, last = (zero if x is None else x for x in coefficients)
        value, slope = last, zero
        for n, x in enumerate(reversed(others)):
            slope = value if n == 0 else f.muladd(slope, h, value)
            value = f.muladd(value, h, x)
        return value, slope

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: Coefficients) -> None:
        f, rows = self.f, self.method.order + 2
        with self.used(t, h):
            for c, coefficients in enumerate(kept):
                for n in range(rows):
                    x = coefficients[n] if n < len(coefficients) else None
                    f.store(f.constant(0.0) if x is None else x, f.offset("%dense", c * rows + n))

    def dense(self, u: Value, h: Value, out: Array) -> None:
        f, rows = self.f, self.method.order + 2
        s = (u + 1.0) * h
        for c in range(self.w.system.size):
            row = [f.splat(f.load(f.offset("%dense", c * rows + n)), u.width) for n in range(rows)]
            out[c] = self._along(row, s)[0]

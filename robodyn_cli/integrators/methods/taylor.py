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
from robodyn_cli.kernels.ir import Block, Condition, Value
from robodyn_cli.kernels.lower import loaded, values_of
from robodyn_cli.kernels.mathematics import rough_exp2, rough_log2
from robodyn_cli.kernels.program import NUMBERS
from robodyn_cli.kernels.series.jets import Coefficients, Jets
from robodyn_cli.kernels.series.rules import Series

MOST = (
    256  # operations of the equations: of more, coefficients outgrow the nearest cache, and `gauss` is faster
)
# times the last two coefficients are below the tolerance at a step's end: errors are those of the other methods of high
# order at this tolerance, and hardly a step is tried again
BELOW = 30.0
ACCEPTED = 0.05  # of the tolerance, that a step may leave: some 30 times what it leaves where nothing kinks


HELD = frozenset({"const", "number", "sym"})  # instructions that take no code of their own


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

    knows_end = True

    def __init__(self, method: Taylor, w: Writer) -> None:
        super().__init__(method, w)
        self.series = Series.of(w.system.dynamics.program)
        code = self.series.program.instructions
        # where the state is: at the end of a step for the next one
        self.kept = {k for k in self.series.read if code[k].op not in HELD}
        self.values = Array(w.f, w.f.slot(w.width, len(code)), w.width)
        self.coefficients: Coefficients
        self.weights: list[Value] = []
        self.integrated = range(w.system.nq, w.system.size)
        self.control = StepController(
            method.order + 1.0, safety=0.9, floor=1e-10, least=0.2, most=8.0, accept=ACCEPTED
        )

    def begin(self, t: Value) -> Value | None:
        """Emit the coefficients; return the step at whose end the last two are so far below the tolerance."""
        f, w, order = self.f, self.w, self.method.order
        with f.when(f.compare_int("eq", f.load_int(w.integer_at(IntegerSlot.RATE_KNOWN)), 0)):
            self._evaluate(t, w.state, w.begins_anew())
        w.count(IntegerSlot.EVALUATIONS, order - 1)  # a coefficient of the rates counts as one
        state = [w.state[k] for k in range(w.system.size)]
        self.coefficients = Jets(f, self.series, self._values(t), state, w.system.nv).up_to(order)
        with f.strict():
            self.weights = [1.0 / tolerance(w, c, f.abs(w.state[c])) for c in self.integrated]
            last = [
                (
                    rough_log2(
                        f, self._square([self.coefficients.at(c, n) for c in self.integrated]) + 1e-300
                    )
                    + 2.0 * math.log2(BELOW)
                )
                * (-0.5 / n)
                for n in (order, order - 1)
            ]
            return rough_exp2(f, f.min(*last))

    def _square(self, errors: Sequence[Value]) -> Value:
        """Return the mean square of errors of what is integrated in units of the tolerance."""
        total = self.f.constant(0.0, self.w.width)
        for error, weight in zip(errors, self.weights):
            e = error * weight
            total = self.f.muladd(e, e, total)
        return total * (1.0 / max(len(self.weights), 1))

    def _evaluate(self, t: Value, x: Array, where: Condition | None = None) -> list[Value]:
        """Return the value of each instruction at a state, and keep those that coefficients follow from.

        where : in which lanes they are kept, None: in all. Other lanes keep theirs to the bit: what a run comes to does
        not depend on those beside it.
        """
        f, w, program = self.f, self.w, self.series.program
        w.count(IntegerSlot.EVALUATIONS, where=where)
        inputs = loaded(f, program, w.inputs(w.system.dynamics.program, t, x), w.width)
        found = values_of(f, program, inputs, w.width, w.programs.fused)
        for k, value in enumerate(found):
            if k in self.kept:
                self.values[k] = value if where is None else f.select(where, value, self.values[k])
        return found

    def _values(self, t: Value) -> dict[int, Value]:
        """Return what coefficients follow from: the values that are kept, and what lies in memory anyway."""
        f, w, program = self.f, self.w, self.series.program
        inputs = loaded(f, program, w.inputs(w.system.dynamics.program, t, w.state), w.width)
        found = {}
        for k in self.series.read:
            i = program.instructions[k]
            if i.op == "const":
                found[k] = f.constant(i.value, w.width)
            elif i.op in HELD:
                group, place = i.value if i.op == "sym" else (NUMBERS, i.value)
                found[k] = f.splat(inputs[group][place], w.width)
            else:
                found[k] = self.values[k]
        return found

    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Coefficients]:
        f, w, s = self.f, self.w, self.w.system
        slopes = []
        for c, (value, slope) in enumerate(self.coefficients.along(h)):
            w.new[c] = value
            slopes.append(slope)
        found = self._evaluate(t + h, w.new)
        outputs = self.series.program.outputs
        rates = [
            f.constant(r, w.width) if isinstance(r, float) else found[r]
            for r in (*outputs.get("a", ()), *outputs.get("z", ()))
        ]
        with f.strict():
            defects = [slopes[c] - rates[c - s.nq] for c in self.integrated]
            left = h * (1.0 / (self.method.order + 1))
            return StepAttempt(self._square(defects) * left * left, self.coefficients)

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: Coefficients) -> None:
        f, size, order = self.f, self.w.system.size, self.method.order
        with self.used(t, h):
            for c in range(size):
                with f.count(order + 1 + (c < self.w.system.nv)) as n:
                    f.store(kept.at(c, n), f.offset("%dense", n * size + c))

    def dense(self, u: Value, h: Value, out: Array) -> None:
        f, s = self.f, self.w.system
        kept = Coefficients(Array(f, "%dense"), s.size, range(s.size), self.method.order, s.nv)
        for c, (value, _) in enumerate(kept.along((u + 1.0) * h)):
            out[c] = value

"""Gauss collocation with fewer stages: of order 8 to 14 with step control, of order 2 to 6 with a fixed step.

With few stages the Legendre coefficients of the rates say little about the error, while a fixed step is what
long-time energy behaviour wants: symplectic methods keep it only as long as their step stays the same.
"""

from __future__ import annotations

from robodyn_cli.integrators.methods.gauss import Gauss
from robodyn_cli.integrators.runtime.layout import DoubleSlot
from robodyn_cli.integrators.stepping.stepper import Attempt
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Total
from robodyn_cli.kernels.ir import Value

SOLVED = 1e-13  # relative tolerance of a step's iteration where no error is controlled
SMALLEST = 1e-15


class Gauss8(Gauss):
    """Gauss method with 4 stages: order 8."""

    name = "gauss8"
    order = 8
    dense_order = 4
    stages = 4


class Gauss10(Gauss):
    """Gauss method with 5 stages: order 10."""

    name = "gauss10"
    order = 10
    dense_order = 5
    stages = 5


class Gauss12(Gauss):
    """Gauss method with 6 stages: order 12."""

    name = "gauss12"
    order = 12
    dense_order = 6
    stages = 6


class Gauss14(Gauss):
    """Gauss method with 7 stages: order 14."""

    name = "gauss14"
    order = 14
    dense_order = 7
    stages = 7


class FixedGauss(Gauss):
    """Gauss method with a fixed step, each step solved to rounding."""

    adaptive = False

    def _tolerances(self, w: Writer) -> tuple[Value, Value]:
        return w.f.constant(SOLVED), w.f.constant(SMALLEST)

    def _judge(self, w: Writer, t: Value, h: Value) -> Attempt:
        """Accept every step that is solved and finite; note the sizes of the rates for the next one."""
        f = w.f
        with f.strict():
            total = Total(f)
            for j in w.each(w.rates):
                self.sizes[j] = self._mean(w, self.guess[j])
            for k in w.each(w.size):
                total.add_product(w.new[k], 0.0)
            finite = f.compare("ord", total.value, 0.0)
            error = f.select(finite, f.constant(0.0), total.value)
        w.put(DoubleSlot.CONTRACTION, f.min(w.get(DoubleSlot.CONTRACTION), 1.0))
        return Attempt(error, f.constant(1.0))


class Gauss6(FixedGauss):
    """Gauss method with 3 stages and a fixed step: order 6."""

    name = "gauss6"
    order = 6
    dense_order = 3
    stages = 3


class Gauss4(FixedGauss):
    """Gauss method with 2 stages and a fixed step: order 4."""

    name = "gauss4"
    order = 4
    dense_order = 2
    stages = 2


class ImplicitMidpoint(FixedGauss):
    """The implicit midpoint rule, the Gauss method with one stage, with a fixed step: order 2."""

    name = "implicit_midpoint"
    order = 2
    dense_order = 1
    stages = 1

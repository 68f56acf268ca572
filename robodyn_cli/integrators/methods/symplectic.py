"""Symplectic partitioned methods with a fixed step: compositions of the Stormer-Verlet scheme.

For v-dot = a(t, q), which a constant mass matrix gives, drift (q changes at constant v) and kick (v changes at constant
q) are solved exactly; half a drift, a kick and half a drift make Verlet's scheme of order 2, and schemes with steps
gamma_i h in a row are of order 4 to 8 (Hairer, Lubich and Wanner 2006, V.3). They are explicit, symplectic and
symmetric: over long times the error of the energy stays bounded.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.control import StepAttempt
from robodyn_cli.integrators.stepping.hermite import Ends, HermiteOutput, hermite_size
from robodyn_cli.integrators.stepping.stepper import Method, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Value

SUZUKI = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))


def composed(order: int, *first: float) -> tuple[float, ...]:
    """Return gamma_i of a symmetric composition from its first half; the one in the middle makes their sum 1.

    Raises
    ------
    ArithmeticError : a power sum that the order asks for does not vanish.
    """
    gammas = (*first, 1.0 - 2.0 * sum(first), *reversed(first))
    for k in range(3, order, 2):
        if abs(sum(g**k for g in gammas)) > 1e-13:
            raise ArithmeticError(f"a condition of order {k} fails")
    return gammas


# fmt: off
# of order 4 by Suzuki, of orders 6 and 8 by Kahan and Li (1997)
COMPOSITIONS = {
    2: composed(2),
    4: composed(4, SUZUKI, SUZUKI),
    6: composed(
        6, 0.39216144400731413928, 0.33259913678935943860, -0.70624617255763935981, 0.082213596293550800230
    ),
    8: composed(
        8,
        0.13020248308889008088,
        0.56116298177510838456,
        -0.38947496264484728641,
        0.15884190655515560090,
        -0.39590389413323757734,
        0.18453964097831570709,
        0.25837438768632204729,
        0.29501172360931029887,
    ),
}
# fmt: on


class Composition(Method):
    """A composition of Verlet steps of order 2, 4, 6 or 8, with a fixed step."""

    instead = ("gauss (of any order)", "implicit_midpoint")

    def __init__(self, facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.gammas = COMPOSITIONS[facts.order]
        self.dense_order = min(facts.order, 4)

    def obstacle(self, system: System) -> str:
        why = _obstacle(system)
        if not why:
            return ""
        needed = "a symplectic partitioned method needs accelerations that depend on positions and time only"
        return f"{needed}, as a constant mass matrix without dampers and loops gives them; {why}"

    def dense_size(self, system: System) -> int:
        return hermite_size(system) + system.size

    def stepper(self, w: Writer) -> CompositionStepper:
        return CompositionStepper(self, w)


class CompositionStepper(Stepper[list[Value]]):
    """Writes composed steps; the state at the start is what dense output needs."""

    def __init__(self, method: Composition, w: Writer) -> None:
        super().__init__(method, w)
        self.gammas = method.gammas
        self.steps = w.f.table("gammas", self.gammas)
        self.middles = w.f.table("middles", np.cumsum(self.gammas) - 0.5 * np.array(self.gammas))
        self.x, self.rates = w.array(2, 1), w.array(1, 1)
        self.hermite = HermiteOutput(w)

    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[list[Value]]:
        w = self.w
        x0 = [w.state[k] for k in range(w.system.size)]
        for k, x in enumerate(x0):
            self.x[k] = x
        self._flow(t, h)
        for k in range(len(x0)):
            w.new[k] = self.x[k]
        return StepAttempt(None, x0)

    def _flow(self, t: Value, h: Value) -> None:
        """Take the state in ``x`` over a step of length h."""
        f, w, s, x, rates = self.f, self.w, self.w.system, self.x, self.rates
        with f.count(len(self.gammas)) as i:
            step = f.load(f.offset(self.steps, i)) * h
            half = step * 0.5
            middle = f.muladd(h, f.load(f.offset(self.middles, i)), t)
            for k in range(s.nq):
                x[k] = f.muladd(half, x[s.nq + k], x[k])
            w.dynamics(middle, x, rates)
            w.count(IntegerSlot.EVALUATIONS)
            kicks = [rates[k] for k in range(s.nv)]
            if s.nz:
                # a pure integral, such as work, takes its rate in the middle
                for k in range(s.nv):
                    x[s.nq + k] = f.muladd(half, kicks[k], x[s.nq + k])
                w.dynamics(middle, x, rates)
                for k in range(s.nz):
                    x[s.nq + s.nv + k] = f.muladd(step, rates[s.nv + k], x[s.nq + s.nv + k])
            for k in range(s.nv):
                x[s.nq + k] = f.muladd(half if s.nz else step, kicks[k], x[s.nq + k])
            for k in range(s.nq):
                x[k] = f.muladd(half, x[s.nq + k], x[k])

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: list[Value]) -> None:
        f, w, s = self.f, self.w, self.w.system
        for k, value in enumerate(kept):
            f.store(value, self._kept(k))
        with f.when(f.compare_int("ne", f.load_int(w.integer_at(IntegerSlot.WATCH)), 0)):
            new = [w.new[k] for k in range(s.size)]
            rates = w.rate_of(t, kept), w.rate_of(t + h, new)
            w.count(IntegerSlot.EVALUATIONS, 2)
            self.hermite.save(t, h, Ends(kept, [b - a for a, b in zip(kept, new)], *rates))

    def _kept(self, k: int) -> str:
        return self.f.offset("%dense", hermite_size(self.w.system) + k)

    def dense(self, u: Value, h: Value, out: Array) -> None:
        self.hermite.dense(u, h, out)

    def sample(self, u: Value, h: Value, out: Array) -> None:
        """Take a step of its own from the start of the last one to the sample."""
        w = self.w
        for k in range(w.system.size):
            self.x[k] = self.f.load(self._kept(k))
        self._flow(w.get(DoubleSlot.T_OLD), h + h * u)
        for k in range(w.system.size):
            out[k] = self.x[k]


def _obstacle(system: System) -> str:
    """Return why a system cannot be split into drift and kick, or nothing."""
    if system.dynamics.any_size:
        return "the accelerations of a long chain depend on its velocities"

    def found(rates: Sequence[Scalar], groups: str) -> list[str]:
        return [str(e.value[0]) for e in free_symbols(list(rates)) if e.value[1] in groups]

    velocities = found(system.acceleration, "v")
    if velocities:
        return f"here they depend on velocities ({', '.join(sorted(velocities)[:3])})"
    if found(system.acceleration, "z") or found(system.z_rate, "z"):
        return "here they depend on further states"
    return ""

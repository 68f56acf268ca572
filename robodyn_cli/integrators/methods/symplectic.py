"""Symplectic partitioned methods with a fixed step: compositions of the Stormer-Verlet scheme.

For v-dot = a(t, q), which a constant mass matrix gives, drift (q changes at constant v) and kick (v changes at constant
q) are solved exactly; half a drift, a kick and half a drift make Verlet's scheme of order 2, and schemes with steps
gamma_i h in a row are of order 4 to 8 (Hairer, Lubich and Wanner 2006, V.3). They are explicit, symplectic and
symmetric: over long times the error of the energy stays bounded.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.hermite import HermiteStepper
from robodyn_cli.integrators.stepping.stepper import Attempt
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Value, literal

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


class Verlet(HermiteStepper):
    """The Stormer-Verlet scheme with a fixed step: order 2, one evaluation a step."""

    name = "verlet"
    order = 2
    dense_order = 2
    adaptive = False
    symplectic = True
    gammas: tuple[float, ...] = composed(2)

    def dense_size(self, system: System) -> int:
        return super().dense_size(system) + system.size

    def obstacle(self, system: System) -> str:
        return obstacle(system)

    def prepare(self, w: Writer) -> None:
        refuse(self.name, w.system)
        f = w.f
        middles = np.cumsum(self.gammas) - 0.5 * np.array(self.gammas)
        for name, row in (("gammas", self.gammas), ("middles", middles)):
            flat = ", ".join(f"double {literal(float(x))}" for x in row)
            f.globals.append(
                f"@{name} = private unnamed_addr constant [{len(row)} x double] [{flat}], align 64"
            )
        self.x, self.rates = w.array(2, 1), w.array(1, 1)

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, n = w.f, w.system.size
        self.x0 = [w.state[k] for k in range(n)]
        for k in range(n):
            self.x[k] = self.x0[k]
        self._flow(w, t, h)
        with f.strict():
            total = Total(f)
            for k in range(n):
                w.new[k] = self.x[k]
                total.add_product(w.new[k], 0.0)
            finite = f.compare("ord", total.value, 0.0)
            error = f.select(finite, f.constant(0.0), total.value)
        return Attempt(error, f.constant(1.0))

    def _flow(self, w: Writer, t: Value, h: Value) -> None:
        """Take the state in ``x`` over a step of length h."""
        f, s, x, rates = w.f, w.system, self.x, self.rates
        with f.count(len(self.gammas)) as i:
            step = f.load(f.offset("@gammas", i)) * h
            half = step * 0.5
            middle = f.muladd(h, f.load(f.offset("@middles", i)), t)
            for k in range(s.nq):
                x[k] = f.muladd(half, x[s.nq + k], x[k])
            w.dynamics(middle, x, rates)
            w.count(IntegerSlot.EVALUATIONS)
            kicks = [rates[k] for k in range(s.nv)]
            if s.nz:
                # what only collects, such as work, takes its rate in the middle
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
    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, s = w.f, w.system
        for k, value in enumerate(self.x0):
            f.store(value, self._kept(w, k))
        with f.when(f.compare_int("ne", f.load_int(w.integer_at(IntegerSlot.WATCH)), 0)):
            self.increments = [w.new[k] - self.x0[k] for k in range(s.size)]
            self.rate0 = w.rate_of(t, self.x0)
            w.count(IntegerSlot.EVALUATIONS)
            super().save_dense(w, t, h)

    def _kept(self, w: Writer, k: int) -> str:
        return w.f.offset("%dense", super().dense_size(w.system) + k)

    def sample(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        """Take a step of its own from the start of the last one to the sample."""
        f = w.f
        for k in range(w.system.size):
            self.x[k] = f.load(self._kept(w, k))
        self._flow(w, w.get(DoubleSlot.T_OLD), h + h * u)
        for k in range(w.system.size):
            out[k] = self.x[k]


class Symplectic4(Verlet):
    """Suzuki's composition of 5 Verlet steps: order 4, fixed step."""

    name = "symplectic4"
    order = 4
    dense_order = 4
    gammas = composed(4, SUZUKI, SUZUKI)


class Symplectic6(Verlet):
    """Kahan and Li's (1997) composition of 9 Verlet steps: order 6, fixed step."""

    name = "symplectic6"
    order = 6
    dense_order = 4
    gammas = composed(
        6, 0.39216144400731413928, 0.33259913678935943860, -0.70624617255763935981, 0.082213596293550800230
    )


class Symplectic8(Verlet):
    """Kahan and Li's (1997) composition of 17 Verlet steps: order 8, fixed step."""

    name = "symplectic8"
    order = 8
    dense_order = 4
    gammas = composed(
        8, 0.13020248308889008088, 0.56116298177510838456, -0.38947496264484728641, 0.15884190655515560090,
        -0.39590389413323757734, 0.18453964097831570709, 0.25837438768632204729, 0.29501172360931029887,
    )  # fmt: skip


def obstacle(system: System) -> str:
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


def refuse(method: str, system: System) -> None:
    """Raise CapabilityError where a system cannot be split."""
    why = obstacle(system)
    if why:
        raise CapabilityError(
            f"the symplectic partitioned method {method!r} needs accelerations that depend on positions and time only, "
            f"as a constant mass matrix without dampers and loops gives them: {why}; allowed: gauss (of any order), "
            "implicit_midpoint"
        )

"""Steps of equations that rounding puts off by far: links of next to no mass, joints whose axes nearly coincide.

Torques are rounded, and divided by the little inertia that such joints have left. What this makes of a velocity in a
step does not fall with a power of the step as errors do, so that no tolerance below it can be kept: steps would only
get shorter and shorter. So it is measured on the way, as it may change a thousandfold within a run, and no error that
is smaller counts.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.stepper import Method
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.ir import Int, Value

DRAWS = 2  # evaluations beside that of the state itself
EVERY = 4  # steps, a power of two: a step may be longer than the last one by a small factor only
ROUNDING = 2.0**-52  # of a number, or of 1 rad and 1 m
JUMP = 1e-4  # of the largest rate: more than that may be one of its jumps


def step_rounding(w: Writer, method: Method) -> StepRounding | None:
    """Return what measures rounding; None where it is as usual, or no error decides on steps."""
    return StepRounding(w, method) if w.system.is_rounded and method.adaptive else None


class StepRounding:
    """Writes the measurement of how far rounding puts rates off [rad/s^2, m/s^2], and what that makes of tolerances."""

    def __init__(self, w: Writer, method: Method) -> None:
        self.w, self.f, self.method = w, w.f, method
        self.x, self.rates, self.moved = w.array(2, 1), w.array(1, 1), w.array(1, 1)
        self.off, self.largest = w.f.slot(), w.f.slot()
        self.changes = w.f.table("rounding.changes", last_digits(8).T.ravel())

    def begin(self) -> None:
        """Measure at the state, every few steps and behind each that was rejected."""
        f, w = self.f, self.w
        accepted = f.load_int(w.integer_at(IntegerSlot.ACCEPTED))
        due = f.compare_int("eq", accepted & (EVERY - 1), 0)
        with f.when(due | w.rejected_before()):
            self._measure(w.get(DoubleSlot.T))

    def tolerance(self, h: Value, atol: Value, above: float) -> Value:
        """Return the tolerance of a step of length h: ``atol``, and no less than rounding asks for."""
        if self.method.needs_jacobian:
            return atol  # steps are far longer than fast modes, which forget what rounding did
        return self.f.max(atol, h * self.w.get(DoubleSlot.ROUNDING) * above)

    def commit(self, h: Value) -> None:
        """Add what rounding makes of rates in a step of length h."""
        w = self.w
        w.put(DoubleSlot.ROUNDED, self.f.muladd(h, w.get(DoubleSlot.ROUNDING), w.get(DoubleSlot.ROUNDED)))

    def _measure(self, t: Value) -> None:
        f, w = self.f, self.w
        f.store(0.0, self.off)
        f.store(0.0, self.largest)
        w.dynamics(t, w.state, self.rates)
        for draw in range(DRAWS):
            with f.strict():
                for c in w.each(w.size):
                    x = w.state[c]
                    self.x[c] = f.muladd(f.max(f.abs(x), 1.0), self._change(c, draw), x)
            w.dynamics(t, self.x, self.moved)
            with f.strict():
                for j in w.each(w.nv):
                    rate = self.rates[j]
                    self._enlarge(self.off, f.abs(self.moved[j] - rate))
                    self._enlarge(self.largest, f.abs(rate))
        w.count(IntegerSlot.EVALUATIONS, 1 + DRAWS)
        off = f.load(self.off)
        jumps = any(event.is_discontinuity for event in w.system.events)
        known = f.compare("olt", off, f.load(self.largest) * (JUMP if jumps else 1.0))
        w.put(DoubleSlot.ROUNDING, f.select(known, off, 0.0))

    def _enlarge(self, largest: str, x: Value) -> None:
        """Let a slot hold the larger one of what it holds and x."""
        f = self.f
        so_far = f.load(largest)
        f.store(f.select(f.compare("ogt", x, so_far), x, so_far), largest)

    def _change(self, c: Int | int, draw: int) -> Value:
        """Return by how much rounding changes component c, in a draw."""
        return self.f.load(self.f.offset(self.changes, (c & 7) * DRAWS + draw))


def last_digits(count: int) -> np.ndarray:
    """Return by how much rounding puts so many components off (draw, count), as a part of them or of 1 rad and 1 m.

    Neighbours are not alike in all draws.
    """
    return np.array([[ROUNDING * (-1.0) ** (c >> draw) for c in range(count)] for draw in range(DRAWS)])

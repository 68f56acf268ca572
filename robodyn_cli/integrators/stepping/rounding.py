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

DRAWS = 3  # evaluations beside that of the state itself
EVERY = 4  # steps, a power of two: a step may be longer than the last one by a small factor only
FADES = 0.1  # by what was measured before: few draws may happen to agree
ROUNDING = 2.0**-52  # of a number, or of 1 rad and 1 m
ABOVE = 8.0  # times what is measured, up to which an error is of rounding
JUMP = 1e-4  # of the largest acceleration so far: more than that may be one of its jumps


def step_rounding(w: Writer, method: Method) -> StepRounding | None:
    """Return what measures rounding; None where it is as usual, or no error decides on steps."""
    return StepRounding(w, method) if w.system.is_rounded and method.adaptive else None


class StepRounding:
    """Writes the measurement of how far rounding puts accelerations off [rad/s^2, m/s^2], and which errors of the state
    in a step do not count for it (``Writer.rounded``)."""

    def __init__(self, w: Writer, method: Method) -> None:
        self.w, self.f = w, w.f
        self.velocities = [place - w.system.nq for place in w.system.v_places]  # among the rates
        self.x, self.rates, self.moved, self.off = w.array(2, 1), *(w.array(1, 1) for _ in range(3))
        self.known = w.f.int_slot()
        w.f.store_int(0, self.known)
        for k in self.velocities:
            self.off[k] = w.f.constant(0.0)
        # steps of implicit methods are far longer than fast modes, which forget what rounding did
        w.rounded = None if method.needs_jacobian else w.array(2, 1)
        if w.rounded is not None:  # a method may look at it before the first length is known
            for c in w.each(w.size):
                w.rounded[c] = w.f.constant(0.0)
        self.changes = w.f.table("rounding.changes", last_digits(8).T.ravel())

    def begin(self) -> None:
        """Measure at the state, every few steps and behind each that was rejected."""
        f, w = self.f, self.w
        accepted = f.load_int(w.integer_at(IntegerSlot.ACCEPTED))
        due = f.compare_int("eq", accepted & (EVERY - 1), 0)
        unknown = f.compare_int("eq", f.load_int(self.known), 0)  # the run has only been taken up again
        with f.when(due | unknown | w.rejected_before()):
            self._measure(w.get(DoubleSlot.T))
            f.store_int(1, self.known)

    def allow(self, h: Value) -> None:
        """Set what rounding makes of velocities in a step of length h at most, and they of the rest."""
        w = self.w
        if w.rounded is None:
            return
        with self.f.strict():
            velocity = h * ABOVE
            position = h * velocity
            for k in range(w.system.nq):
                w.rounded[k] = position * self.off[k]
            for k in range(w.system.nv + w.system.nz):
                own = k in self.velocities
                off = velocity * self.off[k] if own else position * w.get(DoubleSlot.ROUNDING)
                w.rounded[w.system.nq + k] = off

    def commit(self, h: Value) -> None:
        """Add what rounding makes of rates in a step of length h."""
        w = self.w
        w.put(DoubleSlot.ROUNDED, self.f.muladd(h, w.get(DoubleSlot.ROUNDING), w.get(DoubleSlot.ROUNDED)))

    def _measure(self, t: Value) -> None:
        f, w = self.f, self.w
        w.dynamics(t, w.state, self.rates)
        for k in self.velocities:
            self.off[k] = self.off[k] * FADES
        for draw in range(DRAWS):
            with f.strict():
                for c in w.each(w.size):
                    x = w.state[c]
                    self.x[c] = f.muladd(f.max(f.abs(x), 1.0), self._change(c, draw), x)
            w.dynamics(t, self.x, self.moved)
            with f.strict():
                for k in self.velocities:
                    self.off[k] = f.max(self.off[k], f.abs(self.moved[k] - self.rates[k]))
        w.count(IntegerSlot.EVALUATIONS, 1 + DRAWS)
        jumps = any(event.is_discontinuity for event in w.system.events)
        with f.strict():
            off, largest = f.constant(0.0), w.get(DoubleSlot.LARGEST)
            for k in self.velocities:
                off, largest = f.max(off, self.off[k]), f.max(largest, f.abs(self.rates[k]))
            known = f.compare("olt", off, largest * (JUMP if jumps else 1.0))
            for k in self.velocities:
                self.off[k] = f.select(known, self.off[k], 0.0)
        w.put(DoubleSlot.LARGEST, largest)
        w.put(DoubleSlot.ROUNDING, f.select(known, off, 0.0))

    def _change(self, c: Int | int, draw: int) -> Value:
        """Return by how much rounding changes component c, in a draw."""
        return self.f.load(self.f.offset(self.changes, (c & 7) * DRAWS + draw))


def last_digits(count: int) -> np.ndarray:
    """Return by how much rounding puts so many components off (draw, count), as a part of them or of 1 rad and 1 m.

    No two of eight neighbours are alike in all draws.
    """
    return np.array([[ROUNDING * (-1.0) ** (c >> draw) for c in range(count)] for draw in range(DRAWS)])

"""Steps from a state on a jump of the right-hand side.

Rounding moves an event function g by some d, as terms of it are rounded and as the time is. Where |g| < d, rounding
decides on which side the stages of a step are: no step from there satisfies a tight tolerance, Newton's method need not
converge, and the shorter steps get the less they move g. Nor need they: a step that moves g by less than d changes
nothing that is known of when the motion passes the jump. So where a step ends on a jump, and where one has failed, the
next is tried whatever its error, and counts if it stays on a jump. Every other step is judged by its error.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.integrators.runtime.memory import DoubleSlot
from robodyn_cli.integrators.stepping.control import StepVerdict
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Condition, Int, LoopBlock, Value
from robodyn_cli.kernels.lower import LANES

UNCHECKED = 1e30  # atol of a step that is tried whatever its error
LONGEST = 1e-9  # of the time so far, or of a second: longer steps are always checked
SHORTEST = 32 * 2.3e-16  # of the time: what rounding makes of it in a step
ROUNDING = 2.0**-52  # of a number
SPREADS = 4.0  # rounding moves a function so many times as far as this does, to each number of the state


def jump_steps(w: Writer, adaptive: bool) -> JumpSteps | None:
    """Return what tries steps unchecked; None where no error decides on steps, or nothing jumps."""
    jumps = [k for k, event in enumerate(w.system.events) if event.is_discontinuity]
    return JumpSteps(w, jumps) if adaptive and jumps else None


class JumpSteps:
    """Writes the trials of unchecked steps. jumps : the functions that tell of jumps."""

    def __init__(self, w: Writer, jumps: list[int]) -> None:
        self.w, self.f, self.jumps = w, w.f, jumps
        self.x, self.stays = w.array(2, 1, LANES), w.f.int_slot()
        self.factors = w.f.table("jumps.factors", (1.0 + ROUNDING * _signs()).ravel())

    def _is_unchecked(self) -> Condition:
        return self.f.compare("ogt", self.w.get(DoubleSlot.CHECKED), 0.0)

    def _is_short(self, t: Value, h: Value) -> Condition:
        return self.f.compare("ole", h, self.f.max(self.f.abs(t), 1.0) * LONGEST)

    def begin(self) -> None:
        """Set the tolerance of the step to be tried."""
        atol = self.f.select(self._is_unchecked(), UNCHECKED, self.w.get(DoubleSlot.GIVEN_ATOL))
        self.w.put(DoubleSlot.ATOL, atol)

    def check(self, t: Value, h: Value, verdict: StepVerdict) -> None:
        """Find out whether a step stays on a jump; one that is not checked counts only then."""
        f = self.f
        f.store_int(0, self.stays)
        with f.when(self._is_short(t, h)):
            f.store_int(f.select_int(self._stays_on_jump(t, h), 1, 0), self.stays)
        leaves = f.compare_int("eq", f.load_int(self.stays), 0)
        verdict.square = f.select(self._is_unchecked() & leaves, 1e300, verdict.square)

    def commit(self) -> None:
        """Let the step after one that stays on a jump be unchecked, so that it may be longer."""
        f, w = self.f, self.w
        stays = f.compare_int("ne", f.load_int(self.stays), 0)
        w.put(DoubleSlot.CHECKED, f.select(stays, w.get(DoubleSlot.H), 0.0))

    def try_unchecked(self, t: Value, h: Value, steps: LoopBlock) -> None:
        """Let a step that has failed be tried once more, unchecked, or go on with a shorter one."""
        f, w = self.f, self.w
        checked, unchecked = w.get(DoubleSlot.CHECKED), self._is_unchecked()
        with f.when(~unchecked & self._is_short(t, h)):
            w.put(DoubleSlot.CHECKED, w.get(DoubleSlot.H))
            w.put(DoubleSlot.H, h)
            steps.again()
        w.put(DoubleSlot.H, f.select(unchecked, checked, w.get(DoubleSlot.H)))
        w.put(DoubleSlot.CHECKED, 0.0)

    def _stays_on_jump(self, t: Value, h: Value) -> Condition:
        """Return whether for some jump, before and after the step, |g| is less than what rounding makes of g."""
        f, w, values = self.f, self.w, Array(self.f, self.f.slot(LANES, len(self.jumps)), LANES)
        assert w.system.switching is not None
        is_old = f.compare("ogt", f.constant([float(k == LANES - 1) for k in range(LANES)]), 0.0)
        with f.strict():
            for c in w.each(w.size):
                around = f.splat(w.new[c], LANES) * self._factors(c)
                self.x[c] = f.select(is_old, f.splat(w.state[c], LANES), around)
            times = f.select(is_old, f.splat(t, LANES), f.splat(t + h, LANES))
        g = w.evaluate(w.system.switching, times, self.x)["g"]
        for place, jump in enumerate(self.jumps):
            values[place] = f.splat(g[jump], LANES)
        least = f.slot()
        f.store(1.0, least)
        with f.strict(), f.count(len(self.jumps)) as k:
            new, old = f.lane(values[k], 0), f.lane(values[k], LANES - 1)
            spread = f.select(is_old, f.constant(0.0, LANES), f.abs(values[k] - f.splat(new, LANES)))
            by_time = f.abs(new - old) * (f.abs(t) * SHORTEST / h)
            part = f.max(f.abs(old), f.abs(new)) / (f.reduce("maximum", spread) * SPREADS + by_time)
            so_far = f.load(least)
            f.store(f.select(f.compare("olt", part, so_far), part, so_far), least)
        return f.compare("olt", f.load(least), 1.0)

    def _factors(self, c: Int | int) -> Value:
        """Return by what rounding changes component c, in each lane; two of any eight do not change alike in all."""
        return self.f.load(self.f.offset(self.factors, (c & (LANES - 1)) * LANES), LANES)


def _signs() -> np.ndarray:
    """Return which way components (rows) are off in lanes, as in Hadamard's matrix; in the first lane they are not."""
    rows = [[(-1.0) ** (a & b).bit_count() for b in range(LANES)] for a in range(LANES)]
    return np.array(rows) * (np.arange(LANES) > 0)

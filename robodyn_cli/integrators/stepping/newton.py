"""Newton's rounds inside a step: when another is worth while, when the step is solved, when it has to be shorter."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from robodyn_cli.integrators.runtime.memory import DoubleSlot
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.ir import Block, LoopBlock, Value
from robodyn_cli.record import record

BEGUN = 1e300  # in place of the update before the first
FIRST = 1e200  # updates before the first are above this
UNKNOWN_RATIO = 0.5  # of the first two updates, where nothing is remembered
LEAST_RATIO = 0.01
BROKEN = 0.1  # factor of the next step where an update is not finite


@record
class NewtonLimits:
    """What ends the rounds of a step; updates are in units of the tolerance.

    rounds : how many there may be. converged : what may be left, as far as the ratio r of two updates tells: the
    last update times r / (1 - r). rounding : the update below which one that no longer shrinks is rounding.
    shorter : factor of the next step where they do not converge. remembers : whether the first ratio is taken from the
    step before (``DoubleSlot.CONTRACTION``), so that one round can be enough.
    """

    rounds: int
    converged: float
    rounding: float
    shorter: float
    remembers: bool = False


class Rounds:
    """The rounds of a method; ``done`` is the place of the number of rounds beyond the first."""

    def __init__(self, w: Writer, limits: NewtonLimits) -> None:
        self.w, self.limits = w, limits
        self.before, self.done = w.f.slot(), w.f.int_slot()

    @contextlib.contextmanager
    def repeat(self, h: Value, failed: Block) -> Iterator[Callable[[Value], None]]:
        """Emit the body as a round, at whose end what is yielded is called with the norm of the update.

        Code goes on where the step is solved; else ``failed`` is left, with a shorter step than ``h`` stored.
        """
        f = self.w.f
        f.store(BEGUN, self.before)
        f.store_int(0, self.done)
        with f.loop() as loop:
            yield lambda update: self._judge(loop, update, h, failed)

    def _judge(self, loop: LoopBlock, update: Value, h: Value, failed: Block) -> None:
        """Emit the end of a round: the step is solved, or there is another round, or it is given up."""
        w, f, limits = self.w, self.w.f, self.limits
        with f.strict():
            last = f.load(self.before)
            f.store(update, self.before)
            first = f.compare("ogt", last, FIRST)
            ratio = f.select(first, self._expected(), update / last)
            if limits.remembers:
                # the remembered ratio fades, so that steps that one round solves still end after one
                fading = f.select(first, ratio * 0.5, ratio)
                w.put(DoubleSlot.CONTRACTION, f.select(f.compare("ord", ratio, 0.0), fading, 1.0))
            left = update * ratio / f.max(1.0 - ratio, LEAST_RATIO)
            small = f.compare("olt", left, limits.converged)
            growing = f.compare("uge", ratio, 1.0) & ~first
        loop.leave(small)
        finite = f.compare("ord", update, 0.0)
        loop.again(f.compare_int("slt", f.bump(self.done), limits.rounds) & finite & ~growing)
        loop.leave(f.compare("olt", update, limits.rounding))
        w.put(DoubleSlot.H, h * f.select(finite, f.constant(limits.shorter), f.constant(BROKEN)))
        if limits.remembers:
            w.put(DoubleSlot.CONTRACTION, 1.0)
        failed.leave()

    def _expected(self) -> Value:
        """Return the ratio to reckon with before there are two updates."""
        f = self.w.f
        if not self.limits.remembers:
            return f.constant(UNKNOWN_RATIO)
        return f.max(self.w.get(DoubleSlot.CONTRACTION), LEAST_RATIO)

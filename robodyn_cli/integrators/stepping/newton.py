"""Newton's rounds inside a step: when another is worth while, when the step is solved, when it has to be shorter."""

from __future__ import annotations

from robodyn_cli.integrators.runtime.layout import DoubleSlot
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.ir import Value
from robodyn_cli.record import record

BEGUN = 1e300  # stands for the update before the first
UNKNOWN_RATIO = 0.5  # of the first two updates, where nothing is remembered
LEAST_RATIO = 0.01


@record
class Limits:
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
    """The rounds of a method: what stands between ``begin`` and ``judge`` is emitted once, and runs once a round.

    ``done`` is the place of the number of rounds beyond the first.
    """

    def __init__(self, w: Writer, limits: Limits) -> None:
        self.w, self.limits = w, limits
        self.before, self.done = w.f.slot(), w.f.int_slot()
        self.again = ""

    def begin(self) -> None:
        """Emit the start of a round."""
        f = self.w.f
        f.store(BEGUN, self.before)
        f.store_int(0, self.done)
        self.again = f.label("iterate")
        f.jump(self.again)
        f.place(self.again)

    def judge(self, update: Value, h: Value, failed: str) -> None:
        """Emit the end of a round: code goes on where the step is solved.

        Else there is another round, or a jump to ``failed`` with a shorter step than ``h`` stored.
        """
        w, f, limits = self.w, self.w.f, self.limits
        onward, solved, capped, diverged = (f.label(x) for x in ("onward", "solved", "capped", "diverged"))
        with f.strict():
            last = f.load(self.before)
            f.store(update, self.before)
            first = f.compare("ogt", last, 1e200)
            ratio = f.select(first, self._expected(), update / last)
            if limits.remembers:
                # what is remembered fades, so that steps solved in one round go on being tried in one
                fading = f.select(first, ratio * 0.5, ratio)
                w.put(DoubleSlot.CONTRACTION, f.select(f.compare("ord", ratio, 0.0), fading, 1.0))
            left = update * ratio / f.max(1.0 - ratio, LEAST_RATIO)
            small = f.compare("olt", left, limits.converged)
            growing = f.compare("uge", ratio, 1.0) & ~first
        f.branch(small, solved, onward)
        f.place(onward)
        finite = f.compare("ord", update, 0.0)
        more = f.compare_int("slt", f.bump(self.done), limits.rounds) & finite & ~growing
        f.branch(more, self.again, capped)
        f.place(capped)
        f.branch(f.compare("olt", update, limits.rounding), solved, diverged)
        f.place(diverged)
        w.put(DoubleSlot.H, h * f.select(finite, f.constant(limits.shorter), f.constant(0.1)))
        if limits.remembers:
            w.put(DoubleSlot.CONTRACTION, 1.0)
        f.jump(failed)
        f.place(solved)

    def _expected(self) -> Value:
        """Return the ratio to reckon with before there are two updates."""
        f = self.w.f
        if not self.limits.remembers:
            return f.constant(UNKNOWN_RATIO)
        return f.max(self.w.get(DoubleSlot.CONTRACTION), LEAST_RATIO)

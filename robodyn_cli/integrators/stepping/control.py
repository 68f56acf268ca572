"""Step control: whether an attempted step counts, and how long the next one is to be.

Methods supply the error of a step and its order; everything else is here. Errors are mean squares
in units of the tolerance, (1/n) sum (e_i / (atol + rtol |x_i|))^2; logarithms are of their roots, and rough ones do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from robodyn_cli.integrators.runtime.memory import DoubleSlot
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Total
from robodyn_cli.kernels.ir import Int, Value
from robodyn_cli.kernels.mathematics import rough_exp2, rough_log2
from robodyn_cli.record import mutable_record, record

ROUNDING = 1e-15  # part of a state below which an error means nothing
LEAST_LAST = 1e-4  # a smaller last error counts as this
TINY = 1e-8  # below this error the step is far too short
# limits of the factor after a rejected step, and the factor where the error is not finite
LEAST_RETRY, MOST_RETRY, BROKEN = 0.1, 0.9, 0.1


Kept = TypeVar("Kept")


@mutable_record
class StepAttempt(Generic[Kept]):
    """Outcome of an attempted step.

    square : mean square of the error in units of the tolerance; None where none is estimated, so that every finite
    state counts. With a fixed step, 0 where the step is solved and more than 1 where not.
    kept : what dense output needs of the step.
    limit, scale : a bound of the factor by which the next step changes, and one more factor in it, which the method's
    own iteration asks for. factor : all of that factor, from a method that chooses it together with its order.
    """

    square: Value | None
    kept: Kept
    limit: Value | None = None
    scale: Value | None = None
    factor: Value | None = None


@record
class StepController:
    """The factor F of the next step from the error e of this one, which falls as h^p.

        F = safety e^(-1/p)
        F = safety e^(-(1 - 0.75 g) / p) e_last^(g / p)                   with ``gain`` g (Hairer, Wanner 1996, IV.2)
        F <= trend_safety (h / h_last) (e_last / e^2)^(1/p)               with ``trend`` (Gustafsson 1994)

    order : p. floor : the least error that counts. least, most : limits of F. most_if_tiny : in place of ``most`` where
    the error is next to nothing. accept : the error up to which a step is accepted. held : whether a step may not grow
    after a rejection.
    """

    order: float
    safety: float
    floor: float
    least: float
    most: float
    most_if_tiny: float | None = None
    accept: float = 1.0
    held: bool = True
    gain: float = 0.0
    trend_safety: float | None = None

    def log_error(self, w: Writer, square: Value) -> Value:
        """Return log2 of the error, from its mean square."""
        return w.f.max(rough_log2(w.f, square) * 0.5, math.log2(self.floor))

    def log_factor(self, log_error: Value, order: Value | float) -> Value:
        """Return log2 of safety e^(-1/p)."""
        return log_error * (-1.0 / order) + math.log2(self.safety)

    def factor(self, w: Writer, h: Value, attempt: StepAttempt[Any], size: Value) -> Value:
        """Return the factor of the next step after one of length h with this log2 of its error."""
        f = w.f
        last = w.get(DoubleSlot.LAST_ERROR)
        first = f.compare("oeq", last, 1.0)
        log = self.log_factor(size, self.order / (1.0 - 0.75 * self.gain))
        if self.gain:
            log = log + f.select(first, 0.0, last) * (self.gain / self.order)
        if self.trend_safety is not None:
            # towards a pole steps shrink in proportion
            trend = (last - size * 2.0) * (1.0 / self.order) + rough_log2(f, h / w.get(DoubleSlot.H_OLD))
            if self.trend_safety != 1.0:
                trend = trend + math.log2(self.trend_safety)
            log = f.select(first, log, f.min(log, trend))
        factor = rough_exp2(f, log)
        if attempt.scale is not None:
            factor = factor * attempt.scale
        if attempt.limit is not None:
            factor = f.min(factor, attempt.limit)
        return f.min(f.max(factor, self.least), self._most(w, attempt.square))

    def _most(self, w: Writer, square: Value | None) -> Value:
        f = w.f
        most = f.constant(self.most)
        if self.most_if_tiny is not None and square is not None:
            most = f.select(f.compare("olt", square, TINY**2), self.most_if_tiny, most)
        return f.select(w.rejected_before(), 1.0, most) if self.held else most


FIXED = StepController(
    1.0, 1.0, 1.0, 1.0, 1.0
)  # every step that is solved counts, and the next one is as long


@mutable_record
class StepVerdict:
    """The verdict on an attempted step.

    square : of the error over what is accepted; the step counts where it is below 1. factor : of the next step.
    log_error : for the control of the next step; none with a fixed step.
    """

    square: Value
    factor: Value
    log_error: Value | None


def judge(
    w: Writer, adaptive: bool, control: StepController, h: Value, attempt: StepAttempt[Any]
) -> StepVerdict:
    """Emit the judgement of a step of length h."""
    f = w.f
    square = attempt.square
    with f.strict():
        if square is None:
            finite = w.is_finite(w.new)
            square = f.select(finite, f.constant(0.0), float("nan"))
        if not adaptive:
            return StepVerdict(square, f.constant(1.0), None)
        size = control.log_error(w, square)
        factor = attempt.factor if attempt.factor is not None else control.factor(w, h, attempt, size)
        kept = f.max(size, math.log2(LEAST_LAST))
        return StepVerdict(square * (1.0 / control.accept**2), factor, kept)


def remember(w: Writer, verdict: StepVerdict) -> None:
    """Keep the error of an accepted step for the control of the next one."""
    if verdict.log_error is not None:
        w.put(DoubleSlot.LAST_ERROR, verdict.log_error)


def shorter(w: Writer, verdict: StepVerdict, h: Value) -> Value:
    """Return the length with which a rejected step of length h is tried again."""
    f = w.f
    broken = f.compare("uno", verdict.square, 0.0)
    bounded = f.min(f.max(verdict.factor, LEAST_RETRY), MOST_RETRY)
    return h * f.select(broken, f.constant(BROKEN), bounded)


# -- errors in units of the tolerance -----------------------------------------------------------------------
def tolerance(w: Writer, c: Int | int, size: Value) -> Value:
    """Return the error that is allowed in component c, of this size: atol + rtol size, and not below rounding."""
    f = w.f
    allowed = f.muladd(size, w.get(DoubleSlot.RTOL), w.get(DoubleSlot.ATOL))
    if w.rounded is not None:
        allowed = f.max(allowed, w.rounded[c])
    return f.max(allowed, f.muladd(size, ROUNDING, 1e-300))


def mean_squares(
    w: Writer,
    count: int,
    errors: Callable[[Int | int], Sequence[Value]],
    rounded: Sequence[Value | float] | None = None,
) -> list[Value]:
    """Return the mean squares of ``count`` errors of a step in units of the tolerance.

    errors : those of a component. rounded : how many times what rounding makes of the state in the step, where that is
    known, it makes of each: that is no error.
    """
    f = w.f
    with f.strict():
        totals = [Total(f, w.width) for _ in range(count)]
        for c in w.each(w.size):
            scale = 1.0 / tolerance(w, c, f.max(f.abs(w.state[c]), f.abs(w.new[c])))
            for k, (total, error) in enumerate(zip(totals, errors(c))):
                if rounded is None or w.rounded is None:
                    e = error * scale
                    total.add_product(e, e)
                else:
                    off = w.rounded[c] * rounded[k]
                    total.add_product(f.max(error * error - off * off, 0.0), scale * scale)
        updates = w.system.updates  # what is constant in between has no error
        share = 1.0 / w.number(w.size if updates is None else w.size - updates.count)
        return [total.value * share for total in totals]

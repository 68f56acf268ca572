"""Errors of motions from a second, more accurate integration: when it is made, how the two differ, and what rounding is
expected to leave.

The rules are those of one run and of many: arrays have a leading axis of runs, which is of length 1 for a run alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from typing_extensions import Self

    from robodyn_cli.motion.conditioning import Conditioning

MORE_STEPS = 1.9  # times the steps of the first run: both together take less than three times its time
MOST_STEPS = 4  # times the steps of the first run, at which the second is given up
TIGHTER = 200.0  # times, at most: a tolerance so much tighter is enough even where it takes fewer steps
TIGHTEST_RTOL = 2e-14  # not below what double precision can resolve
FINEST_RTOL = 1e-12  # below it, methods of high order are at rounding, where a tighter tolerance says nothing
FINER = 0.45  # times a fixed step: where implicit methods halve theirs, the second run must not take the same steps
DECIDES = 0.5  # of the growth of the steps, as a power: below it something else than the tolerance decides about them
SHORTER = 0.6  # times the mean step of the first run, where a tighter tolerance says nothing
FIRST_STEPS = 0.4  # times the first steps, at the start and behind events: else both runs share their errors
ONCE_TIGHTER, ONCE_FINER = 4.0, 1.5  # times the tolerance and the steps of second integrations, of third ones
STEEP_TIGHTER = (
    20.0  # the same on steep slopes, where a tolerance little tighter leaves many steps as they are
)
HIGH_ORDER = 7
TRUSTED = (
    0.01  # of the time of a lock: where two integrations put it farther apart, it is not that of one event
)

Integers = NDArray[np.int64]
Masks = NDArray[np.bool_]


@record
class First:
    """First integrations by one method: their steps (N,), and the time that each went (N,) [s]."""

    options: Options
    method: str
    steps: Integers
    went: Array

    @property
    def tighter(self) -> float:
        """By how much the tolerance of second integrations is tighter, if at all."""
        kind = methods[self.method]
        factor = min(TIGHTER, MORE_STEPS ** (kind.order / kind.proportion))
        return min(factor, self.options.rtol / TIGHTEST_RTOL) if kind.order >= HIGH_ORDER else factor

    @property
    def finest(self) -> bool:
        """Whether a tolerance is at the limit of double precision: a tighter one says nothing, and rounding decides."""
        kind, options = methods[self.method], self.options
        if options.step is not None or not kind.adaptive:
            return False
        if kind.order >= HIGH_ORDER:
            return options.rtol < FINEST_RTOL
        return options.rtol / self.tighter < TIGHTEST_RTOL

    def once_more(self, steep: bool = False) -> Self:
        """The same for third integrations: they differ as second ones do, from these by their tolerance, where that
        says more than rounding, or their step, and by the draw of rounding."""
        own = self.options
        if own.step is not None:
            own = dataclasses.replace(own, step=own.step / ONCE_FINER)
        elif own.rtol >= (tighter := STEEP_TIGHTER if steep else ONCE_TIGHTER) * FINEST_RTOL:
            own = dataclasses.replace(own, rtol=own.rtol / tighter, atol=own.atol / tighter)
        return dataclasses.replace(self, options=dataclasses.replace(own, draw=1))


@record
class Attempt:
    """Second integrations of the runs of these numbers.

    options : of all. step : fixed or longest steps (n,) [s], None: as in the options. most : numbers of steps (n,).
    how : what differs from the first, in words.
    """

    rows: Integers
    options: Options
    step: Array | None
    most: Integers
    how: str

    @property
    def alone(self) -> Options:
        """The options of the only run."""
        most, step = int(self.most[0]), self.options.max_step if self.step is None else float(self.step[0])
        if self.options.step is None:
            return dataclasses.replace(self.options, max_steps=most, max_step=step)
        return dataclasses.replace(self.options, max_steps=most, step=step)


Once = Callable[[Attempt], tuple[Any, Masks]]


def integrate_again(first: First, once: Once) -> None:
    """Make second integrations, with a tighter tolerance, or with other steps where that says nothing.

    With fewer steps than half of the growth (as a power) that the tolerance alone would give, (rtol_1 / rtol_2)^(1/p),
    the tolerance does not decide about them, so that many of the same ones were taken once more.

    Parameters
    ----------
    once : makes an attempt; returns the steps of its runs (n,), and which of them were given up for their number.
    """
    attempt = first_attempt(first)
    steps, given_up = once(attempt)
    if attempt.step is not None:
        return
    kind, tight = methods[first.method], attempt.options
    growth = (first.options.rtol / tight.rtol) ** (DECIDES * kind.proportion / kind.order)
    few = ~given_up & (steps < growth * first.steps)
    # what is given up has a tolerance that the method cannot keep
    for rows, options in ((np.flatnonzero(few), tight), (np.flatnonzero(given_up), first.options)):
        if len(rows):
            once(_other_steps(first, rows, options))


def first_attempt(first: First) -> Attempt:
    """Return the first attempt at all runs.

    A local error falls as h to the power p of the error estimate, so MORE_STEPS times the steps take a tolerance
    MORE_STEPS^p times tighter.
    """
    options, rows, kind = first.options, np.arange(len(first.steps)), methods[first.method]
    if options.step is not None or not kind.adaptive or first.finest:
        # at the limit of double precision a tighter tolerance says nothing; other steps show the rounding errors
        return _other_steps(first, rows, options)
    factor = first.tighter
    rtol = options.rtol / factor
    tight = dataclasses.replace(
        options, rtol=rtol, atol=options.atol / factor, first=FIRST_STEPS, draw=options.draw + 1
    )
    return Attempt(rows, tight, None, _most(first, rows), f"rtol {rtol:.1g}")


def _other_steps(first: First, rows: Integers, options: Options) -> Attempt:
    """Return the attempt at some runs with shorter steps."""
    mean = (first.went / np.maximum(first.steps, 1))[rows]
    if options.step is None:
        part, step = SHORTER, np.minimum(options.max_step, SHORTER * mean)
    else:  # a step that is longer than a run is as long as the run
        part, step = FINER, FINER * np.where(options.step < 2.0 * mean, options.step, mean)
    draw = first.options.draw + 1
    other, how = dataclasses.replace(options, first=FIRST_STEPS, draw=draw), f"steps {part:g} times as long"
    return Attempt(rows, other, step, _most(first, rows), how)


def _most(first: First, rows: Integers) -> Integers:
    """Return the numbers of steps at which second integrations of some runs are given up."""
    most: Integers = np.minimum(4 * first.options.max_steps, MOST_STEPS * first.steps[rows] + 1000)
    return most


ConditioningOf = Callable[[int], "Conditioning"]

NEAR_ROUNDING = 1e3  # times the rounding of the state: below it what rounds the accelerations is looked at
HALF_UNIT = 1.1e-16
MARGIN = 1.25  # of an estimate: errors follow the order of a method to within some such part
MOST_LEFT = 0.5  # of the first run's errors, that the second run's own count for at most
LEAST_OWN = 0.02  # of the first run's errors, that the second run's are at least
AMPLIFIED = 30.0  # times rounding: differences so large
FEWEST = 8  # samples from which on that is told
GROWN = 10.0  # times those of the first half, of differences in the second
EARLY = 100.0  # times rounding, at most: differences at first
EARLIEST = 4  # of so many parts of the samples, the first
UNLIKE = 0.1  # of the differences, by which those of second and third integrations from the first may differ
BY_CHANCE = 0.1  # of the differences before, below which those at the end say little
BEFORE = slice(-4, -2)  # of the samples, the last of which may be of the end
AT_ROUNDING = 100.0  # times rounding, up to which an error counts as one of rounding
TIME_ROUNDING = 1e-14  # part of the time of an event that rounding leaves over the steps of a run


def remainder(first: First, more: Any) -> Array:
    """Return MARGIN / (1 - (n_1 / n_2)^p), the power at most 0.5 (N,): what the second run's own error hides of the
    first one's.

    At the limit of double precision both errors are those of rounding: no order makes the second's smaller.

    more : n_2, the steps of the second runs (N,).
    """
    kind = methods[first.method]
    # between steps the dense output decides
    power = 0 if first.finest else min(kind.order, kind.dense_order + 1)
    left = np.minimum(1.0, first.steps / np.maximum(more, 1)) ** power
    factor: Array = MARGIN / (1.0 - np.minimum(left, MOST_LEFT))
    return factor


def difference(first: Array, second: Array, sampled_end: bool) -> Array:
    """Return by how much two courses (N, T, nx), of samples and of states at the end, are apart.

    sampled_end : whether the last sample is of the end, too. A sample comes from the dense output of a step, whose end
    is then corrected; the error at the end counts for both.
    """
    apart: Array = np.abs(second - first)
    if sampled_end and apart.shape[1] > 1:
        apart[:, -1] = np.maximum(apart[:, -1], apart[:, -2])
    return apart


@record
class Courses:
    """States ``first`` (N, T, nx) of first integrations at the start, the samples that are judged, and the end; how far
    the others are ``apart`` from them (N, T, nx); their ``scale`` (N,), see ``remainder``; and whether second
    integrations err as much as first ones (N,), None: as their order says."""

    system: System
    first: Array
    apart: Array
    scale: Array
    erratic: Masks | None = None

    @property
    def errors(self) -> Array:
        """Estimated errors of the first (N, T, nx)."""
        errors: Array = self.scale[:, None, None] * self.apart
        return errors

    def beside(self, apart: Array, made: Any, steep: bool = False) -> Courses:
        """Return the courses with the larger one of these and the differences of third integrations from the first.

        made : of which runs (N,) there are third ones. These and the second ones are both far more accurate than the
        first: where they do not tell the same error, theirs are as large; on ``steep`` slopes, of which each step has
        its luck, as large as they are apart.
        """
        if steep:
            own = np.abs(apart - self.apart) * np.reshape(made, (-1, 1, 1))
            return dataclasses.replace(self, apart=np.maximum(self.apart, apart) + own)
        places = [*self.system.q_places, *self.system.v_places]
        half = self.apart.shape[1] // 2
        second, third = (x[:, half:, places] for x in (self.apart, apart))
        unlike, size = (median(x.max(axis=2, initial=0.0)) for x in (np.abs(third - second), second))
        joined = dataclasses.replace(self, apart=np.maximum(self.apart, apart))
        return joined._with_erratic(made & (unlike > UNLIKE * size))

    def settled(self, floor: Floor, steep: bool = False) -> tuple[Courses, Masks]:
        """Return the courses with the second runs' errors as large as the first's where the motion amplifies rounding,
        since no order makes them smaller there; and which runs (N,) are in doubt.

        In these both integrations may have come to the same error by chance, at the end or as they amplify rounding: a
        third one, of another tolerance and with other roundings, tells. So they may in all that go through ``steep``
        slopes, where single steps decide, and a tighter tolerance says little about their errors.
        """
        if self.first.shape[1] < FEWEST:
            return self, np.zeros(len(self.first), dtype=bool)
        amplify = self._amplify(floor)
        doubt = amplify | self._agree_at_end(floor)
        return self._with_erratic(amplify), np.ones_like(doubt) if steep else doubt

    def _with_erratic(self, erratic: Masks) -> Courses:
        """Return the courses with second integrations that err as much as the first in some runs (N,)."""
        if not erratic.any():
            return self
        scale = np.where(erratic, np.maximum(self.scale, MARGIN / (1.0 - MOST_LEFT)), self.scale)
        known = erratic if self.erratic is None else self.erratic | erratic
        return dataclasses.replace(self, scale=scale, erratic=known)

    def _agree_at_end(self, floor: Floor) -> Masks:
        """Tell in which runs (N,) the ends agree far better than what comes before, which is more than rounding."""
        agree = np.zeros(len(self.first), dtype=bool)
        for places, least in ((self.system.q_places, floor.q), (self.system.v_places, floor.qd)):
            largest = self.errors[:, :, list(places)].max(axis=2, initial=0.0)
            typical = median(largest[:, largest.shape[1] // 2 :])
            before = np.minimum(typical, largest[:, BEFORE].min(axis=1))
            agree |= (largest[:, -1] < BY_CHANCE * before) & (before > AT_ROUNDING * least)
        return agree

    def _amplify(self, floor: Floor) -> Masks:
        """Tell in which runs (N,) the motion seems to amplify rounding: differences near it grow far beyond it."""
        places = [*self.system.q_places, *self.system.v_places]
        largest = self.errors[:, :, places].max(axis=2, initial=0.0)
        count = largest.shape[1]
        early = median(largest[:, 1 : 1 + count // EARLIEST])
        late, rounding = largest[:, count // 2 :].max(axis=1), np.maximum(floor.q, floor.qd)
        grown: Masks = (late > AMPLIFIED * rounding) & (late > GROWN * early) & (early < EARLY * rounding)
        return grown

    def at_end(self, floor: Floor) -> Array:
        """Return the errors at the end (N, nx), no less than the floor.

        There the errors of both may agree by chance. So they are no less than what the second run's own error typically
        is over the second half of the samples: a part 1 - MARGIN/scale of the first one's (see ``remainder``), or as
        much as the first one's where both are at rounding; and no less than the largest there where they are erratic.
        """
        errors = self.errors
        last: Array = errors[:, -1].copy()
        at_rounding = errors.max(axis=(1, 2), initial=0.0) <= AT_ROUNDING * np.maximum(floor.q, floor.qd)
        own = np.where(at_rounding, 1.0, np.maximum(LEAST_OWN, 1.0 - MARGIN / self.scale))
        for places, least in ((self.system.q_places, floor.q), (self.system.v_places, floor.qd)):
            largest = errors[:, errors.shape[1] // 2 :, list(places)].max(axis=2, initial=0.0)
            typical = own * median(largest)
            if self.erratic is not None:
                typical = np.where(self.erratic, largest.max(axis=1, initial=0.0), typical)
            last[:, list(places)] = np.maximum(last[:, list(places)], np.maximum(typical, least)[:, None])
        return last

    def floor(
        self,
        steps: Any,
        lasted: Any,
        conditioning: Callable[[Masks], Conditioning],
        rounded: Any = 0.0,
        watched: float = 0.0,
    ) -> Floor:
        """Return what rounding is expected to leave.

        Parameters
        ----------
        steps : of the first integrations (N,), which lasted so long (N,) [s]. conditioning : that of the runs (N,)
            which it counts for. rounded : what rounding has made of rates on the way (N,), where that is
            measured. watched : what others say that rounding leaves.
        """
        largest, part = (
            np.abs(self.first).max(axis=1, initial=0.0),
            HALF_UNIT * np.sqrt(np.maximum(1.0, steps)),
        )
        both = list(self.system.q_places), list(self.system.v_places)
        q, qd = (np.maximum(part * largest[:, places].max(axis=1, initial=0.0), watched) for places in both)
        errors = self.errors[:, :, [*both[0], *both[1]]].max(axis=(1, 2), initial=0.0)
        near = errors <= NEAR_ROUNDING * np.maximum(q, qd)
        if near.any():
            off_q, off_qd = conditioning(near).leaves(lasted)
            q, qd = (np.where(near, np.maximum(x, off), x) for x, off in ((q, off_q), (qd, off_qd)))
        return Floor(np.maximum(q, rounded), np.maximum(qd, rounded))


@record
class Floor:
    """Errors that rounding alone is expected to leave, of positions and of rates (N,).

    The state's own rounding grows as sqrt(steps). Where errors are not far above that, what constants and the
    conditioning of the equations do counts too (see ``Conditioning``). Both runs share some of it, so that their
    difference hides it.
    """

    q: Array
    qd: Array


def median(x: Array) -> Array:
    """Return the medians (N,) of rows (N, n); that of numpy loads masked arrays, for as long as a short run takes."""
    ordered, count = np.sort(x, axis=1), x.shape[1]
    middle: Array = 0.5 * (ordered[:, (count - 1) // 2] + ordered[:, count // 2])
    # what is not a number stands last
    return np.where(np.isnan(ordered[:, -1]), np.nan, middle)


def time_errors(first: First, apart: Any, more: Any, times: Any) -> Array:
    """Return the errors of the times (N,) [s] of events, which second runs with so many steps put ``apart``.

    An agreement below what rounding leaves over the steps of a run says nothing.
    """
    errors: Array = np.maximum(remainder(first, more) * apart, TIME_ROUNDING * times)
    return errors

"""Second integrations that are more accurate than the first: how they differ, and when another one is made.

The rules are those of one run and of many: steps and times are arrays with an entry for each run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

MORE_STEPS = 1.9  # times the steps of the first run: both together take less than three times its time
MOST_STEPS = 4  # times the steps of the first run, at which the second is given up
TIGHTER = 200.0  # times, at most: a tolerance so much tighter is enough even where it takes fewer steps
TIGHTEST_RTOL = 2e-14  # not below what double precision can resolve
FINEST_RTOL = 1e-12  # below it, methods of high order are at rounding, where a tighter tolerance says nothing
FINER = 0.45  # times a fixed step: where implicit methods halve theirs, the second run must not take the same steps
DECIDES = 0.5  # of the growth of the steps, as a power: below it something else than the tolerance decides about them
SHORTER = 0.6  # times the mean step of the first run, where a tighter tolerance says nothing
FIRST_STEPS = 0.4  # times the first steps, at the start and behind events: else both runs share their errors
HIGH_ORDER = 7

Integers = NDArray[np.int64]
Masks = NDArray[np.bool_]


@record
class First:
    """First integrations by one method: their steps (N,), and the time that each went (N,) [s]."""

    options: Options
    method: str
    steps: Integers
    went: Array


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
    factor = min(TIGHTER, MORE_STEPS ** (kind.order / kind.proportion))
    if kind.order >= HIGH_ORDER:
        factor = min(factor, options.rtol / TIGHTEST_RTOL)
    rtol = options.rtol / factor
    fine = options.rtol >= FINEST_RTOL if kind.order >= HIGH_ORDER else rtol >= TIGHTEST_RTOL
    if options.step is not None or not (kind.adaptive and fine):
        # at the limit of double precision a tighter tolerance says nothing; other steps show the rounding errors
        return _other_steps(first, rows, options)
    tight = dataclasses.replace(options, rtol=rtol, atol=options.atol / factor, first=FIRST_STEPS)
    return Attempt(rows, tight, None, _most(first, rows), f"rtol {rtol:.1g}")


def _other_steps(first: First, rows: Integers, options: Options) -> Attempt:
    """Return the attempt at some runs with shorter steps."""
    mean = (first.went / np.maximum(first.steps, 1))[rows]
    if options.step is None:
        part, step = SHORTER, np.minimum(options.max_step, SHORTER * mean)
    else:  # a step that is longer than a run is as long as the run
        part, step = FINER, FINER * np.where(options.step < 2.0 * mean, options.step, mean)
    other, how = dataclasses.replace(options, first=FIRST_STEPS), f"steps {part:g} times as long"
    return Attempt(rows, other, step, _most(first, rows), how)


def _most(first: First, rows: Integers) -> Integers:
    """Return the numbers of steps at which second integrations of some runs are given up."""
    found: Integers = np.minimum(4 * first.options.max_steps, MOST_STEPS * first.steps[rows] + 1000)
    return found

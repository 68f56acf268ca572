"""How outputs spread over the runs of a study, found block by block in a memory that does not grow with their number.

Mean, deviation and extremes come from one pass. Quantiles of more than ``MOST`` runs take a second one: those of a
sample tell between which values a quantile lies, values below are counted, and those between are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.study import LEVELS, QUANTILES, Spread

MOST = 1 << 15  # runs that are held in memory at once
WIDTH = 6.0  # standard errors on both sides of a sample's quantile, where that of all is looked for
Blocks = Callable[[], Iterator[Array]]


class Moments:
    """Number, mean, variance and extremes of an output over the runs that have it.

    Source of the joined variance: Chan, Golub, LeVeque, Updating formulae and a pairwise algorithm for computing sample
    variances, Stanford STAN-CS-79-773 (1979).
    """

    def __init__(self) -> None:
        self.runs, self.mean, self._squares = 0, 0.0, 0.0
        self.least, self.greatest = math.inf, -math.inf
        self.least_run = self.greatest_run = -1
        self.largest_error = -math.inf

    def add(self, first: int, values: Array, errors: Array) -> None:
        """Take values and their errors of runs from ``first`` on into account, nan where there are none."""
        known = errors[np.isfinite(errors)]
        self.largest_error = max(self.largest_error, float(known.max(initial=-math.inf)))
        there = np.isfinite(values)
        found = values[there]
        if not found.size:
            return
        runs, mean = self.runs + found.size, float(found.mean())
        away = mean - self.mean
        self._squares += float(((found - mean) ** 2).sum()) + away**2 * self.runs * found.size / runs
        self.mean += away * found.size / runs
        self.runs = runs
        self._extremes(first, np.where(there, values, math.nan))

    def _extremes(self, first: int, values: Array) -> None:
        low, high = int(np.nanargmin(values)), int(np.nanargmax(values))
        if values[low] < self.least:
            self.least, self.least_run = float(values[low]), first + low
        if values[high] > self.greatest:
            self.greatest, self.greatest_run = float(values[high]), first + high

    def spread(self, nominal: float, unit: str, quantiles: Array | None) -> Spread | None:
        """Return the spread, None where no run has the output; quantiles : at ``LEVELS``, of samples alone."""
        if not self.runs:
            return None
        ends = self.least, self.greatest, nominal if math.isfinite(nominal) else None, unit
        largest_error = self.largest_error if math.isfinite(self.largest_error) else ABSENT
        if quantiles is None:
            return Spread(self.runs, *ends, largest_error=largest_error)
        sd = math.sqrt(self._squares / (self.runs - 1)) if self.runs > 1 else 0.0
        return Spread(
            self.runs,
            *ends,
            mean=self.mean,
            sd=sd,
            quantiles=dict(zip(QUANTILES, quantiles.tolist())),
            mean_error=sd / math.sqrt(self.runs),
            largest_error=largest_error,
        )


def quantiles(blocks: Blocks, runs: int, sample: Array, levels: Sequence[float] = LEVELS) -> Array:
    """Return quantiles as ``np.quantile`` has them, of the finite ones of all values.

    Parameters
    ----------
    blocks : gives all values, block by block. runs : number of finite ones. sample : some of them, or all.
    """
    there = np.sort(sample[np.isfinite(sample)])
    if len(there) == runs:
        return np.quantile(there, levels)
    return np.array([_quantile(blocks, runs, there, level) for level in levels])


def _quantile(blocks: Blocks, runs: int, sample: Array, level: float) -> float:
    """Return a quantile of many values from a bracket that the sorted sample gives; a wider one where it is missed."""
    place = level * (runs - 1)
    half = WIDTH * math.sqrt(level * (1.0 - level) / max(len(sample), 1))
    while True:
        low = _of_sorted(sample, level - half, -math.inf)
        high = _of_sorted(sample, level + half, math.inf)
        below, at_low, at_high, inside = 0, 0, 0, [np.empty(0)]
        for block in blocks():
            values = block[np.isfinite(block)]
            below += int(np.count_nonzero(values < low))
            at_low += int(np.count_nonzero(values == low))
            at_high += int(np.count_nonzero(values == high)) if high > low else 0
            inside.append(values[(values > low) & (values < high)])
        between = np.sort(np.concatenate(inside))
        # the values at the ends may be many, and are counted
        first, last = math.floor(place) - below, math.ceil(place) - below
        if first >= 0 and last < at_low + len(between) + at_high:
            a, b = (
                low if k < at_low else high if k >= at_low + len(between) else float(between[k - at_low])
                for k in (first, last)
            )
            return a + (place - math.floor(place)) * (b - a)
        half *= 4.0


def _of_sorted(sample: Array, level: float, beyond: float) -> float:
    """Return the value at a level of a sorted sample, ``beyond`` outside."""
    k = math.floor(level * len(sample))
    return float(sample[k]) if 0 <= k < len(sample) else beyond

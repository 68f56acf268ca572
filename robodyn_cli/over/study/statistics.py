"""What samples say together: mean, deviation, quantiles, shares, influences, Sobol's indices, each with its error.

Mean, deviation and extremes come from one pass. Quantiles of more than ``MOST`` runs take a second one: those of a
sample tell between which values a quantile lies, values below are counted, and those between are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.study import LEVELS, QUANTILES, Influence, Share, SobolIndex, Spread

WIDTH = 6.0  # standard errors on both sides of a sample's quantile, where that of all is looked for
Blocks = Callable[..., Iterator[Array]]


class Moments:
    """Number, mean, variance and extremes of an output over the runs that have it.

    Source of the joined variance: Chan, Golub, LeVeque, Updating formulae and a pairwise algorithm for computing sample
    variances, Stanford STAN-CS-79-773 (1979).
    """

    def __init__(self) -> None:
        self.runs, self.mean, self._squares = 0, 0.0, 0.0
        self.least, self.greatest = math.inf, -math.inf
        self.least_run = self.greatest_run = -1
        self.counted = 0  # runs of which mean and variance are
        self.largest_error = -math.inf
        self._stating, self._stated = 0, 0.0  # how many of them state an error, and the sum of these

    def add(self, first: int, values: Array, errors: Array, counted: int | None = None) -> None:
        """Take values and their errors of runs from ``first`` on into account, nan where there are none.

        counted : how many of them, the first ones, take part in mean and variance; by default all.
        """
        known = errors[np.isfinite(errors)]
        self.largest_error = max(self.largest_error, float(known.max(initial=-math.inf)))
        there = np.isfinite(values)
        if there.any():
            self.runs += int(np.count_nonzero(there))
            self._extremes(first, np.where(there, values, math.nan))
        own = errors[:counted]
        self._stating += int(np.count_nonzero(np.isfinite(own)))
        self._stated += float(own[np.isfinite(own)].sum())
        finite = values[:counted][there[:counted]]
        if not finite.size:
            return
        runs, mean = self.counted + finite.size, float(finite.mean())
        away = mean - self.mean
        self._squares += float(((finite - mean) ** 2).sum()) + away**2 * self.counted * finite.size / runs
        self.mean += away * finite.size / runs
        self.counted = runs

    def _extremes(self, first: int, values: Array) -> None:
        low, high = int(np.nanargmin(values)), int(np.nanargmax(values))
        if values[low] < self.least:
            self.least, self.least_run = float(values[low]), first + low
        if values[high] > self.greatest:
            self.greatest, self.greatest_run = float(values[high]), first + high

    def spread(
        self, nominal: float, unit: str, sampled: SampleSpread | None, quantiles: Quantiles | None = None
    ) -> Spread | None:
        """Return the spread, None where no run has the output.

        sampled : of samples, how they spread. quantiles : gives those at some levels.
        """
        if not self.runs:
            return None
        ends = self.least, self.greatest, nominal if math.isfinite(nominal) else None, unit
        largest_error = self.largest_error if math.isfinite(self.largest_error) else ABSENT
        if sampled is None or quantiles is None or not self.counted:
            return Spread(self.runs, *ends, largest_error=largest_error)
        sd = math.sqrt(self._squares / (self.counted - 1)) if self.counted > 1 else 0.0
        n, off = sampled.independent, self.largest_error if math.isfinite(self.largest_error) else 0.0
        own = self._stated / self._stating if self._stating else 0.0
        values, errors = sampled.quantiles(quantiles, self.counted)
        spoiled = [None if math.isnan(x) else x + off for x in errors.tolist()]
        return Spread(
            self.runs,
            *ends,
            independent=n,
            mean=self.mean,
            sd=sd,
            quantiles=dict(zip(QUANTILES, values.tolist())),
            mean_error=sampled.mean_error(sd) + own if n > 1 else None,
            sd_error=sampled.deviation_error(sd) + off if n > MOMENTS else None,
            quantile_errors=dict(zip(QUANTILES, spoiled)),
            confidence=CONFIDENCE,
            largest_error=largest_error,
        )


CONFIDENCE = 0.95  # of all intervals
TAIL = (1.0 - CONFIDENCE) / 2.0
MOST_PART = 50.0  # of a logarithm
FEW = 10.0  # samples of squares and products, which do not show the tails that they are drawn from
MOMENTS = 3  # runs from which a fourth moment says something
Quantiles = Callable[[Sequence[float]], Array]


def _skewness(values: Array) -> float:
    away = values - values.mean()
    sd = math.sqrt(float((away**2).mean()))
    return float((away**3).mean()) / sd**3 if sd else 0.0


def reach(n: int, skewness: float) -> float:
    """Return how many standard errors the mean of n independent values of some skewness may be off.

    Student's, and what skewness adds on its far side. Source: Johnson, Modified t tests and confidence intervals for
    asymmetrical populations, J. Am. Stat. Assoc. 73 (1978), with Hall, Ann. Stat. 20 (1992), for the whole term.
    """
    from scipy.special import stdtrit

    t = float(stdtrit(n - 1, 1.0 - TAIL))
    return t + abs(skewness) * (1.0 + 2.0 * t**2) / (6.0 * math.sqrt(n))


@record
class SampleSpread:
    """How an output spreads over samples, of which so many are independent: its skewness; standard deviation and
    skewness of its squared distances from the mean, over the variance."""

    independent: int
    skewness: float
    square_sd: float
    square_skewness: float

    @staticmethod
    def of(values: Array, independent: int) -> SampleSpread:
        """Return it from some of the values."""
        there = values[np.isfinite(values)]
        away = there - there.mean() if len(there) else np.zeros(1)
        squares = away**2 / (float((away**2).mean()) or 1.0)
        return SampleSpread(independent, _skewness(away), float(squares.std()), _skewness(squares))

    def mean_error(self, sd: float) -> float:
        """Return how far a mean may be off."""
        return reach(self.independent, self.skewness) * sd / math.sqrt(self.independent)

    def deviation_error(self, sd: float) -> float:
        """Return how far a standard deviation may be off: its square is the mean of squared distances.

        A few values do not show the tails that they are drawn from: they count as those of a normal distribution at
        least.
        """
        n = self.independent
        part = reach(n, self.square_skewness) * max(self.square_sd, math.sqrt(2.0)) / math.sqrt(n)
        return sd * math.expm1(min(0.5 * part, MOST_PART))

    def quantiles(self, of: Quantiles, runs: int) -> tuple[Array, Array]:
        """Return the quantiles at ``LEVELS`` of so many runs, and their errors, nan where runs are too few.

        The number of values below a quantile is binomial, so the values between which it lies are known whatever the
        distribution. Source: David, Nagaraja, Order Statistics, 3rd ed. (2003), sec. 7.1.
        """
        n, levels = self.independent, list(LEVELS)
        ranks = np.array([_ranks_around(n, level) for level in levels], dtype=float)
        known = (ranks >= 1.0) & (ranks <= n)
        # places, from 0 on, among all runs: outwards, where several depend on each other
        places = np.stack(
            [np.floor((ranks[:, 0] - 1.0) * runs / n), np.ceil(ranks[:, 1] * runs / n) - 1.0], axis=1
        )
        around = np.where(known, places / max(runs - 1, 1), 0.5)
        values = of([*levels, *around.ravel().tolist()])
        middle, ends = values[: len(levels)], values[len(levels) :].reshape(-1, 2)
        errors = np.where(known, np.abs(ends - middle[:, None]), np.nan)
        return middle, errors.max(axis=1)


def _ranks_around(n: int, level: float) -> tuple[int, int]:
    """Return the ranks of n values, from 1 on, between which a quantile lies; 0, n + 1 where there is none."""
    from scipy.special import bdtr, bdtrc

    middle, reach = n * level, WIDTH * math.sqrt(n * level * (1.0 - level)) + WIDTH
    first, last = max(0, math.floor(middle - reach)), min(n, math.ceil(middle + reach))
    counts = np.arange(first, last)  # beyond these there is less than either tail
    low = first + int(np.count_nonzero(bdtr(counts, n, level) <= TAIL))
    high = last + 1 - int(np.count_nonzero(bdtrc(counts, n, level) <= TAIL))
    return low, high


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


def share(count: int, runs: int, independent: int = 0) -> Share:
    """Return the share of runs; of samples, some of which are independent, with the interval that holds its true value
    with 95 % confidence."""
    if not independent:
        return Share(count / runs)
    from scipy.special import betaincinv

    held, n = count / runs * independent, independent
    low = float(betaincinv(held, n - held + 1, TAIL)) if count else 0.0
    high = float(betaincinv(held + 1, n - held, 1.0 - TAIL)) if count < runs else 1.0
    return Share(count / runs, low, high, CONFIDENCE)


def influences(keys: Sequence[str], values: Array, output: Array) -> dict[str, Influence]:
    """Return the influence of each key that takes several values, the largest first; none for too few runs.

    values : (N, keys). output : (N,), nan where a run has none.
    """
    fit = np.isfinite(output)
    moving = [k for k in range(len(keys)) if np.ptp(values[:, k]) > 0.0]
    if np.count_nonzero(fit) < len(moving) + 2:
        return {}
    x, y = values[fit][:, moving], output[fit]
    slopes = np.linalg.lstsq(np.column_stack([x - x.mean(axis=0), np.ones(len(x))]), y, rcond=None)[0][:-1]
    low, high = np.quantile(x, (0.05, 0.95), axis=0)
    ranks = _ranks(y)
    found = {
        keys[key]: Influence(float(slope * (b - a)), _correlation(_ranks(x[:, k]), ranks))
        for k, (key, slope, a, b) in enumerate(zip(moving, slopes, low, high))
    }
    return dict(sorted(found.items(), key=lambda item: -abs(item[1].swing)))


def _ranks(x: Array) -> Array:
    """Return ranks, equal values with their mean rank."""
    _, which, counts = np.unique(x, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return np.asarray(ends - (counts - 1) / 2.0)[which]


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / size if size else 0.0


def sobol(keys: Sequence[str], output: Array, off: float = 0.0) -> dict[str, SobolIndex] | None:
    """Return Sobol's indices of an output of Saltelli's design; None where it has gaps or does not vary.

        S = mean f(B) (f(AB) - f(A)) / V,    T = mean (f(A) - f(AB))^2 / 2 V

    with f less its mean, and V the variance over A and B. Rows of A, B and AB with one number depend on each other, and
    not on others: the ratio of two means over these numbers has the error of the mean of its linear part.
    Source: Saltelli et al. 2010, eqs. b and f of table 2.

    off : largest error of a run. In parts e of the standard deviation it moves an index by less than 6 e + 2 e^2: twice
    its root mean square is added to differences of rows, and as much to the root of the variance that they are over.
    """
    k = len(keys)
    n = len(output) // (k + 2)
    if not np.all(np.isfinite(output)) or np.ptp(output) == 0.0:
        return None
    A, B, *mixed = output.reshape(k + 2, n) - output[: 2 * n].mean()
    variances = 0.5 * (A**2 + B**2)
    V = float(variances.mean())
    if V == 0.0:
        return None
    part = off / math.sqrt(V)
    spoiled = 6.0 * part + 2.0 * part**2
    indices = {}
    for key, AB in zip(keys, mixed):
        ends: list[float] = []
        for terms in (B * (AB - A), 0.5 * (A - AB) ** 2):
            index = float(terms.mean()) / V
            linear = (terms - index * variances) / V
            spread = float(linear.std(ddof=1)) / math.sqrt(n) * (1.0 + FEW / n)
            error = reach(n, _skewness(linear)) * spread + spoiled
            ends += [index, index - error, index + error]
        indices[key] = SobolIndex(*ends)
    return indices

"""What the runs of a study say together: shares of runs, influence of each key."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.study import Influence, Share, SobolIndex

CONFIDENCE = 0.95  # of all intervals


def share(count: int, runs: int, sampled: bool = True) -> Share:
    """Return the share of runs; of random samples with the interval that holds its true value with 95 % confidence."""
    if not sampled:
        return Share(count / runs)
    from scipy.special import betaincinv

    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(betaincinv(count, runs - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, runs - count, 1.0 - tail)) if count < runs else 1.0
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


def sobol(keys: Sequence[str], output: Array) -> dict[str, SobolIndex] | None:
    """Return Sobol's indices of an output of Saltelli's design; None where it has gaps or does not vary.

    Source: Saltelli et al. 2010, as ``scipy.stats.sobol_indices`` has it, with its bootstrap.
    """
    from scipy.stats import sobol_indices

    k = len(keys)
    n = len(output) // (k + 2)
    if not np.all(np.isfinite(output)) or np.ptp(output) == 0.0:
        return None
    blocks = output.reshape(k + 2, n)
    # scipy fails on the single number of one output and one key, so the output stands there twice
    twice = np.stack([blocks, blocks], axis=1)
    found = sobol_indices(func={"f_A": twice[0], "f_B": twice[1], "f_AB": twice[2:]}, n=n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # resamples may not vary, see _sides
        spreads = found.bootstrap(confidence_level=CONFIDENCE)
    orders = ((found.first_order, spreads.first_order), (found.total_order, spreads.total_order))
    columns = [column for value, order in orders for column in (value, *_sides(order))]
    by_key = np.array([column.reshape(2, k)[0] for column in columns]).T
    return {key: SobolIndex(*(float(x) for x in row)) for key, row in zip(keys, by_key)}


def _sides(order: Any) -> tuple[Array, Array]:
    """Return both ends of a bootstrap's interval.

    Where the corrected one (BCa) does not exist, because no resample varies or hardly one does (a key without
    influence, very few samples), it is that between quantiles.
    """
    tail = (1.0 - CONFIDENCE) / 2.0
    plain = np.nanquantile(order.bootstrap_distribution, (tail, 1.0 - tail), axis=-1)
    low, high = order.confidence_interval
    there = np.isfinite(low) & np.isfinite(high)
    return np.where(there, low, plain[0]), np.where(there, high, plain[1])

"""Where sampled functions pass zero, and their values between samples: the polynomial of degree 5 through the six
nearest samples, with how far that of degree 3 through four of them is off as the error."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.polynomials import real_roots, value
from robodyn_cli.solve.quadrature import gaps_between
from robodyn_cli.spatial.algebra import Array

ROUNDED = 1e-14  # of a time
MORE, FEWER = 6, 4  # samples


def crossings(times: Array, y: Array, nothing: float) -> list[tuple[float, float]]:
    """Return the times at which y (T,) at times (T,) passes zero, each with its error; ``nothing`` counts as zero."""
    sign = np.where(np.abs(y) <= nothing, 0.0, np.sign(y))
    rounded = ROUNDED * float(np.abs(times).max())
    found: list[tuple[float, float]] = []
    rests = np.flatnonzero(sign == 0.0)
    for k in rests:
        beside = np.abs(np.gradient(y, times)[k]) if len(y) > 1 else 0.0
        found.append((float(times[k]), rounded + float(nothing / beside if beside > 0.0 else np.ptp(times))))
    passed = np.flatnonzero(sign[:-1] * sign[1:] < 0.0)
    h = times[passed + 1] - times[passed]
    part, off = crossing(times, y, passed)
    found += zip((times[passed] + part * h).tolist(), (rounded + off * h).tolist())
    return sorted(found)


def crossing(times: Array, y: Array, k: NDArray[np.int_]) -> tuple[Array, Array]:
    """Return where y (T,) passes zero between samples k (n,) and the next ones, as parts of the way, and the errors."""
    linear = y[k] / (y[k] - y[k + 1])
    roots = np.tile(linear, (2, 1))
    for row, count in zip(roots, (MORE, FEWER)):
        for own, c in _powers(times, y, k, count):
            found = real_roots(c, np.ones(len(own)))
            found = np.where(found < 1.0, found, np.inf)
            nearest = np.argmin(np.abs(found - linear[own]), axis=0)
            root = found[nearest, np.arange(len(own))]
            row[own] = np.where(np.isfinite(root), root, linear[own])
    return roots[0], np.abs(roots[0] - roots[1])


def value_at(times: Array, y: Array, time: float) -> tuple[float, float]:
    """Return y (T,) at a time, and its error."""
    k = np.clip(np.searchsorted(times, [time]) - 1, 0, len(times) - 2)
    s = (time - times[k]) / (times[k + 1] - times[k])
    more, fewer = (float(value(c, s)[0]) for count in (MORE, FEWER) for _, c in _powers(times, y, k, count))
    return more, abs(more - fewer) + ROUNDED * float(np.abs(y).max())


def _powers(
    times: Array, y: Array, k: NDArray[np.int_], count: int
) -> Iterator[tuple[NDArray[np.int_], Array]]:
    """Yield the polynomials (p, n), in parts of the intervals behind samples k, through the samples of their pieces
    near them, with their places among k: those of as many samples each together."""
    ends = np.concatenate([[0], gaps_between(times) + 1, [len(times)]])
    piece = np.searchsorted(ends, k, side="right") - 1
    low, high = ends[piece], ends[piece + 1]
    counts = np.minimum(count, high - low)
    first = np.clip(k - counts // 2 + 1, low, high - counts)
    for points in np.unique(counts).tolist():
        own = np.flatnonzero(counts == points)
        near = first[own, None] + np.arange(points)
        s = (times[near] - times[k[own], None]) / (times[k[own] + 1] - times[k[own]])[:, None]
        matrices = s[:, :, None] ** np.arange(points)
        yield own, np.linalg.solve(matrices, y[near][:, :, None])[:, :, 0].T

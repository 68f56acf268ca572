"""Where sampled functions pass zero, and their values between samples: the polynomial of degree 5 through the six
nearest samples, with how far that of degree 3 through four of them is off as the error."""

from __future__ import annotations

import numpy as np

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
    for k in np.flatnonzero(sign[:-1] * sign[1:] < 0.0).tolist():
        h = float(times[k + 1] - times[k])
        part, off = crossing(times, y, k)
        found.append((float(times[k]) + part * h, rounded + off * h))
    return sorted(found)


def crossing(times: Array, y: Array, k: int) -> tuple[float, float]:
    """Return where y (T,) passes zero between samples k and k + 1, as part of the way, and its error."""
    linear, roots = y[k] / (y[k] - y[k + 1]), []
    for count in (MORE, FEWER):
        c = _powers(times, y, k, count)
        real = [x.real for x in np.roots(c) if abs(x.imag) < 1e-6 and -1e-9 <= x.real <= 1.0 + 1e-9]
        roots.append(float(min(real or [linear], key=lambda x: abs(x - linear))))
    return roots[0], abs(roots[0] - roots[1])


def value_at(times: Array, y: Array, time: float) -> tuple[float, float]:
    """Return y (T,) at a time, and its error."""
    k = int(np.clip(np.searchsorted(times, time) - 1, 0, len(times) - 2))
    s = (time - float(times[k])) / float(times[k + 1] - times[k])
    more, fewer = (float(np.polyval(_powers(times, y, k, count), s)) for count in (MORE, FEWER))
    return more, abs(more - fewer) + ROUNDED * float(np.abs(y).max())


def _powers(times: Array, y: Array, k: int, count: int) -> Array:
    """Return the polynomial, in parts of the interval behind sample k, through the samples of its piece near it."""
    gaps = gaps_between(times)
    low = int(max([0, *(g + 1 for g in gaps if g < k)]))
    high = int(min([len(times), *(g + 1 for g in gaps if g > k)]))
    count = min(count, high - low)
    first = int(np.clip(k - count // 2 + 1, low, high - count))
    own = slice(first, first + count)
    s = (times[own] - times[k]) / (times[k + 1] - times[k])
    return np.asarray(np.linalg.solve(np.vander(s), y[own]))

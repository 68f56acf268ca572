"""Peaks of functions that are smooth in pieces and known at close samples, as those of an integrated motion are.

In each window of nine samples the polynomial of degree 8 through them takes the place of a function; how far the one
of degree 6 through seven of them is off from it bounds what it leaves out. A piece may reach beyond its samples, by
about as much as from one to the next.
"""

from __future__ import annotations

import collections
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.polynomials import derivative
from robodyn_cli.algorithms.polynomials import value as value_of
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

WINDOW = 9  # samples
# those of them through which the polynomial of less degree goes, by how many there are
FEWER = {9: [0, 1, 3, 4, 5, 7, 8], 8: [0, 1, 3, 4, 6, 7], 7: [0, 1, 3, 5, 6]}
LOOKED = 33  # points of a window at which polynomials are evaluated first
SLOPE = 64.0  # times a polynomial's largest value in [-1, 1]: its slope, with the degree squared (Markov)
ROUNDING = 4e-15  # part of the values in a window that rounding leaves
ALIKE = 1e-12  # part of a value by which peaks that count as equal differ: the first one is told
NEAR = 0.1  # of the way between samples: one that is so near to a state at an event says no more
ROUNDED = 1e-14  # of a time
EVEN = 1e-6  # of half a window: how far samples of equal steps may be off these, by which ``BEYOND`` changes little
# Lebesgue's constants: 10.95 of nine equidistant nodes, twice, for a value and its error, and 3.79 of seven of them
BEYOND = 26.0
Piece = tuple[Array, Array, float, float]  # times (k,), values (k, n), and where it begins and ends
Cut = tuple[float, Any, Any]  # a time [s], values (n,) before and behind it, None where they are not known


def pieces(times: Array, values: Array, cuts: Sequence[Cut], ends: tuple[float, float]) -> Iterator[Piece]:
    """Yield the smooth pieces of functions with values (T, n) at times (T,), between cuts."""
    bounds = [(ends[0], None, None), *cuts, (ends[1], None, None)]
    rounding = ROUNDED * max(map(abs, ends))
    for (begin, _, first), (end, last, _) in itertools.pairwise(bounds):
        inside = slice(np.searchsorted(times, begin), np.searchsorted(times, end + rounding, side="right"))
        t, y = times[inside], values[inside]
        # of a sample at a cut it is not known of which side it is
        kept = (t > begin + rounding) | ((begin == ends[0]) & (first is None))
        kept &= (t < end - rounding) | (end == ends[1])
        t, y = t[kept], y[kept]
        if len(t) > 1:
            kept = np.ones(len(t), dtype=bool)
            kept[0] = first is None or t[0] - begin > NEAR * (t[1] - t[0])
            kept[-1] = last is None or end - t[-1] > NEAR * (t[-1] - t[-2])
            t, y = t[kept], y[kept]
        known = [(begin, first)] * (first is not None) + [(end, last)] * (
            last is not None and end > begin + rounding
        )
        parts = [*((np.array([at]), value[None]) for at, value in known[:1] if at == begin)]
        parts.append((t, y))
        parts += [(np.array([at]), value[None]) for at, value in known if at != begin]
        t, y = (np.concatenate(arrays) for arrays in zip(*parts))
        if len(t):  # one from event to event within rounding is an instant
            yield t, y, begin, end if end > begin + rounding else begin


Found = tuple[Array, Array, Array, Array]  # of windows (W,): peaks, their errors, times, the errors of these


class Windows:
    """Windows of nine samples of functions, or of fewer where a piece has no more, and the peaks in them.

    Polynomials are made of those windows alone in which a peak may lie: beside the line through the ends of a window,
    one through equidistant samples is at most ``BEYOND`` times as large as these are.
    """

    def __init__(self, parts: Iterable[Piece]) -> None:
        alike = collections.defaultdict(list)
        for own in itertools.chain.from_iterable(_by_steps(*part) for part in parts):
            alike[len(own[0])].append(own)
        self._groups = [_Group.of(*map(np.array, zip(*group))) for group in alike.values()]
        self._bounds: dict[tuple[float, int], tuple[Array, float, float]] = {}
        self._found: dict[tuple[float, int], tuple[Array, Found]] = {}

    def best(self, sign: float, k: int, doubt: float = 0.0) -> tuple[float, float, float, float]:
        """Return the largest value of one function (the smallest for a sign of -1) with its error, its time, and the
        error of that.

        It covers all that is as large but for errors, and twice a ``doubt`` that all values share.
        """
        if (sign, k) not in self._bounds:
            bounds, tops, floors = zip(*(group.bounds(sign, k) for group in self._groups))
            self._bounds[sign, k] = np.concatenate(bounds), max(tops), max(tops) - min(floors)
        _, most, spread = self._bounds[sign, k]
        value, error, time, _ = self._peaks(sign, k, most - 2.0 * ALIKE * abs(most))
        most = float(value.max())
        first = int(np.argmax(value >= most - ALIKE * abs(most)))
        # samples that follow no smooth function say no more than their range
        unsure = min(max(float(error[first]), float((value + error).max()) - most), 2.0 * spread)
        at, least = float(time[first]), most - unsure - 2.0 * doubt
        value, error, time, off = self._peaks(sign, k, least)
        away = np.where(value + error >= least, np.abs(time - at) + off, 0.0)
        return sign * most + 0.0, unsure, at, float(away.max())

    def _peaks(self, sign: float, k: int, least: float) -> Found:
        """Return the peaks of one function in all windows that may have one of ``least`` or more, with its error."""
        chosen = self._bounds[sign, k][0] >= least
        if (sign, k) not in self._found or (chosen & ~self._found[sign, k][0]).any():
            parts = np.split(chosen, np.cumsum([len(group.x) for group in self._groups])[:-1])
            found = [group.peaks(sign, k, own) for group, own in zip(self._groups, parts) if own.any()]
            value, error, time, off = (np.concatenate(arrays) for arrays in zip(*found))
            self._found[sign, k] = chosen, (value, error, time, off)
        return self._found[sign, k][1]


@record
class _Group:
    """Windows of as many samples each: values y (W, s, n) at x (W, s) = (t - middle) / half, and from low to high.

    middle, half : [s] (W,). even : whether samples are equidistant and reach to both ends.
    """

    x: Array
    y: Array
    middle: Array
    half: Array
    low: Array
    high: Array
    even: Array

    @staticmethod
    def of(t: Array, y: Array, begin: Array, end: Array) -> _Group:
        """Return the windows of pieces of as many samples each, at times t (P, k), with values y (P, k, n)."""
        count, size = t.shape[1], min(WINDOW, t.shape[1])
        rows = np.append(np.arange(0, count - size, WINDOW - 1), count - size)[:, None] + np.arange(size)
        ends = t[:, rows][:, :, [0, -1]]
        ends[:, 0, 0], ends[:, -1, 1] = begin, end
        times, values, ends = (x.reshape(-1, *x.shape[2:]) for x in (t[:, rows], y[:, rows], ends))
        middle, half = 0.5 * (times[:, 0] + times[:, -1]), 0.5 * (times[:, -1] - times[:, 0])
        long = np.repeat(end > begin, len(rows))
        half = np.where(half > 0.0, half, np.where(long, np.repeat(end - begin, len(rows)), 1.0))
        x = (times - middle[:, None]) / half[:, None]
        low, high = ((ends[:, k] - middle) / half for k in (0, 1))
        even = (
            np.abs(x - np.linspace(-1.0, 1.0, size)).max(axis=1) < EVEN
            if size == WINDOW
            else np.zeros(len(x), bool)
        )
        even &= (low > -1.0 - EVEN) & (high < 1.0 + EVEN)
        return _Group(x, values, middle, half, low, high, even)

    def bounds(self, sign: float, k: int) -> tuple[Array, float, float]:
        """Return what the peak (W,) of one function, times the sign, and its error together do not exceed, and the
        largest and the least of all its samples."""
        y = sign * self.y[:, :, k]
        first, last = y[:, :1], y[:, -1:]
        bent = np.abs(y - (first + (last - first) * np.linspace(0.0, 1.0, y.shape[1]))).max(axis=1)
        rounded = 2.0 * ROUNDING * np.abs(y).max(axis=1)
        most = np.maximum(first, last)[:, 0] + BEYOND * bent + rounded
        return np.where(self.even, most, np.inf), float(y.max()), float(y.min())

    def peaks(self, sign: float, k: int, chosen: Array) -> Found:
        """Return the peaks of one function, times the sign, in some windows (W,)."""
        x, y = self.x[chosen], sign * self.y[chosen, :, k, None]
        middle, half, low, high = (v[chosen] for v in (self.middle, self.half, self.low, self.high))
        size = x.shape[1]
        fewer = FEWER.get(size, list(range(0, size, 2)))
        c = _powers(x, y)[:, :, 0].T
        doubt = c.copy()
        doubt[: len(fewer)] -= _powers(x[:, fewer], y[:, fewer])[:, :, 0].T
        if size == 1:  # nothing says where a function goes from there
            doubt[0, high > low] = np.inf
        value, error, at, off = _highest(c, doubt, low, high)
        return value, error, middle + half * at, half * off


def _highest(c: Array, doubt: Array, low: Array, high: Array) -> Found:
    """Return the largest values (W,) of polynomials with coefficients c (p, W) between low and high, and places in
    place of times; doubt : coefficients of what these may be off by."""
    x = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, LOOKED)
    looked = value_of(c[:, :, None], x)
    error = np.abs(value_of(doubt[:, :, None], x)).max(axis=1) + ROUNDING * np.abs(looked).max(axis=1)
    place = np.argmax(looked, axis=1)
    at = np.take_along_axis(x, place[:, None], axis=1)[:, 0]
    slope = derivative(c)
    bend = derivative(slope)
    apart = (high - low) / (LOOKED - 1)
    first, last = np.maximum(at - apart, low), np.minimum(at + apart, high)
    for _ in range(4):
        own = value_of(bend, at)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = np.clip(np.where(own < 0.0, at - value_of(slope, at) / own, at), first, last)
    value = value_of(c, at)
    better = value < looked.max(axis=1)
    at = np.where(better, np.take_along_axis(x, place[:, None], axis=1)[:, 0], at)
    value = np.where(better, looked.max(axis=1), value)
    # where the slope may be zero: at the end of a window it is not, as far as it is known
    unsure, steep = SLOPE * error, np.abs(value_of(slope, at))
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(error > 0.0, (unsure + steep * (steep <= unsure)) / np.abs(value_of(bend, at)), 0.0)
    off = np.where((steep > unsure) & ((at <= low) | (at >= high)), 0.0, off)
    return value, error, at, np.minimum(np.nan_to_num(off, nan=np.inf), high - low)


def _by_steps(t: Array, y: Array, begin: float, end: float) -> Iterator[Piece]:
    """Yield a piece with what reaches beyond its samples apart: there the first or the last one of a step is missing,
    and steps beside a jump may be shorter than the next by orders."""
    step = WINDOW - 1
    if begin < t[0] and len(t) > WINDOW:
        yield t[:step], y[:step], begin, float(t[step - 1])
        t, y, begin = t[step - 1 :], y[step - 1 :], float(t[step - 1])
    if end > t[-1] and len(t) > WINDOW:
        yield t[-step:], y[-step:], float(t[-step]), end
        t, y, end = t[: 1 - step], y[: 1 - step], float(t[-step])
    yield t, y, begin, end


def _powers(x: Array, y: Array) -> Array:
    """Return coefficients of powers (W, k, n) of the polynomials with values y (W, k, n) at x (W, k)."""
    matrices = np.ones((*x.shape, x.shape[1]))
    for k in range(1, x.shape[1]):  # ten times as fast as powers
        np.multiply(matrices[:, :, k - 1], x, out=matrices[:, :, k])
    return np.asarray(np.linalg.solve(matrices, y))

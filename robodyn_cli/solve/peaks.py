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


@record
class Windows:
    """Polynomials of functions in windows, by x = (t - middle) / half from low to high.

    powers : coefficients (W, 9, n) of values. doubts : of what those of less degree are off by.
    """

    middle: Array
    half: Array
    low: Array
    high: Array
    powers: Array
    doubts: Array

    @staticmethod
    def of(parts: Iterable[Piece]) -> Windows:
        """Return the windows of functions in pieces, of which each has a sample at least."""
        alike = collections.defaultdict(list)
        for own in itertools.chain.from_iterable(_by_steps(*part) for part in parts):
            alike[len(own[0])].append(own)
        wide = [_windows(*map(np.array, zip(*group))) for group in alike.values()]
        return Windows(*(np.concatenate(arrays) for arrays in zip(*wide)))

    def peaks(self, sign: float) -> Peaks:
        """Return the largest values in each window, or the smallest ones for a sign of -1."""
        x = self.low[:, None] + (self.high - self.low)[:, None] * np.linspace(0.0, 1.0, LOOKED)
        found = [self._column(k, sign, x) for k in range(self.powers.shape[2])]
        value, error, time, off = (np.column_stack(arrays) for arrays in zip(*found))
        return Peaks(value, error, time, off, 2.0 * self.half)

    def _column(self, k: int, sign: float, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return the largest values (W,) of one function, their errors, times, and the errors of these."""
        c, doubt = sign * self.powers[:, :, k].T, self.doubts[:, :, k].T
        looked = _value(c[:, :, None], x)
        error = np.abs(_value(doubt[:, :, None], x)).max(axis=1) + ROUNDING * np.abs(looked).max(axis=1)
        place = np.argmax(looked, axis=1)
        at = np.take_along_axis(x, place[:, None], axis=1)[:, 0]
        slope = _derivative(c)
        bend = _derivative(slope)
        apart = (self.high - self.low) / (LOOKED - 1)
        first, last = np.maximum(at - apart, self.low), np.minimum(at + apart, self.high)
        for _ in range(4):
            own = _value(bend, at)
            with np.errstate(divide="ignore", invalid="ignore"):
                at = np.clip(np.where(own < 0.0, at - _value(slope, at) / own, at), first, last)
        value = _value(c, at)
        better = value < looked.max(axis=1)
        at = np.where(better, np.take_along_axis(x, place[:, None], axis=1)[:, 0], at)
        value = np.where(better, looked.max(axis=1), value)
        # where the slope may be zero: at the end of a window it is not, as far as it is known
        unsure, steep = SLOPE * error, np.abs(_value(slope, at))
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.where(error > 0.0, (unsure + steep * (steep <= unsure)) / np.abs(_value(bend, at)), 0.0)
        off = np.where((steep > unsure) & ((at <= self.low) | (at >= self.high)), 0.0, off)
        off = np.minimum(np.nan_to_num(off, nan=np.inf), self.high - self.low)
        return sign * value, error, self.middle + self.half * at, self.half * off


@record
class Peaks:
    """The largest (or smallest) values of functions in each window (W, n), their errors, times, the errors of these,
    and the lengths of the windows (W,) in time."""

    value: Array
    error: Array
    time: Array
    time_error: Array
    length: Array

    def best(self, sign: float, k: int, doubt: float = 0.0) -> tuple[float, float, float, float]:
        """Return the largest value of one function (the smallest for a sign of -1) with its error, its time, and the
        error of that.

        It covers all that is as large but for errors, and twice a ``doubt`` that all values share.
        """
        value, error, time, off = (
            x[:, k] for x in (sign * self.value, self.error, self.time, self.time_error)
        )
        most = float(value.max())
        first = int(np.argmax(value >= most - ALIKE * abs(most)))
        # samples that follow no smooth function say no more than their range
        unsure = max(float(error[first]), float((value + error).max()) - most)
        unsure = min(unsure, 2.0 * float(np.ptp(value)))
        rivals = value + error >= most - unsure - 2.0 * doubt
        away = np.where(rivals, np.abs(time - time[first]) + off, 0.0)
        return sign * most + 0.0, unsure, float(time[first]), float(away.max())


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


def _windows(t: Array, y: Array, begin: Array, end: Array) -> tuple[Array, ...]:
    """Return the arrays of windows for pieces of as many samples each, at times t (P, k), with values y (P, k, n)."""
    count, size = t.shape[1], min(WINDOW, t.shape[1])
    rows = np.append(np.arange(0, count - size, WINDOW - 1), count - size)[:, None] + np.arange(size)
    ends = t[:, rows][:, :, [0, -1]]
    ends[:, 0, 0], ends[:, -1, 1] = begin, end
    times, values, ends = (x.reshape(-1, *x.shape[2:]) for x in (t[:, rows], y[:, rows], ends))
    middle, half = 0.5 * (times[:, 0] + times[:, -1]), 0.5 * (times[:, -1] - times[:, 0])
    half = np.where(half > 0.0, half, np.where(end > begin, end - begin, 1.0) if size == 1 else 1.0)
    x = (times - middle[:, None]) / half[:, None]
    powers = np.zeros((len(x), WINDOW, y.shape[2]))
    less = np.zeros_like(powers)
    fewer = FEWER.get(size, list(range(0, size, 2)))
    powers[:, :size] = _powers(x, values)
    less[:, : len(fewer)] = _powers(x[:, fewer], values[:, fewer])
    if size == 1:  # nothing says where a function goes from there
        less[end > begin, 0] = np.inf
    low, high = ((ends[:, k] - middle) / half for k in (0, 1))
    return middle, half, low, high, powers, powers - less


def _powers(x: Array, y: Array) -> Array:
    """Return coefficients of powers (W, k, n) of the polynomials with values y (W, k, n) at x (W, k)."""
    matrices = np.ones((*x.shape, x.shape[1]))
    for k in range(1, x.shape[1]):  # ten times as fast as powers
        np.multiply(matrices[:, :, k - 1], x, out=matrices[:, :, k])
    return np.asarray(np.linalg.solve(matrices, y))


def _value(c: Array, x: Array) -> Array:
    """Return polynomials with coefficients c (p, ...) at x."""
    found = np.zeros_like(x)
    for row in c[::-1]:
        found = found * x + row
    return found


def _derivative(c: Array) -> Array:
    return c[1:] * np.arange(1.0, len(c)).reshape(-1, *[1] * (c.ndim - 1))

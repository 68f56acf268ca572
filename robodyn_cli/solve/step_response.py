"""Figures of a response: how a coordinate goes from where it is to where it is to be, located between samples.

A crossing is the root of the polynomial through the samples around it, whose error is what one of lower degree gives
otherwise, and how far it moves where the level, or the motion, is off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

NEAR = 6  # samples that a polynomial goes through
NOTHING = 1e-12  # of the largest value: a step this small is none
LOW, HIGH = 0.1, 0.9  # of the step: where the rise begins and ends
BAND = 0.02  # of the step, within which it has settled


@record
class SmoothCourse:
    """A coordinate over time in smooth pieces: times (k,), values (k,), both sides of a jump in two of them."""

    pieces: Sequence[tuple[Array, Array]]

    def first(self, level: float, sign: float) -> float | None:
        """Return when sign (y - level) is first positive; None where never."""
        for t, y in self.pieces:
            above = np.flatnonzero(sign * (y - level) >= 0.0)
            if len(above):
                k = int(above[0])
                return float(t[0]) if k == 0 else _root(t, y - level, k - 1)
        return None

    def last_outside(self, centre: float, band: float) -> float | None:
        """Return when |y - centre| is last larger than a band; None where it is at the end, the start where never."""
        begin = float(self.pieces[0][0][0])
        for place, (t, y) in enumerate(reversed(self.pieces)):
            off = np.abs(y - centre) - band
            outside = np.flatnonzero(off > 0.0)
            if not len(outside):
                continue
            k = int(outside[-1])
            if k == len(t) - 1:
                return None if place == 0 else float(t[-1])
            side = math.copysign(1.0, float(y[k] - centre))
            return _root(t, y - centre - side * band, k)
        return begin


def _root(t: Array, y: Array, k: int) -> float:
    """Return the root of y between the samples k and k + 1, by the polynomial through those around them."""
    return _through(t, y, k, NEAR)


def _through(t: Array, y: Array, k: int, count: int) -> float:
    from scipy.interpolate import KroghInterpolator
    from scipy.optimize import brentq

    first = min(max(k - count // 2 + 1, 0), max(len(t) - count, 0))
    own = slice(first, first + count)
    if y[k] == 0.0 or y[k + 1] == 0.0:
        return float(t[k] if y[k] == 0.0 else t[k + 1])
    middle, width = float(t[k]), float(t[k + 1] - t[k])
    curve = KroghInterpolator((t[own] - middle) / width, y[own])
    found: float = brentq(lambda s: float(curve(s)), 0.0, 1.0, xtol=1e-14)
    return middle + width * found


@record
class TimeFigure:
    """A time [s] and its error; None where it does not come."""

    value: float | None
    error: float | None


def rise_of(course: SmoothCourse, start: float, end: float, off: float) -> TimeFigure:
    """Return the time from a tenth of the step to nine tenths, first met; off : by how much the motion may be."""
    step = end - start
    sign = math.copysign(1.0, step)

    def at(part: float, shift: float) -> float | None:
        return course.first(start + part * step + sign * shift, sign)

    low, high = at(LOW, 0.0), at(HIGH, 0.0)
    if low is None or high is None:
        return TimeFigure(None, None)
    errors = [_apart(at(part, -off), own, at(part, off)) for part, own in ((LOW, low), (HIGH, high))]
    error = None if None in errors else sum(x for x in errors if x is not None)
    return TimeFigure(high - low, error)


def settling_of(course: SmoothCourse, start: float, end: float, off: float) -> TimeFigure:
    """Return when it enters the band about the end for good, from the start on."""
    band = BAND * abs(end - start)
    begin = float(course.pieces[0][0][0])
    early, own, late = (course.last_outside(end, max(band + x, 0.0)) for x in (off, 0.0, -off))
    if own is None:
        return TimeFigure(None, None)
    return TimeFigure(own - begin, _apart(early, own, late))


def _apart(early: float | None, own: float, late: float | None) -> float | None:
    """Return how far times may be apart, rounding included; None where one does not come."""
    if early is None or late is None:
        return None
    return max(abs(own - early), abs(late - own)) + 1e-14 * max(abs(own), abs(late), 1e-3)

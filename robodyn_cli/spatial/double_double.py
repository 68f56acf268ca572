"""Sums of two doubles: some 32 digits, for constants that are computed once and rounded once.

Source: Dekker 1971, "A floating-point technique for extending the available precision"; Knuth, The Art of Computer
Programming 2, section 4.2.2.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

SPLIT = 134217729.0  # 2^27 + 1


def two_sum(a: float, b: float) -> tuple[float, float]:
    """Return s and e with s + e = a + b exactly and s = a + b rounded."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def two_product(a: float, b: float) -> tuple[float, float]:
    """Return p and e with p + e = a b exactly and p = a b rounded; e = 0 where splitting would overflow."""
    p = a * b
    (a1, a0), (b1, b0) = _halves(a), _halves(b)
    e = ((a1 * b1 - p) + a1 * b0 + a0 * b1) + a0 * b0
    return p, e if math.isfinite(e) else 0.0


def _halves(a: float) -> tuple[float, float]:
    t = SPLIT * a
    high = t - (t - a)
    return high, a - high


class DoubleDouble:
    """The number high + low; low is at most half a unit of rounding of high."""

    __slots__ = ("high", "low")

    def __init__(self, high: float, low: float = 0.0) -> None:
        self.high, self.low = two_sum(high, low)

    def __add__(self, other: DoubleDouble | float) -> DoubleDouble:
        if isinstance(other, np.ndarray):  # which then adds entry by entry
            return NotImplemented
        b = _of(other)
        s, e = two_sum(self.high, b.high)
        t, f = two_sum(self.low, b.low)
        s, e = two_sum(s, e + t)
        return DoubleDouble(s, e + f)

    def __neg__(self) -> DoubleDouble:
        return DoubleDouble(-self.high, -self.low)

    def __sub__(self, other: DoubleDouble | float) -> DoubleDouble:
        return self + -_of(other)

    def __rsub__(self, other: float) -> DoubleDouble:
        return _of(other) + -self

    def __mul__(self, other: DoubleDouble | float) -> DoubleDouble:
        if isinstance(other, np.ndarray):
            return NotImplemented
        b = _of(other)
        p, e = two_product(self.high, b.high)
        return DoubleDouble(p, e + (self.high * b.low + self.low * b.high))

    __radd__ = __add__
    __rmul__ = __mul__

    def __float__(self) -> float:
        return float(self.high)


def _of(x: DoubleDouble | float) -> DoubleDouble:
    return x if isinstance(x, DoubleDouble) else DoubleDouble(float(x))


def extended(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array of numbers as an array of sums of two doubles."""
    return np.frompyfunc(_of, 1, 1)(array)


def orthonormal(E: NDArray[Any]) -> NDArray[Any]:
    """Return the rotation (3, 3) next to one that is orthonormal to rounding only: E (3 - E^T E) / 2.

    With it a rotation changes no isotropic part of an inertia.
    """
    F = extended(E)
    product: NDArray[Any] = 1.5 * F - 0.5 * (F @ (F.T @ F))
    return product

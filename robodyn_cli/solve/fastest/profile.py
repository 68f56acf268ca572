"""The fastest profile x(s) = s-dot^2 over a grid, by reachability analysis.

Within a segment of length D the acceleration u = x' / 2 goes linearly from u0 to u1, so x1 - x0 = D (u0 + u1). A pass
from the end of the path finds, for each grid point, the interval of x from which the end can be reached; a pass
from the start takes the largest x in it that can be reached (Pham and Pham 2018, IEEE T-RO 34, with linear in place
of constant accelerations). Both ask for limits at the ends of segments only.

Where a limit's A changes its sign, the limits of u depend so steeply on x that linear accelerations would swing from
one segment to the next; there they are constant, u0 = u1 = (x1 - x0) / (2 D), which damps the swing.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.fastest.rows import Rows
from robodyn_cli.spatial.algebra import Array

FAR = 1e30  # stands for no bound of x
NEWTON = 100
STEEP = 2.0  # segments to the point where A is 0


class NoProfile(Exception):
    """The limits allow no motion at the grid point ``place``; ``row`` : the limit, None where the pass found none."""

    def __init__(self, place: int, row: int | None = None) -> None:
        super().__init__(place)
        self.place, self.row = place, row


@record
class Profile:
    """Squared speed x (K + 1,) at the grid points, and the acceleration at both ends of each segment (K,)."""

    x: Array
    u0: Array
    u1: Array


@record
class _Ends:
    """Bounds of u at the same end of all segments: low - slope x <= u <= high - slope x, each (K, n)."""

    low: Array
    high: Array
    slope: Array

    @staticmethod
    def of(rows: Rows, margin: tuple[Array, Array], place: int) -> _Ends:
        A, B, C = rows.A[:, place], rows.B[:, place], rows.C[:, place]
        sign, size = np.where(A < 0.0, -1.0, 1.0), np.maximum(np.abs(A), 1e-300)
        above, below = (
            1.0 - margin[0],
            1.0 - margin[1],
        )  # allowed in the row's positive and negative direction
        above, below = np.where(sign > 0.0, above, below), np.where(sign > 0.0, below, above)
        with np.errstate(over="ignore"):
            found = (-below - sign * C) / size, (above - sign * C) / size, sign * B / size
        return _Ends(*(np.clip(x, -FAR, FAR) for x in found))

    def admissible(self, most: Array) -> tuple[Array, Array]:
        """Return the least and the largest x (K,) at which some u is allowed; the least one is above where none is."""
        high, low = np.minimum(most, FAR), np.zeros(len(most))
        for bound in (high, low):
            for _ in range(NEWTON):
                gap, root = self._gap(bound)
                move = (gap < 0.0) & np.isfinite(root)
                stays = ~move | ((root >= bound) if bound is high else (root <= bound))
                if stays.all():
                    break
                bound[~stays] = root[~stays]
        return low, high

    def _gap(self, x: Array) -> tuple[Array, Array]:
        """Return the largest less the least u (K,) at x, and the x at which the two limits of now meet."""
        uppers, lowers = self.high - self.slope * x[:, None], self.low - self.slope * x[:, None]
        j, k = uppers.argmin(axis=1), lowers.argmax(axis=1)
        at = np.arange(len(x))
        with np.errstate(all="ignore"):
            root = (self.high[at, j] - self.low[at, k]) / (self.slope[at, j] - self.slope[at, k])
        scale = np.abs(uppers[at, j]) + np.abs(lowers[at, k])
        gap = uppers[at, j] - lowers[at, k]
        return np.where(np.abs(gap) < 1e-13 * scale, 0.0, gap), root

    def range(self, x: Array) -> tuple[Array, Array]:
        """Return the least and the largest u (K,) at x (K,)."""
        low = (self.low - self.slope * x[:, None]).max(axis=1)
        high = (self.high - self.slope * x[:, None]).min(axis=1)
        return low, high


class Passes:
    """Both passes on one grid ``s`` (K + 1,) under ``rows``, less a ``margin`` (two of (K, n), for both signs)."""

    def __init__(self, s: Array, rows: Rows, margin: tuple[Array, Array]) -> None:
        self.D = np.diff(s)
        self.first, self.last = _Ends.of(rows, margin, 0), _Ends.of(rows, margin, -1)
        left, right = self.first.admissible(rows.most[:, 0]), self.last.admissible(rows.most[:, -1])
        self.low = np.maximum(np.append(left[0], 0.0), np.append(0.0, right[0]))
        self.high = np.minimum(np.append(left[1], FAR), np.append(FAR, right[1]))
        if (self.low > self.high).any():
            raise NoProfile(int(np.argmax(self.low > self.high)))
        A0, A1 = rows.A[:, 0], rows.A[:, -1]
        steep = np.minimum(np.abs(A0), np.abs(A1)) < STEEP * np.abs(A1 - A0)
        self.even = steep.any(axis=1)
        D = self.D[:, None] * np.where(self.even, 2.0, 1.0)[:, None]
        # x -+ D u at the ends of a segment, with 2 D where u is constant: coefficients of x, and constants
        self.k0, self.k1 = 1.0 - D * self.first.slope, 1.0 + D * self.last.slope
        self.low0, self.high0 = D * self.first.low, D * self.first.high
        self.low1, self.high1 = D * self.last.low, D * self.last.high

    def run(self, start: float = 0.0, end: float = 0.0) -> Profile:
        """Return the fastest profile from x = ``start`` to x = ``end``.

        Raises
        ------
        NoProfile : there is none.
        """
        self._backward(end)
        x = self._forward(start)
        mean = np.diff(x) / self.D
        (a0, b0), (a1, b1) = self.first.range(x[:-1]), self.last.range(x[1:])
        # as even an acceleration as the limits allow
        u0 = np.maximum(np.minimum(0.5 * mean, np.minimum(b0, mean - a1)), np.maximum(a0, mean - b1))
        u0 = np.where(self.even, 0.5 * mean, u0)
        return Profile(x, u0, mean - u0)

    def _backward(self, end: float) -> None:
        """Shrink the intervals of x to those from which the end can be reached."""
        low, high = self.low, self.high
        if not low[-1] <= end <= high[-1]:
            raise NoProfile(len(low) - 1)
        low[-1] = high[-1] = end
        for i in range(len(self.D) - 1, -1, -1):
            a, b = self._before(i)
            low[i], high[i] = max(low[i], a), min(high[i], b)
            if low[i] > high[i] * (1.0 + 1e-12):
                raise NoProfile(i)
            low[i] = min(low[i], high[i])

    def _before(self, i: int) -> tuple[float, float]:
        """Return the interval of x at the start of the segment i from which that at its end can be reached."""
        k, low, high = self.k1[i], self.low[i + 1], self.high[i + 1]
        if self.even[i]:
            upper = [(self.k0[i], self.high0[i]), (1.0 / k, self.high1[i] / k)]
            lower = [(self.k0[i], self.low0[i]), (1.0 / k, self.low1[i] / k)]
            return _projected(_lines(upper, lower, k, (low, high)), self.low[i], self.high[i])
        most = _top(k, -self.low1[i], low, high)  # of x1 - D u1 while braking
        least = -_top(-k, self.high1[i], low, high)  # while speeding up
        return _between(self.k0[i], most - self.low0[i], least - self.high0[i])

    def _forward(self, start: float) -> Array:
        """Return the largest x within the intervals that can be reached from one grid point to the next."""
        x = np.empty(len(self.low))
        x[0] = start
        if not self.low[0] <= start <= self.high[0]:
            raise NoProfile(0)
        for i in range(len(self.D)):
            k = self.k0[i] * x[i]
            fast, slow = float((k + self.high0[i]).min()), float((k + self.low0[i]).max())
            if self.even[i]:
                most = min(_between(self.k1[i], x[i] + self.high1[i], x[i] + self.low1[i])[1], fast)
            else:
                most = _between(self.k1[i], fast + self.high1[i], slow + self.low1[i])[1]
            x[i + 1] = max(min(most, self.high[i + 1]), self.low[i + 1])
        return x


Lines = tuple[Array, Array]


def _lines(
    upper: list[Lines], lower: list[Lines], k: Array, within: tuple[float, float]
) -> tuple[Lines, Lines]:
    """Return the bounds of x1 as lines of x0: upper ones and lower ones, each slopes and offsets.

    k : of k x1 <= x0 + ..., the second of each; where it is negative the line bounds the other side.
    """
    positive = k > 0.0
    (a0, b0), (a1, b1) = upper
    (c0, d0), (c1, d1) = lower
    over = np.concatenate([a0, a1[positive], c1[~positive], [0.0]])
    above = np.concatenate([b0, b1[positive], d1[~positive], [within[1]]])
    under = np.concatenate([c0, c1[positive], a1[~positive], [0.0]])
    below = np.concatenate([d0, d1[positive], b1[~positive], [within[0]]])
    return (over, above), (under, below)


def _projected(lines: tuple[Lines, Lines], low: float, high: float) -> tuple[float, float]:
    """Return the interval of x0 within ``low`` and ``high`` for which some x1 is left, by Newton's method."""
    (over, above), (under, below) = lines
    found = []
    for x, sign in ((low, 1.0), (high, -1.0)):
        for _ in range(NEWTON):
            uppers, lowers = over * x + above, under * x + below
            j, k = int(uppers.argmin()), int(lowers.argmax())
            gap = uppers[j] - lowers[k]
            if gap >= -1e-13 * (abs(uppers[j]) + abs(lowers[k])) or over[j] == under[k]:
                break
            root = (below[k] - above[j]) / (over[j] - under[k])
            if sign * (root - x) <= 0.0:
                break
            x = float(root)
        found.append(x)
    return found[0], found[1]


def _top(slope: Array, offset: Array, low: float, high: float) -> float:
    """Return the largest min_j (slope x + offset) for x between ``low`` and ``high``."""
    values = slope * high + offset
    j = int(values.argmin())
    if slope[j] >= 0.0 or low >= high:
        return float(values[j])
    values = slope * low + offset
    k = int(values.argmin())
    if slope[k] <= 0.0:
        return float(values[k])
    while True:  # cut by the lines that are least on both sides
        x = (offset[k] - offset[j]) / (slope[j] - slope[k])
        values = slope * x + offset
        i = int(values.argmin())
        here = slope[j] * x + offset[j]
        if i in (j, k) or values[i] >= here - 1e-14 * abs(here):
            return float(min(values[i], here))
        if slope[i] > 0.0:
            k = i
        else:
            j = i


def _between(k: Array, most: Array, least: Array) -> tuple[float, float]:
    """Return the interval of x with least <= k x <= most in all entries, where only one side may bind each."""
    if k.min() > 0.0:
        return float((least / k).max()), float((most / k).min())
    with np.errstate(all="ignore"):
        a, b = least / k, most / k
    positive, negative = k > 0.0, k < 0.0
    low = max(a[positive].max(initial=-FAR), b[negative].max(initial=-FAR))
    high = min(b[positive].min(initial=FAR), a[negative].min(initial=FAR))
    return float(low), float(high)

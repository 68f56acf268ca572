"""The time law s(t) of a profile: in each segment s-double-dot = u0 + kappa (s - s0).

The fastest profile x(s) = s-dot^2 over a grid, by reachability analysis.

Within a segment of length D the acceleration u = x' / 2 goes linearly from u0 to u1, so x1 - x0 = D (u0 + u1). A pass
from the end of the path finds, for each grid point, the interval of x from which the end can be reached; a pass
from the start takes the largest x in it that can be reached (Pham and Pham 2018, IEEE T-RO 34, with linear in place
of constant accelerations). Both ask for limits at the ends of segments only.

Where a limit's A changes its sign, the limits of u depend so steeply on x that linear accelerations would swing from
one segment to the next; there they are constant, u0 = u1 = (x1 - x0) / (2 D), which damps the swing.
"""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.fastest.limits import PLACES, Rows
from robodyn_cli.fastest.reachability import FAR, PassChain, fastest_through
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course

ROUNDING = 1e-17  # of s, what the series may lack
DEGREES = range(3, 40, 2)
SMALL = 1e-4  # y up to which artanh(sqrt y) / sqrt y is 1 + y / 3 + y^2 / 5 + y^3 / 7 to rounding


def durations(s: Array, profile: Profile) -> Array:
    """Return the times (K,) of the segments of a grid ``s`` (K + 1,).

    With the speed v in the middle of the time h of a segment v0 + v1 = 2 v cosh(r h / 2) and D = 2 v sinh(r h / 2) / r,
    r^2 = kappa, so that h = 2 artanh(r D / (v0 + v1)) / r, with arctan where kappa is negative.
    """
    D, v = np.diff(s), np.sqrt(profile.x)
    half = D / (v[:-1] + v[1:])
    y = (profile.u1 - profile.u0) / D * half * half
    r = np.sqrt(np.abs(y))
    small = np.abs(y) < SMALL
    with np.errstate(all="ignore"):
        large = np.where(y > 0.0, np.arctanh(r), np.arctan(r)) / r
    return 2.0 * half * np.where(small, 1.0 + y * (1.0 / 3.0 + y * (0.2 + y / 7.0)), large)


def time_law(s: Array, profile: Profile) -> Course:
    """Return s(t) from t = 0 over a grid ``s`` (K + 1,), as polynomials of the time since each grid point.

    The solution of s'' = u0 + kappa (s - s0) is the series with c_{i+2} = kappa c_i / ((i + 1)(i + 2)).
    """
    h = durations(s, profile)
    kappa = (profile.u1 - profile.u0) / np.diff(s)
    bend = float(np.abs(kappa * h * h).max())
    degree = next((n for n in DEGREES if bend ** ((n - 1) // 2) / math.factorial(n) < ROUNDING), DEGREES[-1])
    c = np.zeros((degree + 1, len(h)))
    c[0], c[1], c[2] = s[:-1], np.sqrt(profile.x[:-1]), 0.5 * profile.u0
    for i in range(3, degree + 1):
        c[i] = kappa * c[i - 2] / (i * (i - 1))
    return Course(np.concatenate([[0.0], np.cumsum(h)]), c[:, :, None])


STEEP = 2.0  # segments to the point where A is 0
NEAR = 0.7  # of a limit: without acceleration, from which on it counts there


class NoProfile(Exception):
    """The limits allow no motion at the grid point ``place``."""

    def __init__(self, place: int) -> None:
        super().__init__(place)
        self.place = place


@record
class Profile:
    """Squared speed x (K + 1,) at the grid points, and the acceleration at both ends of each segment (K,)."""

    x: Array
    u0: Array
    u1: Array

    def between(self, s: Array, places: tuple[float, ...] = PLACES) -> tuple[Array, Array]:
        """Return u and x (K, places) at places in each segment of the grid ``s``."""
        w = np.array(places)
        u = self.u0[:, None] + w * (self.u1 - self.u0)[:, None]
        x = self.x[:-1, None] + (np.diff(s)[:, None] * w) * (self.u0[:, None] + u)
        return u, np.maximum(x, 0.0)


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
        # what is allowed in the row's positive and negative direction
        above, below = 1.0 - margin[0], 1.0 - margin[1]
        above, below = np.where(sign > 0.0, above, below), np.where(sign > 0.0, below, above)
        with np.errstate(over="ignore"):
            found = (-below - sign * C) / size, (above - sign * C) / size, sign * B / size
        return _Ends(*(np.clip(x, -FAR, FAR) for x in found))

    def range(self, x: Array) -> tuple[Array, Array]:
        """Return the least and the largest u (K,) at x (K,)."""
        low = (self.low - self.slope * x[:, None]).max(axis=1)
        high = (self.high - self.slope * x[:, None]).min(axis=1)
        return low, high


class Passes:
    """Both passes on one grid ``s`` (K + 1,) under ``rows``, less a ``margin`` (two of (K, n), for both signs).

    x : (K, 3), about what the profile will be.
    """

    def __init__(self, s: Array, rows: Rows, margin: tuple[Array, Array], x: Array) -> None:
        self.D = np.diff(s)
        self.first, self.last = _Ends.of(rows, margin, 0), _Ends.of(rows, margin, -1)
        self.most = np.minimum(np.append(rows.most[:, 0], FAR), np.append(FAR, rows.most[:, -1]))
        A0, A1 = rows.A[:, 0], rows.A[:, -1]
        steep = np.minimum(np.abs(A0), np.abs(A1)) < STEEP * np.abs(A1 - A0)
        near = np.abs(rows.B * np.minimum(x, FAR)[..., None] + rows.C).max(axis=1) > NEAR
        self.even = (steep & near).any(axis=1)

    def run(self, start: float = 0.0, end: float = 0.0) -> Profile:
        """Return the fastest profile from x = ``start`` to x = ``end``.

        Raises
        ------
        NoProfile : there is none.
        """
        x = fastest_through(self._chain, self.most, start, end)
        if isinstance(x, int):
            raise NoProfile(x)
        mean = np.diff(x) / self.D
        (a0, b0), (a1, b1) = self.first.range(x[:-1]), self.last.range(x[1:])
        wish = self._smooth(mean)
        u0 = np.maximum(np.minimum(wish, np.minimum(b0, mean - a1)), np.maximum(a0, mean - b1))
        with np.errstate(
            all="ignore"
        ):  # where u0 < 0 < u1, the least x in between, which must not be below 0
            stops = (u0 < 0.0) & (mean > u0) & (x[:-1] * (mean - 2.0 * u0) <= self.D * u0 * u0)
        u0 = np.where(self.even | stops, 0.5 * mean, u0)
        return Profile(x, u0, mean - u0)

    def _smooth(self, mean: Array) -> Array:
        """Return u0 (K,) that differ least from those of a parabola through neighbouring points."""
        D = self.D
        at = np.empty(len(mean) + 1)
        at[1:-1] = 0.5 * (mean[:-1] * D[1:] + mean[1:] * D[:-1]) / (D[1:] + D[:-1])
        at[0], at[-1] = 0.5 * mean[0], 0.5 * mean[-1]
        return 0.5 * (mean + at[:-1] - at[1:])

    @property
    def _chain(self) -> PassChain:
        """x0 + D u0 = m = x1 - D u1; with 2 D where u is constant, x0 + 2 D u0 = x1 and x1 - 2 D u1 = x0."""
        D = (self.D * np.where(self.even, 2.0, 1.0))[:, None]
        first, last = self.first, self.last
        return PassChain(
            k0=1.0 - D * first.slope, low0=D * first.low, high0=D * first.high,
            k1=1.0 + D * last.slope, low1=-D * last.high, high1=-D * last.low,
            even=self.even,
        )  # fmt: skip

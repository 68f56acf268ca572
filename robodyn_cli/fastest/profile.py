"""The fastest profile x(s) = s-dot^2 over a grid, by reachability analysis, and its time law s(t).

Within a segment of length D the acceleration u = x' / 2 goes linearly from u0 to u1, so x1 - x0 = D (u0 + u1), and
s-double-dot = u0 + kappa (s - s0). A pass from the end of the path finds, for each grid point, the interval of x from
which the end can be reached; a pass from the start takes the largest x in it that can be reached (Pham and Pham 2018,
IEEE T-RO 34, with linear in place of constant accelerations). Both ask for limits at the ends of segments only, and
both are one compiled loop over the chain of points: in a segment between x0 and x1 every row j bounds a number m twice,

    k0_j x0 + low0_j <= m <= k0_j x0 + high0_j,    k1_j x1 + low1_j <= m <= k1_j x1 + high1_j

and some m has to be left. In an ``even`` segment the first bounds hold for x1 in place of m, the second ones for x0.

Where a limit's A changes its sign, the limits of u depend so steeply on x that linear accelerations would swing from
one segment to the next; there they are constant, u0 = u1 = (x1 - x0) / (2 D), which damps the swing.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from robodyn_cli.fastest.limits import PLACES, Rows
from robodyn_cli.kernels.arrays import Array as Numbers
from robodyn_cli.kernels.compiler import compile_module
from robodyn_cli.kernels.ir import STRICT, Condition, Function, Int, Value, module
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course

FAR = 1e30  # stands for no bound
NEWTON = 100
CROSSING = 1e-13  # of two bounds, as far as they may seem to cross
EMPTY = 1e-12  # of a bound, as far as rounding may turn an interval over
ROWS = ("k0", "low0", "high0", "k1", "low1", "high1")
ARRAYS = (*ROWS, "even", "low", "high", "x")


@record
class PassChain:
    """The rows of K segments, each (K, n), and which segments are ``even`` (K,)."""

    k0: Array
    low0: Array
    high0: Array
    k1: Array
    low1: Array
    high1: Array
    even: Array


def fastest_through(chain: PassChain, most: Array, start: float, end: float) -> Array | int:
    """Return the largest x (K + 1,) from ``start`` to ``end`` with x <= ``most``, or the point that none can pass."""
    count, n = chain.k0.shape
    low, high = np.zeros(count + 1), np.minimum(most, FAR)
    if end > high[-1]:
        return count
    low[-1] = high[-1] = end
    x = np.full(count + 1, float(start))
    arrays = [np.ascontiguousarray(getattr(chain, name), dtype=float) for name in (*ROWS, "even")]
    stopped = int(_passes()(*(a.ctypes.data for a in (*arrays, low, high, x)), count, n))
    return x if stopped < 0 else stopped


@lru_cache(maxsize=1)
def _passes() -> Callable[..., int]:
    text = write_passes()
    compiled = compile_module(f"passes {hashlib.sha256(text.encode()).hexdigest()}", lambda: text)
    types = [*[ctypes.c_void_p] * len(ARRAYS), ctypes.c_int64, ctypes.c_int64]
    return compiled.function("passes", *types, result=ctypes.c_int64)


def write_passes() -> str:
    """Return the IR of ``passes(rows..., even, low, high, x, K, n)``; -1, or the point that none can pass.

    low, high : (K + 1,), the interval of each x, which is narrowed. x : (K + 1,), the first of them given.
    """
    f = Function(
        "passes",
        [*(f"ptr noalias %{name}" for name in ARRAYS), "i64 %K", "i64 %n"],
        result="i64",
        flags=STRICT,
    )
    low, high, x = (Numbers(f, f"%{name}") for name in ("low", "high", "x"))
    count = f.int_argument("K")
    with f.count(count, down=True) as i:
        segment = _Segment(f, i)
        _narrow(f, i + 1, lambda at: segment.end("1", at))
        _narrow(f, i, lambda at: segment.end("0", at))
        _narrow(f, i, segment.ahead)
    with f.when(f.compare("olt", x[0], low[0]) | f.compare("ogt", x[0], high[0])):
        f.ret(0)
    with f.count(count) as i:
        _, most = _Segment(f, i).ahead(x[i])
        x[i + 1] = f.max(most.value, low[i + 1])
    f.ret(-1)
    return module([f])


class _Bound:
    """The tightest of many lines at x, offset + slope x."""

    def __init__(self, f: Function, x: Value, upper: bool) -> None:
        self.f, self.x, self.tighter = f, x, "olt" if upper else "ogt"
        self.slots = [f.slot() for _ in range(3)]
        far = FAR if upper else -FAR
        for slot, start in zip(self.slots, (far, 0.0, far)):
            f.store(start, slot)

    offset = property(lambda self: self.f.load(self.slots[0]))
    slope = property(lambda self: self.f.load(self.slots[1]))
    value = property(lambda self: self.f.load(self.slots[2]))

    def take(self, offset: Value, slope: Value, where: Condition | None = None) -> None:
        """Take a line, where it is allowed to count, if it is tighter."""
        f, value = self.f, offset + slope * self.x
        better = f.compare(self.tighter, value, self.value)
        better = better if where is None else better & where
        for slot, new in zip(self.slots, (offset, slope, value)):
            f.store(f.select(better, new, f.load(slot)), slot)


Bounds = tuple[_Bound, _Bound]  # lower, upper


class _Segment:
    """Code for the rows of segment ``i``."""

    def __init__(self, f: Function, i: Int) -> None:
        self.f, self.i, self.n = f, i, f.int_argument("n")
        self.rows = {name: Numbers(f, f.offset(f"%{name}", i * self.n)) for name in ROWS}
        self.even = f.compare("one", f.load(f.offset("%even", i)), 0.0)

    def end(self, which: str, x: Value) -> Bounds:
        """Return the bounds of m by the rows at one end."""
        f, (k, low, high) = self.f, (self.rows[name + which] for name in ("k", "low", "high"))
        least, most = _Bound(f, x, upper=False), _Bound(f, x, upper=True)
        with f.count(self.n) as j:
            slope = k[j]
            least.take(low[j], slope)
            most.take(high[j], slope)
        return least, most

    def ahead(self, x: Value) -> Bounds:
        """Return the bounds of x1 at x0 = x."""
        f, rows = self.f, self.rows
        zero, one = f.constant(0.0), f.constant(1.0)
        least, most = _Bound(f, x, upper=False), _Bound(f, x, upper=True)
        middle = []
        for bound, own, name in zip((least, most), self.end("0", x), ("%low", "%high")):
            bound.take(f.load(f.offset(name, self.i + 1)), zero)
            bound.take(own.offset, own.slope, self.even)
            middle.append((f.select(self.even, zero, own.offset), f.select(self.even, one, own.slope)))
        # the rows at the end hold for some number between these
        (low, low_slope), (high, high_slope) = middle
        with f.count(self.n) as j:
            k = rows["k1"][j]
            rising, counts = f.compare("ogt", k, 0.0), f.compare("one", k, 0.0)
            above, below = (high - rows["low1"][j]) / k, (low - rows["high1"][j]) / k
            steep, flat = high_slope / k, low_slope / k
            most.take(f.select(rising, above, below), f.select(rising, steep, flat), counts)
            least.take(f.select(rising, below, above), f.select(rising, flat, steep), counts)
        return least, most


def _narrow(f: Function, point: Int, bounds: Callable[[Value], Bounds]) -> None:
    """Shrink the interval of a point to where lower bounds lie below upper ones; return the point if none is left.

    The gap between the bounds is concave, so that Newton's method comes closer from outside on both sides.
    """
    low, high = (f.offset(name, point) for name in ("%low", "%high"))
    for address, inward in ((low, "ogt"), (high, "olt")):
        rounds = f.int_slot()
        f.store_int(0, rounds)
        with f.loop() as newton:
            x = f.load(address)
            least, most = bounds(x)
            size = f.abs(least.value) + f.abs(most.value)
            newton.leave(f.compare("oge", most.value - least.value, -CROSSING * size))
            root = (least.offset - most.offset) / (most.slope - least.slope)
            newton.leave(unless=f.compare(inward, root, x))
            f.store(root, address)
            newton.leave(f.compare_int("sge", f.bump(rounds), NEWTON))
    least_x, most_x = f.load(low), f.load(high)
    with f.when(f.compare("ogt", least_x, most_x * (1.0 + EMPTY))):
        f.ret(point)
    f.store(f.min(least_x, most_x), low)


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
            lines = (-below - sign * C) / size, (above - sign * C) / size, sign * B / size
        return _Ends(*(np.clip(x, -FAR, FAR) for x in lines))

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

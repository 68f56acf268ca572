"""Piecewise polynomials of time, which most trajectories are: splines of degree 5 through points, and a course close to
a motion that is known instant by instant.

Of all functions through the points with the given rates and accelerations, a spline of degree 5 has the least integral
of the squared jerk q''' (Kyriakopoulos and Saridis 1988 for one segment). Where an inner rate v is free, the
condition for the minimum is that q'''' does not jump there; where an inner acceleration a is free, that q'''
does not. So with both free the spline is C4; each given value gives up one of the two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr
from robodyn_cli.spatial.algebra import Array


class Course:
    """n functions of time: sum_i c[i, k] (t - knots[k])^i in the segment k, c (d + 1, K, n), knots (K + 1,).

    The first polynomial holds before the first knot too, the last one from the last knot on.
    """

    def __init__(self, knots: Any, c: Any) -> None:
        self.knots, self.c = np.asarray(knots, dtype=float), np.asarray(c, dtype=float)

    @property
    def duration(self) -> float:
        """Time from the first to the last knot [s]."""
        return float(self.knots[-1] - self.knots[0])

    def __call__(self, times: Any, order: int = 0) -> Array:
        """Return the functions, or their derivatives of an order, at ``times`` (T,) as (T, n)."""
        times = np.asarray(times, dtype=float)
        k = np.clip(np.searchsorted(self.knots, times, side="right") - 1, 0, len(self.knots) - 2)
        return _horner([row[k] for row in self.derivative(order).c], (times - self.knots[k])[:, None])

    def expressions(self, t: Expr) -> list[Any]:
        """Return the functions (n,) as expressions of t."""
        knots = tuple(self.knots.tolist())
        rows = [tuple(map(tuple, column.tolist())) for column in np.moveaxis(self.c, 2, 0)]
        return [t.graph.piecewise(t, knots, row) for row in rows]

    def derivative(self, order: int = 1) -> Course:
        """Return the derivative of an order."""
        c = self.c
        for _ in range(order):
            c = np.arange(1, len(c))[:, None, None] * c[1:] if len(c) > 1 else 0.0 * c
        return Course(self.knots, c)

    def stretched(self, duration: float) -> Course:
        """Return the same course, from time 0, in another time."""
        factor = duration / self.duration
        powers = factor ** -np.arange(len(self.c))
        knots = factor * (self.knots - self.knots[0])
        knots[-1] = duration
        return Course(knots, self.c * powers[:, None, None])

    def shifted(self, time: float) -> Course:
        """Return the course begun later by ``time``."""
        return Course(self.knots + time, self.c)

    def at_rest_outside(self) -> Course:
        """Return the course held at its ends: before its first and after its last knot."""
        first, last = self([self.knots[0]])[0], self([self.knots[-1]])[0]
        c = np.zeros((len(self.c), self.c.shape[1] + 2, self.c.shape[2]))
        c[:, 1:-1], c[0, 0], c[0, -1] = self.c, first, last
        return Course([self.knots[0] - 1.0, *self.knots, self.knots[-1] + 1.0], c)

    def refined(self, knots: Array) -> Course:
        """Return the same functions with other ``knots``, among which are all of its own between the first and last."""
        middle = 0.5 * (knots[1:] + knots[:-1])
        k = np.clip(np.searchsorted(self.knots, middle, side="right") - 1, 0, len(self.knots) - 2)
        step = (knots[:-1] - self.knots[k])[:, None]
        rows, factorial = [], 1.0
        for i in range(len(self.c)):
            rows.append(_horner(self.derivative(i).c[:, k], step) / factorial)
            factorial *= i + 1
        return Course(knots, rows)

    def largest(self, order: int) -> Array:
        """Return the largest magnitude (n,) of the derivatives of an order between the first and the last knot."""
        c, h = self.derivative(order).c, np.diff(self.knots)[:, None]
        largest = np.maximum(np.abs(c[0]), np.abs(_horner(c, h)))
        for k in range(
            1, len(c) - 1
        ):  # turning points: all of a parabola's, those of higher degrees one by one
            if len(c) == 3:
                with np.errstate(all="ignore"):
                    turning = np.nan_to_num(-0.5 * c[1] / c[2], posinf=0.0, neginf=0.0)
            else:
                turning = self._turning_points(c, k)
            largest = np.maximum(largest, np.abs(_horner(c, np.clip(turning, 0.0, h))))
        return np.asarray(largest.max(axis=0))

    @staticmethod
    def _turning_points(c: Array, k: int) -> Array:
        """Return the k-th zero (K, n) of the slope of each polynomial, 0 where there is none."""
        turning = np.zeros(c.shape[1:])
        for i, j in np.ndindex(*turning.shape):
            slope = np.polynomial.Polynomial(c[:, i, j]).deriv().trim()
            zeros = slope.roots() if slope.degree() else np.zeros(0)
            real = zeros.real[zeros.imag == 0.0]
            turning[i, j] = real[k - 1] if len(real) >= k else 0.0
        return turning


def _horner(c: Sequence[Array] | Array, s: Array) -> Array:
    y = c[-1]
    for row in c[-2::-1]:
        y = y * s + row
    return np.asarray(y)


def one_after_another(courses: Sequence[Course]) -> Course:
    """Return courses of the same functions chained: each begins when the one before it ends."""
    degree = max(len(course.c) for course in courses)
    knots, parts = [courses[0].knots[:1]], []
    for course in courses:
        knots.append(knots[-1][-1] + course.knots[1:] - course.knots[0])
        parts.append(np.concatenate([course.c, np.zeros((degree - len(course.c), *course.c.shape[1:]))]))
    return Course(np.concatenate(knots), np.concatenate(parts, axis=1))


def held(values: Any, duration: float) -> Course:
    """Return constant functions with ``values`` (n,)."""
    return Course([0.0, duration], np.asarray(values, dtype=float)[None, None])


def hermite_cubic(t: Array, q: Array, v: Array) -> Course:
    """Return the cubics through ``q`` (N, n) with the rates ``v`` (N, n) at the times ``t`` (N,)."""
    h = np.diff(t)[:, None]
    slope = np.diff(q, axis=0) / h
    return Course(
        t, [q[:-1], v[:-1], (3.0 * slope - 2.0 * v[:-1] - v[1:]) / h, (v[:-1] + v[1:] - 2.0 * slope) / h**2]
    )


Ends = tuple[Array, Array, Array]

# (c3, c4, c5) of the quintic on [0, 1] from (q0, v0, a0, q1, v1, a1)
_COEFFICIENTS = np.array(
    [
        [-10.0, -6.0, -1.5, 10.0, -4.0, 0.5],
        [15.0, 8.0, 1.5, -15.0, 7.0, -1.0],
        [-6.0, -3.0, -0.5, 6.0, -3.0, 0.5],
    ]
)
_BY_ENDS = _COEFFICIENTS[:, [1, 2, 3, 4, 5]]  # from (v0, a0, q1 - q0, v1, a1)
# integral over [0, 1] of the square of 6 c3 + 24 c4 s + 60 c5 s^2, as a quadratic form
_SQUARED_JERK = np.array([[36.0, 72.0, 120.0], [72.0, 192.0, 360.0], [120.0, 360.0, 720.0]])
_ENERGY = _COEFFICIENTS.T @ _SQUARED_JERK @ _COEFFICIENTS


def hermite(h: Any, start: Ends, end: Ends) -> Array:
    """Return the coefficients (6, ...) in s = (t - t0) / h of the quintic with (q, v, a) at its start and its end."""
    (q0, v0, a0), (q1, v1, a1) = start, end
    # by the way between the ends: what stays where it is stays there without rounding
    ends = np.array([h * v0, h * h * a0, q1 - q0, h * v1, h * h * a1])
    return np.array([q0, ends[0], 0.5 * ends[1], *np.tensordot(_BY_ENDS, ends, 1)])


def between(ends: tuple[Ends, Ends], h: float, s: float) -> tuple[Array, Array]:
    """Return the value at part s of an interval by the quintic with (q, v, a) at its ends, and its estimated error: how
    far the cubic with the same positions and rates is away, s^2 (1 - s)^2 (c4 + (s + 2) c5).
    """
    c = hermite(h, *ends)
    value = ends[1][0] if s == 1.0 else _horner(c, np.asarray(s))
    return value, np.abs((s * (1.0 - s)) ** 2 * (c[4] + (s + 2.0) * c[5]))


def course_through(t: Array, q: Array, v: Array, a: tuple[Array, Array]) -> Course:
    """Return the quintics through positions and rates (N, n) at the times ``t`` (N,).

    a : accelerations (N, n) behind and before each time, where they may jump.
    """
    h = np.diff(t)[:, None]
    c = hermite(h, (q[:-1], v[:-1], a[0][:-1]), (q[1:], v[1:], a[1][1:]))
    return Course(t, c / h ** np.arange(6.0)[:, None, None])


class QuinticSpline:
    """Quintic spline of n functions through N points.

    Parameters
    ----------
    t : (N,) increasing. q : (N, n).
    v, a : (N, n) first and second derivatives, NaN where they are free; one row is given or free as a whole,
        and the first and the last row are given.
    """

    def __init__(self, t: Array, q: Array, v: Array, a: Array) -> None:
        self.t = t
        x = _least_jerk(np.diff(t), q, np.stack([v, a], axis=1))
        ends = (q[:-1], x[:-1, 0], x[:-1, 1]), (q[1:], x[1:, 0], x[1:, 1])
        self.c = hermite(np.diff(t)[:, None], *ends)  # (6, N - 1, n)

    def __call__(self, times: Array) -> tuple[Array, Array, Array]:
        """Return values and first and second derivatives (T, n) in column order."""
        k = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        h = (self.t[k + 1] - self.t[k])[:, None]
        s = (times[:, None] - self.t[k][:, None]) / h
        c = self.c[:, k]
        q = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * (c[4] + s * c[5]))))
        qd = c[1] + s * (2 * c[2] + s * (3 * c[3] + s * (4 * c[4] + s * (5 * c[5]))))
        qdd = 2 * c[2] + s * (6 * c[3] + s * (12 * c[4] + s * (20 * c[5])))
        return np.asfortranarray(q), np.asfortranarray(qd / h), np.asfortranarray(qdd / h**2)


def _least_jerk(h: Array, q: Array, given: Array) -> Array:
    """Return derivatives (N, 2, n) at the points: those given, the free ones where the squared jerk is least.

    The minimum is a symmetric positive definite system, block tridiagonal in the pairs (v_i, a_i); it is
    solved by block elimination, which needs no pivoting.
    """
    N, n = q.shape
    free = np.isnan(given).any(axis=2)
    x = np.where(np.isnan(given), 0.0, given)
    if not free.any():
        return x
    diagonal, upper, right = np.zeros((N, 2, 2)), np.zeros((N, 2, 2)), np.zeros((N, 2, n))
    for i, step in enumerate(h):
        # the integral over a segment in terms of (q, v, a) at its ends: lengths scale as (1, h, h^2), jerk^2
        # as h^-5
        scale = np.array([1.0, step, step**2, 1.0, step, step**2])
        K = _ENERGY * np.outer(scale, scale) / step**5
        known = K @ np.concatenate([q[i, None], x[i], q[i + 1, None], x[i + 1]])
        diagonal[i] += K[1:3, 1:3]
        diagonal[i + 1] += K[4:6, 4:6]
        upper[i] = K[1:3, 4:6]
        right[i] -= known[1:3]
        right[i + 1] -= known[4:6]
    for i, j in np.argwhere(~free):
        diagonal[i, j, :] = diagonal[i, :, j] = 0.0
        diagonal[i, j, j] = 1.0
        right[i, j] = 0.0
        upper[i, j, :] = 0.0
        if i:
            upper[i - 1, :, j] = 0.0
    for i in range(1, N):
        carry = np.linalg.solve(diagonal[i - 1], upper[i - 1]).T
        diagonal[i] -= carry @ upper[i - 1]
        right[i] -= carry @ right[i - 1]
    step = np.linalg.solve(diagonal[-1], right[-1])
    x[-1] += step
    for i in reversed(range(N - 1)):
        step = np.linalg.solve(diagonal[i], right[i] - upper[i] @ step)
        x[i] += step
    return x


FIRST = 32  # intervals of the first look
MOST = 20_000  # points
WITHIN = 1e-11  # rad or m: how far the course may be from the motion
ACCELERATION = 1e-8  # of the largest one: how far its accelerations may be
PARTS = 8  # into which an interval is divided at once
ROUNDING = 256 * np.finfo(float).eps  # of a position: over h^2, what it may make of an acceleration
BESIDE = 1e-9  # of the duration: where accelerations are taken on both sides of a knot
SHORT = 1e-6  # of the duration: in an interval so short an acceleration may jump, but no rate

Motion = Callable[[Array], tuple[Array, Array, Array]]


def interpolated(motion: Motion, duration: float, knots: Sequence[float] | None, title: str) -> Course:
    """Return quintics through positions, rates and accelerations, which are close to the motion between them too.

    Intervals are divided until the course meets the motion half-way: positions to 1e-11, accelerations to 1e-8 of the
    largest, or to what the rounding of positions makes of them in a short interval.

    Parameters
    ----------
    motion : times (T,), increasing, to positions, rates and accelerations (T, n). knots : times at which accelerations
    may jump, None where there are none known. what : the motion in words, for the error.

    Raises
    ------
    CapabilityError : rates jump on the way.
    """
    T = duration
    inside = np.array([x for x in knots or () if 0.0 < x < T])
    t = np.unique(np.concatenate([np.linspace(0.0, T, FIRST + 1), inside]))
    while True:
        h, middle = np.diff(t), 0.5 * (t[1:] + t[:-1])
        times = np.unique(np.concatenate([t, middle, inside - BESIDE * T, inside + BESIDE * T]))
        q, v, a = motion(times)
        at, between = np.searchsorted(times, t), np.searchsorted(times, middle)
        jumps = np.isin(t, inside)
        course = course_through(t, q[at], v[at], (a[at + jumps], a[at - jumps]))
        off = np.abs(course(middle) - q[between]).max(axis=1) / WITHIN
        largest = max(float(np.abs(a).max()), 1e-300)
        rough = np.abs(course(middle, 2) - a[between]).max(axis=1)
        rough /= ACCELERATION * largest + ROUNDING * np.abs(q).max() / (h * h)
        need = np.maximum(off ** (1.0 / 6.0), np.where(h > SHORT * T, rough**0.25, 0.0))
        if need.max() <= 1.0:
            return course
        if len(t) > MOST or h[need > 1.0].min() <= SHORT * T:
            break
        t = divided(t, np.clip(np.ceil(need), 1.0, PARTS))
    where = float(middle[need > 1.0][np.argmin(h[need > 1.0])])
    raise CapabilityError(
        f"{title} is not smooth at t = {where:.6g} s, so that no torque lets a simulation follow it; smooth the path "
        "there, or let it come to a stop",
        time=where,
    )


def divided(s: Array, parts: Array) -> Array:
    """Return a grid (K + 1,) with each interval divided into so many equal ``parts`` (K,)."""
    count = parts.astype(int)
    place = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)) / count[place]
    return np.append(s[place] + np.diff(s)[place] * share, s[-1])

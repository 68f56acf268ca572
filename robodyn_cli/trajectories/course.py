"""Piecewise polynomials of time, which most trajectories are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

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
        found = np.maximum(np.abs(c[0]), np.abs(_horner(c, h)))
        for k in range(
            1, len(c) - 1
        ):  # turning points: all of a parabola's, those of higher degrees one by one
            if len(c) == 3:
                with np.errstate(all="ignore"):
                    turning = np.nan_to_num(-0.5 * c[1] / c[2], posinf=0.0, neginf=0.0)
            else:
                turning = self._turning_points(c, k)
            found = np.maximum(found, np.abs(_horner(c, np.clip(turning, 0.0, h))))
        return np.asarray(found.max(axis=0))

    @staticmethod
    def _turning_points(c: Array, k: int) -> Array:
        """Return the k-th zero (K, n) of the slope of each polynomial, 0 where there is none."""
        found = np.zeros(c.shape[1:])
        for i, j in np.ndindex(*found.shape):
            slope = np.polynomial.Polynomial(c[:, i, j]).deriv().trim()
            zeros = slope.roots() if slope.degree() else np.zeros(0)
            real = zeros.real[zeros.imag == 0.0]
            found[i, j] = real[k - 1] if len(real) >= k else 0.0
        return found


def _horner(c: Sequence[Array] | Array, s: Array) -> Array:
    found = c[-1]
    for row in c[-2::-1]:
        found = found * s + row
    return np.asarray(found)


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

"""Curves in space by their arc length, as Taylor series at any place (see ``taylor``)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.task import taylor

ORDER = 4  # of the series of positions: tangents have one less, and jerks need three
FIT = 1e-12  # of the whole: how far the parameter may be off at an arc length
MOST = 16  # doublings of the pieces in which it is fitted
STILL = 1e-12  # m: no way at all


class Curve(Protocol):
    """A curve of a ``length`` [m]; its curvature jumps at no place inside but at ``knots``."""

    length: float
    knots: tuple[float, ...]

    def at(self, s: Array) -> Array:
        """Return the series (ORDER + 1, T, 3) of the position [m] at arc lengths (T,)."""
        ...


class Line:
    """The straight line from one point to another."""

    knots: tuple[float, ...] = ()

    def __init__(self, start: Array, end: Array) -> None:
        self.start, self.length = start, float(np.linalg.norm(end - start))
        self.direction = (end - start) / max(self.length, STILL)

    def at(self, s: Array) -> Array:
        found = np.zeros((ORDER + 1, len(s), 3))
        found[0] = self.start + s[:, None] * self.direction
        found[1] = self.direction
        return found

    def part(self, first: float, last: float) -> Line:
        """Return the line between two arc lengths."""
        return Line(self.start + first * self.direction, self.start + last * self.direction)


class Arc:
    """A part of a circle: from ``start`` about ``center`` by ``angle``, right-handed about ``normal`` (unit)."""

    knots: tuple[float, ...] = ()

    def __init__(self, start: Array, center: Array, normal: Array, angle: float) -> None:
        self.center, self.u = center, start - center
        self.v = math.copysign(1.0, angle) * np.cross(normal, self.u)
        self.radius = float(np.linalg.norm(self.u))
        self.length = abs(angle) * self.radius

    def at(self, s: Array) -> Array:
        phi = (s / self.radius)[:, None]
        found = np.empty((ORDER + 1, len(s), 3))
        for i in range(ORDER + 1):
            angle, factor = phi + 0.5 * math.pi * i, self.radius**-i / math.factorial(i)
            found[i] = factor * (np.cos(angle) * self.u + np.sin(angle) * self.v)
        found[0] += self.center
        return found


class Parametric:
    """A curve c(u), 0 <= u <= span, whose parameter at an arc length is fitted by quintics.

    Positions are those of the curve exactly; |dp/ds| is 1 to the accuracy of the fit.

    Parameters
    ----------
    curve : the series (ORDER + 1, T, 3) of c at u (T,). breaks : where c is not smooth, and its ends.

    Raises
    ------
    ValueError : the curve stands still somewhere.
    """

    def __init__(self, curve: Callable[[Array], Array], breaks: Sequence[float]) -> None:
        self.curve = curve
        for doublings in range(2, MOST):
            u = np.unique(
                np.concatenate([np.linspace(a, b, 2**doublings + 1) for a, b in zip(breaks, breaks[1:])])
            )
            self.parameter = self._fitted(u)
            middle = 0.5 * (u[1:] + u[:-1])
            s = self.parameter.knots[:-1] + self._lengths(u[:-1], middle)
            if np.abs(self.parameter(s)[:, 0] - middle).max() <= FIT * (breaks[-1] - breaks[0]):
                break
        self.length = float(self.parameter.knots[-1])
        self.knots = tuple(self.parameter.knots[np.searchsorted(u, breaks[1:-1])].tolist())

    def _fitted(self, u: Array) -> Course:
        """Return u as quintics of the arc length, between places u (N,)."""
        from robodyn_cli.trajectories.course import hermite

        c = self.curve(u)
        first, second = c[1], 2.0 * c[2]
        speed = np.linalg.norm(first, axis=1)
        if not (np.isfinite(speed).all() and speed.min() > 1e-9 * max(speed.max(), STILL)):
            raise ValueError(
                f"the path stands still, or is not finite, at {u[np.argmin(np.nan_to_num(speed))]:.6g}"
            )
        s = np.concatenate([[0.0], np.cumsum(self._lengths(u[:-1], u[1:]))])
        ends = np.stack([u, 1.0 / speed, -np.sum(first * second, axis=1) / speed**4])[:, :, None]
        h = np.diff(s)[:, None]
        rows = hermite(h, tuple(ends[:, :-1]), tuple(ends[:, 1:]))
        return Course(s, rows * h[None] ** -np.arange(6.0)[:, None, None])

    def _lengths(self, a: Array, b: Array) -> Array:
        """Return the lengths between parameters a and b (N,) by Gauss's rule of order 20."""
        x, w = np.polynomial.legendre.leggauss(10)
        half = 0.5 * (b - a)
        places = (0.5 * (a + b) + half * x[:, None]).ravel()
        speed = np.linalg.norm(self.curve(places)[1], axis=1).reshape(len(x), -1)
        return np.asarray(half * (w @ speed))

    def at(self, s: Array) -> Array:
        u = series_of(self.parameter, s)[..., 0]
        return taylor.composed(self.curve(u[0]), u)


def series_of(course: Course, x: Array, order: int = ORDER) -> Array:
    """Return the series (order + 1, T, n) of piecewise polynomials at x (T,)."""
    return np.array([course(x, i) / math.factorial(i) for i in range(order + 1)])


def spline(points: Array) -> Parametric:
    """Return the cubic spline through points (N, 3), by the lengths of its chords."""
    from scipy.interpolate import CubicSpline  # takes long to import: only where it is used

    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    course = Course(knots, CubicSpline(knots, points).c[::-1])
    return Parametric(lambda u: series_of(course, u), knots.tolist())


def blend(before: Line, after: Line, distance: float) -> Parametric:
    """Return the rounded corner between two lines, from ``distance`` before it to as far behind it.

    A polynomial of degree 5 whose direction and curvature are those of the lines at both ends. Its speed there keeps
    the curvature and its rate low: of a right angle 1.5 / distance and 3.4 / distance^2.
    """
    from robodyn_cli.trajectories.course import hermite

    corner, rest = after.start, np.zeros(3)
    half = math.sqrt(
        max(0.5 * (1.0 + float(before.direction @ after.direction)), 0.0)
    )  # cosine of half the turn
    speed = (0.8 + 1.3 * half) * distance
    first = (corner - distance * before.direction, speed * before.direction, rest)
    last = (corner + distance * after.direction, speed * after.direction, rest)
    course = Course([0.0, 1.0], hermite(1.0, first, last)[:, None])
    return Parametric(lambda u: series_of(course, u), [0.0, 1.0])

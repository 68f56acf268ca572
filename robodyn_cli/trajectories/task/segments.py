"""The segments of a path, each from where the one before it ends: curves in space by their arc length, as Taylor series
at any place (see ``taylor``)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.registry import Registry
from robodyn_cli.schema.fields import (
    Choice,
    Direction,
    ListOf,
    Number,
    Orientation,
    Section,
    Vector,
    key,
    like,
)
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course, hermite
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
        series = np.zeros((ORDER + 1, len(s), 3))
        series[0] = self.start + s[:, None] * self.direction
        series[1] = self.direction
        return series

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
        series = np.empty((ORDER + 1, len(s), 3))
        for i in range(ORDER + 1):
            angle, factor = phi + 0.5 * math.pi * i, self.radius**-i / math.factorial(i)
            series[i] = factor * (np.cos(angle) * self.u + np.sin(angle) * self.v)
        series[0] += self.center
        return series


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
    return Parametric(partial(series_of, course), knots.tolist())


def blend(before: Line, after: Line, distance: float) -> Parametric:
    """Return the rounded corner between two lines, from ``distance`` before it to as far behind it.

    A polynomial of degree 5 whose direction and curvature are those of the lines at both ends. Its speed there keeps
    the curvature and its rate low: of a right angle 1.5 / distance and 3.4 / distance^2.
    """
    corner, rest = after.start, np.zeros(3)
    half = math.sqrt(
        max(0.5 * (1.0 + float(before.direction @ after.direction)), 0.0)
    )  # cosine of half the turn
    speed = (0.8 + 1.3 * half) * distance
    first = (corner - distance * before.direction, speed * before.direction, rest)
    last = (corner + distance * after.direction, speed * after.direction, rest)
    course = Course([0.0, 1.0], hermite(1.0, first, last)[:, None])
    return Parametric(partial(series_of, course), [0.0, 1.0])


ON_CIRCLE = 1e-9  # of the radius
NEAR = 1e-12  # of the longest chord of a spline: nearer points are the same
FARTHEST = 1e12  # m: so far away positions have four digits behind the point left
BEYOND = f"is too far away for positions to keep their digits; allowed: up to {FARTHEST:g} m"


class PathProblem(ValueError):
    """What is wrong with a path, and at which key below the trajectory."""

    def __init__(self, path: tuple[str | int, ...], message: str) -> None:
        super().__init__(message)
        self.path = path


@record
class Arrival:
    """What every segment says about its end."""

    orientation: Orientation | None = key(
        Section(Orientation),
        default=None,
        doc="How the frame is turned at the end of the segment; by default as at its start.",
    )
    dwell: float = key(Number(minimum=0.0), default=0.0, unit="s", doc="Time at rest at the end.")
    duration: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="s",
        doc="Time of the way since the last stop; by default as short as the limits allow.",
    )
    blend: float | None = key(
        Number(minimum=0.0),
        default=None,
        unit="m",
        doc="The frame goes on without a stop. Between two lines the corner is rounded, from this distance before it "
        "to as far behind it; 0: the next segment begins in the direction in which this one ends.",
    )


class PathSegment:
    """What every segment answers; ``orientations`` : how the frame is turned at each of its points."""

    orientations: tuple[Orientation, ...] = ()


@record
class LineSegment(PathSegment):
    """A straight line; without a way, a turn in place."""

    type: str = key(Choice(("line",)), doc="Kind of segment.")
    to: tuple[float, ...] = key(Vector(3), unit="m", doc="Where it ends.")
    orientation: Orientation | None = like(Arrival, "orientation")
    dwell: float = like(Arrival, "dwell")
    duration: float | None = like(Arrival, "duration")
    blend: float | None = like(Arrival, "blend")

    def curve(self, start: Array) -> Curve:
        """Return the curve from ``start`` (3,)."""
        return Line(start, np.array(self.to))


@record
class ArcSegment(PathSegment):
    """An arc of a circle through a point."""

    type: str = key(Choice(("arc",)), doc="Kind of segment.")
    via: tuple[float, ...] = key(Vector(3), unit="m", doc="A point between the ends of the arc.")
    to: tuple[float, ...] = key(Vector(3), unit="m", doc="Where it ends.")
    orientation: Orientation | None = like(Arrival, "orientation")
    dwell: float = like(Arrival, "dwell")
    duration: float | None = like(Arrival, "duration")
    blend: float | None = like(Arrival, "blend")

    def curve(self, start: Array) -> Curve:
        """Return the curve from ``start`` (3,).

        Raises
        ------
        PathProblem : the three points lie on a line.
        """
        a, b = np.array(self.via) - start, np.array(self.to) - start
        n = np.cross(a, b)
        if np.linalg.norm(n) <= 1e-9 * max(np.linalg.norm(a), np.linalg.norm(b)) ** 2:
            raise PathProblem(
                ("via",),
                f"lies on one line with both ends (value {list(self.via)}); allowed: a point beside it",
            )
        center = np.cross((a @ a) * b - (b @ b) * a, n) / (2.0 * (n @ n))
        n = n / np.linalg.norm(n)
        u, end = -center, b - center
        angle = math.atan2(n @ np.cross(u, end), u @ end) % (2.0 * math.pi)
        return Arc(start, start + center, n, angle)


@record
class CircleSegment(PathSegment):
    """A circle, or a part of one, about a centre, in any plane."""

    type: str = key(Choice(("circle",)), doc="Kind of segment.")
    center: tuple[float, ...] = key(Vector(3), unit="m", doc="Centre.")
    normal: tuple[float, ...] = key(
        Direction(), default=(0.0, 0.0, 1.0), unit="1", doc="Normal of its plane, about which it turns."
    )
    angle: float = key(
        Number(), default=2.0 * math.pi, unit="rad", doc="How far; negative: the other way round."
    )
    orientation: Orientation | None = like(Arrival, "orientation")
    dwell: float = like(Arrival, "dwell")
    duration: float | None = like(Arrival, "duration")
    blend: float | None = like(Arrival, "blend")

    def curve(self, start: Array) -> Curve:
        """Return the curve from ``start`` (3,).

        Raises
        ------
        PathProblem : the start is the centre or beside the circle's plane, or no angle.
        """
        center, n = np.array(self.center), np.array(self.normal) / math.hypot(*self.normal)
        u = start - center
        radius, height = float(np.linalg.norm(u)), float(u @ n)
        if radius <= STILL or abs(height) > ON_CIRCLE * radius:
            fault = (
                "is where the segment begins"
                if radius <= STILL
                else f"is {abs(height):.3g} m beside the plane"
            )
            raise PathProblem(
                ("center",), f"{fault} (value {list(self.center)}); allowed: a point of the circle's plane"
            )
        if self.angle == 0.0:
            raise PathProblem(("angle",), "must not be zero")
        return Arc(start, center, n, self.angle)


@record
class SplineSegment(PathSegment):
    """The cubic spline through points."""

    type: str = key(Choice(("spline",)), doc="Kind of segment.")
    through: tuple[tuple[float, ...], ...] = key(
        ListOf(Vector(3), minimum=2), unit="m", doc="Points that it passes; the last one is its end."
    )
    orientations: tuple[Orientation, ...] = key(
        ListOf(Section(Orientation)),
        default=(),
        doc="How the frame is turned at each of these points; between them it turns smoothly.",
    )
    orientation: Orientation | None = like(Arrival, "orientation")
    dwell: float = like(Arrival, "dwell")
    duration: float | None = like(Arrival, "duration")
    blend: float | None = like(Arrival, "blend")

    def curve(self, start: Array) -> Curve:
        """Return the curve from ``start`` (3,).

        Raises
        ------
        PathProblem : two points one after another are the same.
        """
        points = np.array([start, *self.through])
        chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
        far = np.flatnonzero(~(chords < FARTHEST))
        if far.size:
            raise PathProblem(("through", int(far[0])), BEYOND)
        same = np.flatnonzero(chords <= max(STILL, NEAR * float(chords.max())))
        if same.size:
            fault = (
                "is the point before it, but for rounding" if chords[same[0]] else "is the point before it"
            )
            raise PathProblem(("through", int(same[0])), f"{fault}; allowed: another one")
        try:
            return spline(points)
        except ValueError as problem:
            raise PathProblem(("through",), str(problem)) from None


segment_types: Registry[Any] = Registry(
    "robodyn_cli.trajectories.task",
    {
        "line": "segments:LineSegment",
        "arc": "segments:ArcSegment",
        "circle": "segments:CircleSegment",
        "spline": "segments:SplineSegment",
    },
)

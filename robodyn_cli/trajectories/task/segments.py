"""The segments of a path: a curve in space each, from where the one before it ends."""

from __future__ import annotations

import math
from typing import Any

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
from robodyn_cli.trajectories.task.curves import STILL, Arc, Curve, Line, spline

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
        Number(angle=True), default=2.0 * math.pi, unit="rad", doc="How far; negative: the other way round."
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
            what = (
                "is where the segment begins"
                if radius <= STILL
                else f"is {abs(height):.3g} m beside the plane"
            )
            raise PathProblem(
                ("center",), f"{what} (value {list(self.center)}); allowed: a point of the circle's plane"
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
            what = "is the point before it, but for rounding" if chords[same[0]] else "is the point before it"
            raise PathProblem(("through", int(same[0])), f"{what}; allowed: another one")
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

"""Motion of the joints through way points at given times: cubic, quintic or without overshoot between them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, JointMap, ListOf, Number, Section, key
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import (
    Problems,
    SceneNames,
    joint_problems,
    position_problems,
    time_problems,
)
from robodyn_cli.trajectories.course import Course, QuinticSpline, held, hermite_cubic, one_after_another
from robodyn_cli.trajectories.joint_space import CourseTrajectory, column_rates, the_shorter_way


@record
class WayPoint:
    """A time and what the joints do there."""

    t: float = key(Number(minimum=0.0), unit="s", doc="Time, of arrival where the joints wait.")
    q: dict[str, float] = key(JointMap(Number()), unit="rad or m", doc="Positions of all joints.")
    qd: dict[str, float] = key(
        JointMap(Number(), coordinates="v"),
        default=None,
        unit="rad/s or m/s",
        doc="Rates of all joints.",
    )
    qdd: dict[str, float] = key(
        JointMap(Number(), coordinates="v"),
        default=None,
        unit="rad/s^2 or m/s^2",
        doc="Accelerations of all joints; with `quintic` only.",
    )
    dwell: float | None = key(
        Number(minimum=0.0),
        default=None,
        unit="s",
        doc="Time at rest there; 0 stops without waiting. Without it the joints pass through.",
    )


@record
class _Stretch:
    """Way points between two stops: times (N,), positions (N, n), rates and accelerations, NaN where they are free."""

    t: Array
    q: Array
    v: Array
    a: Array


@record
class WayPoints(CourseTrajectory):
    """What motions through way points share. The duration is the time of the last one, and its dwell."""

    type: str
    points: tuple[WayPoint, ...] = key(ListOf(Section(WayPoint), minimum=2), doc="Way points, times from 0.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        needed = tuple(self.points[0].q) if scene.some else scene.columns
        for k, point in enumerate(self.points):
            yield from position_problems(point.q, scene, ("points", k, "q"), needed)
            for name in ("qd", "qdd"):
                yield from self._rate_problems(name, k, needed, scene)
            if point.qdd and self.type != "quintic":
                yield (
                    ("points", k, "qdd"),
                    f"{self.type} has no accelerations to choose; they go with type: quintic",
                )
        yield from time_problems(
            [p.t for p in self.points], [("points", k, "t") for k in range(len(self.points))]
        )
        for k, (point, after) in enumerate(zip(self.points, self.points[1:])):
            left = after.t - point.t
            if point.dwell and point.dwell >= left > 0.0:
                fault = f"no time is left to reach the next way point at t = {after.t:g} s"
                yield ("points", k, "dwell"), f"{fault}; allowed: less than {left:.6g} s"

    def _rate_problems(self, name: str, k: int, columns: tuple[str, ...], scene: SceneNames) -> Problems:
        given, point = getattr(self.points[k], name), self.points[k]
        joints = {column.partition(".")[0] for column in columns}
        needed = [
            x
            for x in scene.rates
            if x in columns or (x.partition(".")[0] in joints and x not in scene.joints)
        ]
        if given:
            yield from joint_problems(tuple(given), scene.rates, ("points", k, name), needed)
        if given and point.dwell is not None and any(given.values()):
            yield ("points", k, name), "does not go with 'dwell': the joints are at rest there"

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(self.points[0].q)

    @property
    def duration(self) -> float:
        """Time of the last way point, and of its dwell [s]."""
        return self.points[-1].t + (self.points[-1].dwell or 0.0)

    def make_course(self) -> Course:
        q = the_shorter_way(self.joints, np.array([[p.q[name] for name in self.joints] for p in self.points]))
        parts: list[Course] = []
        for stretch, place in self._stretches(q):
            if len(stretch.t) > 1:
                parts.append(self.between(stretch))
            if self.points[place].dwell:
                parts.append(held(q[place], self.points[place].dwell or 0.0))
        return one_after_another(parts)

    def _stretches(self, q: Array) -> Iterator[tuple[_Stretch, int]]:
        """Yield the way points from one stop to the next, and the place of the stop that ends them."""
        first = 0
        for k, point in enumerate(self.points):
            if k == len(self.points) - 1 or point.dwell is not None:
                places = range(first, k + 1)
                t = np.array([self.points[i].t for i in places])
                t[0] += (self.points[first].dwell or 0.0) if k > first else 0.0
                v, a = (np.array(rows) for rows in zip(*(self._rates(i, q[i]) for i in places)))
                yield _Stretch(t, q[first : k + 1], v, a), k
                first = k

    def _rates(self, k: int, q: Array) -> tuple[Array, Array]:
        """Return the rates and accelerations of the columns of q at a way point, NaN where they are free."""
        point, free = self.points[k], np.full(len(q), np.nan)
        stop = k in (0, len(self.points) - 1) or point.dwell is not None
        v = column_rates(self.joints, q, point.qd) if point.qd or stop else free
        if not point.qdd and not stop:
            return v, free
        known = np.nan_to_num(v)
        return v, column_rates(self.joints, q, point.qdd, known)

    def between(self, stretch: _Stretch) -> Course:
        """Return the course through the way points of a stretch."""
        raise NotImplementedError


@record
class QuinticTrajectory(WayPoints):
    """Quintic polynomials through way points.

    Rates and accelerations at the first and the last point, and where the joints wait, are zero unless they are given.
    At an inner point they are kept where given and otherwise chosen so that the jerk is least, which makes the motion
    four times continuously differentiable there.
    """

    type: str = key(Choice(("quintic",)), doc="Kind of trajectory.")

    def between(self, stretch: _Stretch) -> Course:
        spline = QuinticSpline(stretch.t, stretch.q, stretch.v, stretch.a)
        powers = np.diff(stretch.t)[:, None] ** -np.arange(6.0)[:, None, None]
        return Course(stretch.t, spline.c * powers)


@record
class CubicTrajectory(WayPoints):
    """Cubic polynomials through way points, with continuous rates and accelerations at those passed through.

    Where a rate is given, at the ends and where the joints wait, the acceleration jumps.
    """

    type: str = key(Choice(("cubic",)), doc="Kind of trajectory.")

    def between(self, stretch: _Stretch) -> Course:
        given = np.flatnonzero(~np.isnan(stretch.v).any(axis=1))
        v = stretch.v.copy()
        for first, last in zip(given, given[1:]):
            places = slice(first, last + 1)
            v[places] = _clamped_rates(stretch.t[places], stretch.q[places], v[first], v[last])
        return hermite_cubic(stretch.t, stretch.q, v)


@record
class MonotoneTrajectory(WayPoints):
    """Cubic polynomials through way points that never leave the range of two neighbours: no overshoot.

    The rates are those of PCHIP (Fritsch and Butland 1984), zero at the ends and where the joints wait; the
    acceleration jumps at every way point.
    """

    type: str = key(Choice(("monotone",)), doc="Kind of trajectory.")

    def between(self, stretch: _Stretch) -> Course:
        v = monotone_rates(stretch.t, stretch.q)
        return hermite_cubic(stretch.t, stretch.q, np.where(np.isnan(stretch.v), v, stretch.v))


def _clamped_rates(t: Array, q: Array, v0: Array, v1: Array) -> Array:
    """Return the rates (N, n) of the cubic spline with the rates ``v0`` and ``v1`` at its ends."""
    if len(t) == 2:
        return np.array([v0, v1])
    from scipy.interpolate import CubicSpline  # takes long to import: only where it is used

    rates: Array = CubicSpline(t, q, bc_type=((1, v0), (1, v1)))(t, 1)
    rates[[0, -1]] = v0, v1
    return rates


def monotone_rates(t: Array, q: Array) -> Array:
    """Return the rates (N, n) of PCHIP: weighted harmonic means of the slopes beside a point, zero at extremes."""
    h, slope = np.diff(t)[:, None], np.diff(q, axis=0) / np.diff(t)[:, None]
    rates = np.zeros_like(q)
    before, after = slope[:-1], slope[1:]
    w0, w1 = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    with np.errstate(all="ignore"):
        mean = (w0 + w1) / (w0 / before + w1 / after)
    rates[1:-1] = np.where(before * after > 0.0, mean, 0.0)
    return rates

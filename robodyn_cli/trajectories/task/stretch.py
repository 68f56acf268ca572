"""A path from one stop to the next: where the frame is and how it is turned, by arc length and by time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.legs import CUBIC, MINIMUM_JERK, TimeLaw, fastest, polynomial
from robodyn_cli.trajectories.motion import PointMotion, PoseMotion
from robodyn_cli.trajectories.task import taylor
from robodyn_cli.trajectories.task.segments import ORDER, STILL, Curve, series_of


class Turning(Protocol):
    """The frame's axes as a function of its place on the path."""

    def axes(self, p: Array, s: Array) -> Array:
        """Return the series (n + 1, T, 3, 3) of R at places s (T,) with positions p (ORDER + 1, T, 3)."""
        ...


class Turns:
    """R = R0 exp(turn_1 b_1(s)) exp(turn_2 b_2(s)) ..., each b from 0 to 1: spherical linear interpolation by parts.

    Parameters
    ----------
    R0 : (3, 3). turns : rotation vectors (3,) in the frame's axes. parts : b of each.
    """

    def __init__(self, R0: Array, turns: Sequence[Array], parts: Sequence[Course]) -> None:
        self.R0, self.turns, self.parts = R0, turns, parts

    def axes(self, p: Array, s: Array) -> Array:
        R = taylor.constant(self.R0, p)
        for turn, part in zip(self.turns, self.parts):
            angle = float(np.linalg.norm(turn))
            if angle == 0.0:
                continue
            x, y, z = turn / angle
            K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            sine, cosine = taylor.sine_and_cosine(angle * series_of(part, s, ORDER)[..., 0])
            versine = -cosine
            versine[0] += 1.0
            turned = sine[..., None, None] * K + versine[..., None, None] * (K @ K)
            turned[0] += np.eye(3)
            R = taylor.multiplied(R, turned)
        return R


class Attitudes:
    """The cubic spline through unit quaternions, made of length 1 at every place: rates and their rates are continuous.

    Parameters
    ----------
    places : (N,), increasing. axes : (N, 3, 3), from each to the next by the shorter turn.
    """

    def __init__(self, places: Array, axes: Sequence[Array]) -> None:
        from scipy.interpolate import CubicSpline  # takes long to import: only where it is used

        q = [quaternion.from_rotation_vector(quaternion.logarithm(axes[0]))]
        for before, after in itertools.pairwise(axes):
            q.append(quaternion.product(q[-1], quaternion.from_rotation_vector(turn_between(before, after))))
        self.course = Course(places, CubicSpline(places, np.array(q, dtype=float)).c[::-1])

    def axes(self, p: Array, s: Array) -> Array:
        q = taylor.unit(series_of(self.course, s, ORDER))
        w, (x, y, z) = q[..., 0], np.moveaxis(q[..., 1:], -1, 0)
        zero = np.zeros_like(w)
        V = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), (0, 1), (-2, -1))
        # R = 1 + 2 w V + 2 V V with V = [v]x
        R = 2.0 * (taylor.scaled(w, V) + taylor.multiplied(V, V))
        R[0] += np.eye(3)
        return R


class Facing:
    """One axis of the frame along the path or towards a point, the axis after the next one as near to ``up`` as can be.

    Parameters
    ----------
    point : (3,), None for the tangent of the path. axis : 0, 1, 2. up : (3,).
    """

    def __init__(self, point: Array | None, axis: int, up: Array) -> None:
        self.point, self.axis, self.up = point, axis, up

    def axes(self, p: Array, s: Array) -> Array:
        if self.point is None:
            n = len(p) - 1
            way = p[1:] * np.arange(1, n + 1).reshape(n, 1, 1)
        else:
            way = -p
            way[0] += self.point
        forward = taylor.unit(way)
        side = taylor.unit(taylor.crossed(taylor.constant(self.up, forward), forward))
        columns = {
            self.axis: forward,
            (self.axis + 1) % 3: side,
            (self.axis + 2) % 3: taylor.crossed(forward, side),
        }
        return np.stack([columns[k] for k in range(3)], axis=-1)


def turn_between(R: Array, to: Array) -> Array:
    """Return the rotation vector (3,), in the axes of R, of the shorter turn to other axes."""
    turn = quaternion.logarithm(R.T @ to)
    return turn if math.hypot(*turn) > 1e-12 else np.zeros(3)  # rounding is no turn


SAMPLES = 65  # between two knots, among which the largest rates are sought
ZOOMS = 3  # times they are sought more closely, between the neighbours
CLOSER = 33
LIMITS = ("speed", "acceleration", "jerk", "angular_speed", "angular_acceleration", "angular_jerk")


class Stretch:
    """Curves one after another, passed without a stop.

    curves : at least one. turning : how the frame is turned; None where that is left free. A stretch without a way has
    the length 0 and is a turn in place; its places run from 0 to 1 instead of an arc length.
    """

    def __init__(self, curves: Sequence[Curve], turning: Turning | None) -> None:
        self.curves, self.turning = curves, turning
        self.starts = np.concatenate([[0.0], np.cumsum([curve.length for curve in curves])])
        self.length = float(self.starts[-1])
        self.size = self.length if self.length > STILL else 1.0
        self.law = polynomial(MINIMUM_JERK, 1.0)

    # -- geometry -------------------------------------------------------------------------------------
    def position(self, s: Array) -> Array:
        """Return the series (ORDER + 1, T, 3) of the position at places s (T,)."""
        series = np.zeros((ORDER + 1, len(s), 3))
        if self.length <= STILL:
            series[0] = self.curves[0].at(np.zeros(1))[0]
            return series
        which = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, len(self.curves) - 1)
        for k in np.unique(which):
            here = which == k
            series[:, here] = self.curves[k].at(s[here] - self.starts[k])
        return series

    @cached_property
    def knots(self) -> Array:
        """Places where the curvature may jump, and both ends."""
        inside = [start + x for start, curve in zip(self.starts, self.curves) for x in curve.knots]
        ends = self.starts if self.length > STILL else np.array([0.0, 1.0])
        return np.unique([*ends, *inside])

    # -- time -----------------------------------------------------------------------------------------
    @property
    def duration(self) -> float:
        """Time of the way [s]."""
        return self.law.course.duration

    def motion(self, times: Array) -> PointMotion | PoseMotion:
        """Return the motion at times (T,) since its start; at rest outside."""
        p, turn = self._derivatives(times)
        linear = p[:3]
        if not turn:
            return PointMotion(*linear)
        return PoseMotion(*linear, *turn[:3])

    def _derivatives(self, times: Array) -> tuple[list[Array], list[Array]]:
        """Return p and its derivatives up to the third; R, w and its derivatives up to the second, or none."""
        course = self.law.course.at_rest_outside() if self.law.rests else self.law.course
        s = self.size * series_of(course, times, 3)[..., 0]
        p = self.position(s[0])
        along = taylor.composed(p, s)
        linear = [taylor.derivative(along, i) for i in range(4)]
        if self.turning is None:
            return linear, []
        R = taylor.composed(self.turning.axes(p, s[0]), s)
        return linear, [R[0], *taylor.angular(R)]

    def timed(self, kind: str, limits: Mapping[str, float], duration: float | None) -> float:
        """Choose the time law of a kind; return the least duration under the limits, 0 where they demand nothing."""
        if kind in ("quintic", "cubic"):
            law = polynomial(MINIMUM_JERK if kind == "quintic" else CUBIC, 1.0)
        else:
            law = self._fastest(limits)
        least = law.course.duration * self._longer(law, limits)
        self.law = (
            law.stretched(least if duration is None else max(duration, least)) if least or duration else law
        )
        return least

    def _fastest(self, limits: Mapping[str, float]) -> TimeLaw:
        """Return the fastest law of the place where limits of the frame's motion hold along the way and across it."""
        s = between(self.knots)
        p = self.position(s)
        # the largest derivatives by the place: first, second, third
        rates = [[largest(taylor.derivative(p, i)) for i in (1, 2, 3)]]
        if self.turning is not None:
            rates.append([largest(w) for w in taylor.angular(self.turning.axes(p, s))[:3]])
        most = np.full(3, math.inf)
        for (slope, bend, twist), names in zip(rates, (LIMITS[:3], LIMITS[3:])):
            bounds = np.array([limits.get(name, math.inf) for name in names])
            if slope > STILL:
                most = np.minimum(most, bounds / slope)
            if bend > STILL:
                most[0] = min(most[0], math.sqrt(bounds[1] / bend))
            if twist > STILL:
                most[0] = min(most[0], float(bounds[2] / twist) ** (1.0 / 3.0))
        speed, acceleration, jerk = (most / self.size).tolist()
        return fastest(speed, acceleration, jerk)

    def _longer(self, law: TimeLaw, limits: Mapping[str, float]) -> float:
        """Return the factor of time by which a law just keeps the limits.

        A derivative of order i falls with its power i.
        """
        self.law = law
        factor, end = 0.0, law.course.duration
        knots = np.unique([*law.course.knots, *self._times_of_knots()])
        times = np.unique(np.clip([*between(knots), *(knots - 1e-9 * end)], 0.0, end))
        values = self._magnitudes(times)
        for name, value in values.items():
            bound = limits.get(name)
            if bound is None:
                continue
            order = 1 + LIMITS.index(name) % 3
            most = self._closer(name, times, value)
            factor = max(factor, (most / bound) ** (1.0 / order))
        return factor

    def _times_of_knots(self) -> Array:
        """Return when the curvature jumps [s], by bisection on the law, which never goes back."""
        course, wanted = self.law.course, self.knots[1:-1] / self.size
        low, high = np.zeros(len(wanted)), np.full(len(wanted), course.duration)
        for _ in range(60):
            middle = 0.5 * (low + high)
            before = course(middle)[:, 0] < wanted
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return high

    def _magnitudes(self, times: Array) -> dict[str, Array]:
        """Return the sizes (T,) of what has limits, by name."""
        p, turn = self._derivatives(times)
        return {name: np.linalg.norm(x, axis=1) for name, x in zip(LIMITS, [*p[1:], *turn[1:]])}

    def _closer(self, name: str, times: Array, values: Array) -> float:
        """Return the largest of the values between the samples too."""
        peak = float(values.max())
        for _ in range(ZOOMS):
            k = int(np.argmax(values))
            times = np.linspace(times[max(k - 1, 0)], times[min(k + 1, len(times) - 1)], CLOSER)
            values = self._magnitudes(times)[name]
            peak = max(peak, float(values.max()))
        return peak

    def breakpoints(self) -> list[float]:
        """Return the times since its start at which an acceleration, or a rate of it, jumps."""
        return [*self.law.course.knots.tolist(), *self._times_of_knots().tolist()]


def step_course(starts: Sequence[float], ends: Sequence[float], gentle: bool, size: float) -> list[Course]:
    """Return functions of the place that go from 0 to 1 between each start and end, evenly or gently."""
    courses = []
    for a, b in zip(starts, ends):
        law = polynomial(MINIMUM_JERK if gentle else (0.0, 1.0), max(b - a, 1e-300 * size))
        course = law.course.shifted(a)
        courses.append(course.at_rest_outside() if gentle else course)
    return courses


def between(knots: Array) -> Array:
    """Return places among knots, evenly between each two."""
    return np.unique(np.linspace(knots[:-1], knots[1:], SAMPLES))


def largest(x: Array) -> float:
    """Return the largest length of vectors (T, 3)."""
    return float(np.linalg.norm(x, axis=1).max())

"""Time laws: how far along its way a motion is, from rest to rest from 0 to 1, or along a path in the least time.

Ways from stop to stop, one after another or blended: the next one begins while the one before still brakes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.spans import Span
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course


@record
class TimeLaw:
    """A time law: ``course`` (one function, from 0 to 1), and how long it speeds up and brakes [s].

    rests : whether the motion is at rest before and after it.
    """

    course: Course
    ramp: float
    rests: bool = True

    def stretched(self, duration: float) -> TimeLaw:
        """Return the law in a longer time."""
        return TimeLaw(
            self.course.stretched(duration), self.ramp * duration / self.course.duration, self.rests
        )


@record
class Scaling:
    """A path with its time law s(t), and how it was found.

    law : one function of t. error : estimated error of the duration [s]. limits : bounds by kind and column of v.
    intervals : of the grid. tolerance : of the duration, in parts of it, asked for; None: the grid was.
    """

    law: Course
    error: float
    limits: Mapping[str, Mapping[str, Span]]
    intervals: int
    tolerance: float | None


def one_after_another(ways: Sequence[Scaling | float]) -> Scaling:
    """Return the time laws of ways from stop to stop as one; a number is a time at rest [s]."""
    laws = [way.law if isinstance(way, Scaling) else Course([0.0, way], [[[0.0]]]) for way in ways]
    degree = max(len(law.c) for law in laws)
    knots, pieces, s = [0.0], [], 0.0
    for law in laws:
        c = np.zeros((degree, *law.c.shape[1:]))
        c[: len(law.c)] = law.c
        c[0] += s
        pieces.append(c)
        s = float(c[0, 0, 0]) + float((law(law.knots[-1:]) - law(law.knots[:1]))[0, 0])
        knots += (knots[-1] + law.knots[1:] - law.knots[0]).tolist()
    timed = [way for way in ways if isinstance(way, Scaling)]
    return Scaling(
        Course(knots, np.concatenate(pieces, axis=1)),
        sum(way.error for way in timed),
        timed[0].limits,
        sum(way.intervals for way in timed),
        timed[0].tolerance,
    )


def fastest(speed: float, acceleration: float, jerk: float = math.inf) -> TimeLaw:
    """Return the law of least duration under limits [1/s, 1/s^2, 1/s^3]; an infinite one does not limit.

    Without a limit of the jerk it is a trapezoid of the speed, or a triangle where the way is short, else an S-curve of
    up to seven parts. Peak speed V, constant acceleration A = J T_j over the time T_a between two ramps T_j of it:
    V = A (T_j + T_a), and speeding up and braking together go V (2 T_j + T_a) (Biagiotti and Melchiorri 2008, 3.4).
    """
    if math.isinf(jerk):
        ramp, constant = 0.0, _until(speed, acceleration)
        if speed * constant >= 1.0:  # the speed is not reached
            constant = math.sqrt(1.0 / acceleration)
            speed = acceleration * constant
    else:
        ramp, constant = _ramps(speed, acceleration, jerk)
        acceleration = jerk * ramp
        speed = acceleration * (ramp + constant)
    start = 2.0 * ramp + constant
    cruise = max(1.0 / speed - start, 0.0)
    return TimeLaw(_assembled(acceleration, ramp, constant, cruise), start)


def _until(speed: float, acceleration: float) -> float:
    return math.inf if math.isinf(speed) else speed / acceleration


def _ramps(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Return T_j and T_a of the S-curve."""
    ramp = min(acceleration / jerk, math.sqrt(speed / jerk))
    constant = speed / (jerk * ramp) - ramp if math.isfinite(speed) and ramp == acceleration / jerk else 0.0
    if math.isfinite(speed) and speed * (2.0 * ramp + constant) <= 1.0:
        return ramp, constant
    ramp = min(acceleration / jerk, (0.5 / jerk) ** (1.0 / 3.0))  # the speed is not reached
    if ramp < acceleration / jerk:
        return ramp, 0.0
    # A (T_j + T_a) (2 T_j + T_a) = 1
    return ramp, max(0.5 * (-3.0 * ramp + math.sqrt(ramp * ramp + 4.0 / acceleration)), 0.0)


def _assembled(acceleration: float, ramp: float, constant: float, cruise: float) -> Course:
    """Return the course of up to seven parts that goes from 0 to 1 and is symmetric in time."""
    jerk = acceleration / ramp if ramp else 0.0
    rising = [(ramp, jerk, 0.0), (constant, 0.0, acceleration), (ramp, -jerk, acceleration)]
    falling = [(ramp, -jerk, 0.0), (constant, 0.0, -acceleration), (ramp, jerk, -acceleration)]
    knots, rows = [0.0], []
    s = v = 0.0
    for time, j, a in [*rising, (cruise, 0.0, 0.0), *falling]:
        if time <= 0.0:
            continue
        rows.append((s, v, a / 2.0, j / 6.0))
        s += time * (v + time * (a / 2.0 + time * j / 6.0))
        v += time * (a + time * j / 2.0)
        knots.append(knots[-1] + time)
    return Course(knots, [[[row[i]] for row in rows] for i in range(4 if ramp else 3)])


def polynomial(coefficients: tuple[float, ...], duration: float) -> TimeLaw:
    """Return the polynomial in t / duration with these coefficients, which goes from 0 to 1."""
    return TimeLaw(Course([0.0, 1.0], [[[c]] for c in coefficients]).stretched(duration), 0.5 * duration)


MINIMUM_JERK = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)
CUBIC = (0.0, 0.0, 3.0, -2.0)


HALVINGS = 30
ROUNDING = 1e-9  # of a limit, which sums of laws may pass by rounding


@record
class Leg:
    """One way: ``law`` from ``start`` on (None: nothing moves); ``end`` : of the stay behind it [s]."""

    law: TimeLaw | None
    start: float
    end: float

    @property
    def course(self) -> Course:
        """The part of the way that is done, over time."""
        assert self.law is not None
        return self.law.course.shifted(self.start)


def start_times(
    laws: Sequence[tuple[TimeLaw | None, float]],
    ways: Array,
    begin: float,
    blend: float,
    limits: Sequence[Array],
) -> list[Leg]:
    """Return the ways with their times.

    Parameters
    ----------
    laws : of each way, and the stay behind it [s]. ways : (L, m) changes. begin : when the first one begins [s].
    blend : part of the braking during which the next way is begun, where there is no stay between them.
    limits : of speed, acceleration and jerk (m,), which two ways together keep to as well.
    """
    legs: list[Leg] = []
    start = begin
    for k, (law, stay) in enumerate(laws):
        before = laws[k - 1] if k else None
        if blend and before is not None and before[1] == 0.0 and before[0] is not None and law is not None:
            most = blend * min(before[0].ramp, law.ramp)
            overlap = _longest_overlap((before[0], law), ways[k - 1 : k + 1], most, limits)
            start -= overlap
        end = start + (law.course.duration if law is not None else 0.0)
        legs.append(Leg(law, start, end + stay))
        start = end + stay
    return legs


def _longest_overlap(
    laws: tuple[TimeLaw, TimeLaw], ways: Array, most: float, limits: Sequence[Array]
) -> float:
    """Return the time for which two ways may overlap, up to ``most``, without passing limits."""
    first, second = laws
    end = first.course.duration

    def fits(overlap: float) -> bool:
        legs = [Leg(first, 0.0, end), Leg(second, end - overlap, end - overlap + second.course.duration)]
        together = superposed(legs, ways, np.zeros(ways.shape[1]))
        return all(
            bool((together.largest(order) <= limit * (1.0 + ROUNDING)).all())
            for order, limit in enumerate(limits, start=1)
        )

    if fits(most):
        return most
    low, high = 0.0, most
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def superposed(legs: Sequence[Leg], ways: Array, start: Array) -> Course:
    """Return ``start`` (n,) + the sum of the ways (L, n), each as far as it is done."""
    moving = [(leg.course, way) for leg, way in zip(legs, ways) if leg.law is not None]
    ends = [0.0, *(x for leg in legs for x in (leg.start, leg.end))]
    knots = np.unique(np.concatenate([ends, *(course.knots for course, _ in moving)]))
    degree = max((len(course.c) for course, _ in moving), default=1)
    c = np.zeros((degree, len(knots) - 1, len(start)))
    c[0] += start
    for course, way in moving:
        first, last = np.searchsorted(knots, course.knots[[0, -1]])
        done = course.refined(knots[first : last + 1]).c
        c[: len(done), first:last] += done * way
        c[0, last:] += way
    return Course(knots, c)

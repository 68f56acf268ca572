"""Ways from stop to stop, one after another or blended: the next one begins while the one before still brakes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.laws import Law

HALVINGS = 30
ROUNDING = 1e-9  # of a limit, which sums of laws may pass by rounding


@record
class Leg:
    """One way: ``law`` from ``start`` on (None: nothing moves); ``end`` : of the stay behind it [s]."""

    law: Law | None
    start: float
    end: float

    @property
    def course(self) -> Course:
        """The part of the way that is done, over time."""
        assert self.law is not None
        return self.law.course.shifted(self.start)


def start_times(
    laws: Sequence[tuple[Law | None, float]],
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


def _longest_overlap(laws: tuple[Law, Law], ways: Array, most: float, limits: Sequence[Array]) -> float:
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

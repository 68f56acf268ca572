"""Options of a run.

The times of a run: its uniform samples, and the stretches between breakpoints.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from robodyn_cli.integrators.stepping.stepper import SLACK
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class Options:
    """How to integrate; ``step`` is for methods without step control.

    first : the first steps of a run and behind events, as a part of the usual ones.
    draw : by which signs numbers that were computed of the scene's are put off by a few roundings; 0: not at all.
    """

    rtol: float = 1e-10
    atol: float = 1e-12
    step: float | None = None
    max_step: float = math.inf
    max_steps: int = 10_000_000
    first: float = 1.0
    draw: int = 0

    def part_of_way(self, step: Any, left: Any) -> Any:
        """Return a step that has so much time left, numbers or arrays.

        Where first steps are shorter, it takes only a part of the way.

        A stretch that is shorter than the steps of two integrations would be one and the same step of both, so that
        they share its error.
        """
        return step if self.first >= 1.0 else np.minimum(step, self.first * left)


JUDGED = 16  # stretches between samples, at least, by which errors are judged
ROUNDINGS = 4  # of a breakpoint, within which a formula may switch


@record
class Grid:
    """Uniform sample times start + k step, k = 0 .. count - 1; the last one is ``end`` without rounding, if given.

    knots : times (P + 1,), so many samples from each to the next one, ``count`` of them with the last knot; then start
    and step do not count. head : where a run begins between samples: one more, the first [s].
    """

    start: float
    step: float
    count: int
    end: float | None = None
    knots: Array | None = None
    head: float | None = None

    @staticmethod
    def between(knots: Array, inside: int) -> Grid:
        """Return times that are uniform between knots (P + 1,), so many from each to the next; of one knot itself."""
        if len(knots) == 1:
            return Grid(float(knots[0]), 0.0, 1)
        return Grid(float(knots[0]), 0.0, inside * (len(knots) - 1) + 1, float(knots[-1]), knots)

    @staticmethod
    def over(duration: float, count: int) -> Grid:
        return Grid(0.0, duration / max(count - 1, 1), count, duration if count > 1 else None)

    def times(self, first: int, last: int) -> Array:
        """Return sample times first .. last - 1."""
        if self.knots is not None:
            places, inside = np.arange(first, last), (self.count - 1) // (len(self.knots) - 1)
            knots, own = self.knots, places // inside
            step = (knots[np.minimum(own + 1, len(knots) - 1)] - knots[own]) / inside
            return np.asarray(knots[own] + places % inside * step)
        if self.head is not None:
            return np.append(
                [self.head] * (first == 0 < last), self._rest.times(max(first - 1, 0), max(last - 1, 0))
            )
        times = self.start + np.arange(first, last) * self.step
        if self.end is not None and first < last == self.count:
            times[-1] = self.end
        return times

    @property
    def _rest(self) -> Grid:
        """The samples but for the head."""
        return Grid(self.start, self.step, self.count - 1, self.end)

    def every(self, n: int) -> Grid:
        """Return every n-th sample, from the first."""
        if n == 1:
            return self
        count = (self.count - 1) // n + 1
        whole = (count - 1) * n == self.count - 1
        start = self.start if self.head is None else self.start + (n - 1) * self.step
        return Grid(start, self.step * n, count, self.end if whole else None, head=self.head)

    def from_time(self, time: float) -> Grid:
        """Return the samples of a run that begins at ``time``: this, and those behind it."""
        k = self.first_at(time)
        if self.begins_by(k, time):
            return Grid(self.start + k * self.step, self.step, self.count - k, self.end) if k else self
        return Grid(self.start + k * self.step, self.step, self.count - k + 1, self.end, head=time)

    def up_to(self, count: int) -> Grid:
        """Return the first samples."""
        return self if count >= self.count else Grid(self.start, self.step, count, head=self.head)

    def begins_by(self, k: int, time: float) -> bool:
        """Tell whether sample k lies at or before ``time``, but for rounding."""
        uniform = self.knots is None and self.head is None
        sample = self.start + k * self.step if uniform else float(self.times(k, k + 1)[0])
        return sample <= time or sample <= time + self._slack(time)

    def first_at(self, time: float) -> int:
        """Return the first sample that does not lie before ``time``, but for rounding."""
        if self.head is not None:
            return 1 + self._rest.first_at(time) if time > self.head + self._slack(time) else 0
        if time == self.start:
            return 0
        if self.step <= 0.0:
            if self.knots is not None:
                return int(np.searchsorted(self.times(0, self.count), time - self._slack(time)))
            return 0 if self.start >= time - self._slack(time) else self.count
        k = max(0, int((time - self.start) / self.step) - 1)
        while self.start + k * self.step < time - self._slack(time):
            k += 1
        return k

    def _slack(self, time: float) -> float:
        return SLACK * (abs(self.start) + abs(time))


def stride_of(samples: int) -> float:
    """Return every how many samples of a run errors are judged by: a power of two, below 1 where more are needed.

    So the times are the same to the bit, whether all samples are taken or only these.
    """
    return 2.0 ** math.floor(math.log2(max(samples - 1, 1) / JUDGED))


def stretches(points: Sequence[float], time: float, end: float) -> Iterator[tuple[float, float, float]]:
    """Yield the stretches from ``time`` to ``end`` [s] between breakpoints ``points`` (sorted).

    Each is (where its last step ends, the first and the last time at which formulas are evaluated in it). At a
    breakpoint itself a formula has the value of one side; just inside the stretch it has its own.
    """
    if not points:
        yield end, -math.inf, math.inf
        return
    first, last = bisect_right(points, time), bisect_left(points, end)
    for k in range(first, max(first, last) + 1):
        after = points[k - 1] + _beside(points[k - 1]) if k else -math.inf
        before = points[k] - _beside(points[k]) if k < len(points) else math.inf
        yield (points[k] if k < last else end), after, before


def _beside(breakpoint: float) -> float:
    return ROUNDINGS * math.ulp(breakpoint)

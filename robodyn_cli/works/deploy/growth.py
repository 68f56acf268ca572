"""Growth of the multipliers against their running median: the literal "multipliers go off to infinity"."""

from __future__ import annotations

import dataclasses
import heapq

import numpy as np

from robodyn_cli.record import mutable_record
from robodyn_cli.spatial.algebra import Array

GRID = 1e-3  # s, the uniform grid on which the running median is taken
LEVELS = (10.0, 100.0, 1000.0)


class RunningMedian:
    """Median of all values so far, in O(log n) a value (two heaps)."""

    def __init__(self) -> None:
        self._low: list[float] = []  # negated, so that the largest is on top
        self._high: list[float] = []

    def add(self, value: float) -> float:
        """Take a value and return the median of all so far."""
        low, high = self._low, self._high
        if not low or value <= -low[0]:
            heapq.heappush(low, -value)
        else:
            heapq.heappush(high, value)
        if len(low) > len(high) + 1:
            heapq.heappush(high, -heapq.heappop(low))
        elif len(high) > len(low):
            heapq.heappush(low, -heapq.heappop(high))
        if len(low) > len(high):
            return -low[0]
        return 0.5 * (high[0] - low[0])


@mutable_record
class GrowthMonitor:
    """Follows the norm of the multipliers on the 1 ms grid and notes when it passes its thresholds.

    times : for each level, the first grid time at which norm > level x running median (which must not be zero).
    limit_time : the first grid time at which norm > limit.
    calmed : the levels (and the limit, as ``limit``) below which the norm has fallen again since.
    """

    levels: tuple[float, ...]
    limit: float | None = None
    times: dict[float, float] = dataclasses.field(default_factory=dict)
    limit_time: float | None = None
    calmed: set[float | str] = dataclasses.field(default_factory=set)
    ratio: float = 0.0
    median: RunningMedian = dataclasses.field(default_factory=RunningMedian)

    def take(self, t: Array, norm: Array) -> None:
        """Take a block of grid samples."""
        pending = [level for level in self.levels if level not in self.times]
        for time, value in zip(t.tolist(), norm.tolist()):
            middle = self.median.add(value)
            if pending and value > pending[0] * middle > 0.0:
                for level in [x for x in pending if value > x * middle]:
                    self.times[level] = round(time, 9)  # a grid time: shed the rounding of k x 1 ms
                    pending.remove(level)
            for level in self.times:
                if value <= level * middle:
                    self.calmed.add(level)
            if self.limit is not None and value > self.limit and self.limit_time is None:
                self.limit_time = round(time, 9)
            elif self.limit is not None and value <= self.limit and self.limit_time is not None:
                self.calmed.add("limit")
            if middle > 0.0 and value > self.ratio * middle:
                self.ratio = value / middle


def levels_with(growth: float) -> tuple[float, ...]:
    """Return the levels that are reported, the scene's own among them, in increasing order."""
    return tuple(sorted({*LEVELS, float(growth)}))


def multiplier_norm(lam: Array) -> Array:
    """Return the Euclidean norm over the rows of multipliers lam (T, m): (T,)."""
    return np.asarray(np.sqrt((lam**2).sum(axis=1)))

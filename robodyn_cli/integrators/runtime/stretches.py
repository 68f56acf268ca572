"""The stretches of a run between breakpoints, at which formulas of time or their slopes jump."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence

ROUNDINGS = 4  # of a breakpoint, within which a formula may switch


def stretches(points: Sequence[float], time: float, end: float) -> Iterator[tuple[float, float, float]]:
    """Yield the stretches from ``time`` to ``end`` [s] between breakpoints ``points`` (sorted).

    Each is (where its last step ends, the first and the last time at which formulas are evaluated in it). At a
    breakpoint itself a formula has the value of one side; just inside the stretch it has its own.
    """
    first, last = bisect_right(points, time), bisect_left(points, end)
    for k in range(first, max(first, last) + 1):
        after = points[k - 1] + _beside(points[k - 1]) if k else -math.inf
        before = points[k] - _beside(points[k]) if k < len(points) else math.inf
        yield (points[k] if k < last else end), after, before


def _beside(breakpoint: float) -> float:
    return ROUNDINGS * math.ulp(breakpoint)

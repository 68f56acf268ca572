"""Samples that are uniform by stretches only, and sums over these.

A stretch ends where the next one begins. Two samples that lie much closer than those around them stand for both sides
of a jump: a stretch ends at the first, the next begins at the second, and each reaches half of the way to the other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.record import record
from robodyn_cli.solve.quadrature import Breaks
from robodyn_cli.spatial.algebra import Array

ALIKE = 1e-9  # of the longest step, by which equal ones differ
GAP = 1e-3  # of the steps around it: a step no longer stands for a jump
Figure = Callable[[Array, float, Breaks], Array]


@record
class Stretches:
    """Stretches of as many uniform samples each.

    first : their first samples (P,). step : between their samples (P,) [s]. low, high : how far functions reach beyond
    the first and the last sample (P,), in steps. breaks : inside a single stretch, in steps from its first sample.
    """

    first: NDArray[np.int_]
    samples: int
    step: Array
    low: Array
    high: Array
    breaks: Breaks = ()

    def of(self, y: Array) -> Array:
        """Return the samples of functions y (T, n) as columns (samples, P n)."""
        block: Array = y[self.first + np.arange(self.samples)[:, None]].reshape(self.samples, -1)
        return block

    def reach(self, piece: slice, low: float, high: float) -> tuple[Array, Array]:
        """Return how far functions reach beyond a piece of each stretch (P,), in steps."""
        before = self.low if piece.start == 0 else np.full_like(self.low, low)
        return before, self.high if piece.stop == self.samples else np.full_like(self.high, high)


def gaps_between(times: Array) -> NDArray[np.int_]:
    """Return the samples behind which a step stands for a jump."""
    steps = np.diff(times)
    return 1 + np.flatnonzero(steps[1:-1] < GAP * np.minimum(steps[:-2], steps[2:]))


def stretches(times: Array, breaks: Breaks = ()) -> list[Stretches]:
    """Return the stretches of uniform samples, of which one ends where the next begins, or at a jump before it: those
    with breaks one by one, others with all that have as many samples."""
    steps = np.diff(times)
    if not len(steps):
        return [Stretches(np.zeros(1, dtype=int), 1, *np.zeros((3, 1)))]
    gaps = gaps_between(times)
    cuts = np.flatnonzero(np.abs(np.diff(steps)) > ALIKE * float(np.abs(steps).max())) + 1
    ends = np.unique([0, *cuts, *gaps, *(gaps + 1), len(steps)])
    first, last = (np.setdiff1d(x, jumps) for x, jumps in ((ends[:-1], gaps), (ends[1:], gaps + 1)))
    step = (times[last] - times[first]) / (last - first)
    beyond = np.zeros(len(times) + 1)  # half of each gap, at the samples on both sides of it
    beyond[gaps] = beyond[gaps + 1] = 0.5 * steps[gaps]
    low, high = beyond[first] / step, beyond[last] / step
    inside: dict[int, list[float]] = {}
    for x in breaks:
        k = int(np.searchsorted(first, x, side="right")) - 1
        if k >= 0 and x < last[k]:
            inside.setdefault(k, []).append(x - int(first[k]))
    alike: dict[Any, list[int]] = {}
    for k, count in enumerate((last - first + 1).tolist()):
        alike.setdefault((count, k if k in inside else None), []).append(k)
    return [
        Stretches(first[own], count, step[own], low[own], high[own], inside.get(own[0], ()))
        for (count, _), own in alike.items()
    ]


def summed(figure: Figure, times: Array, y: Array, breaks: Breaks = ()) -> Array:
    """Return the sum of a figure (n,) of y (T, n), such as ``integrate``, over the stretches of uniform samples."""
    total = np.zeros(y.shape[1])
    for part in stretches(times, breaks):
        block = part.of(y)
        own = figure(block, 1.0, part.breaks)
        for end, reach in ((block[:2], part.low), (block[:-3:-1], part.high)):
            if reach.any():
                far = np.repeat(reach, y.shape[1])
                middle = end[0] + 0.5 * far * (end[0] - end[1])
                own = own + far * figure(np.array([middle, middle]), 1.0, ())
        total += (part.step[:, None] * own.reshape(len(part.step), -1)).sum(axis=0)
    return total

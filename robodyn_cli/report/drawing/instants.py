"""Which instants of a motion are drawn."""

from __future__ import annotations

import numpy as np

from robodyn_cli.report.drawing.record import Drawing
from robodyn_cli.spatial.algebra import Array


def evenly(count: int, most: int) -> Array:
    """Return at most ``most`` of ``count`` samples, evenly apart, the first and the last included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def along_motion(drawing: Drawing, most: int) -> list[int]:
    """Return at most ``most`` instants equally far apart along the motion, the first and the last included.

    The length of a step is how far the vertex has moved that has moved furthest.
    """
    count = len(drawing.times)
    steps = np.linalg.norm(np.diff(drawing.vertices, axis=0), axis=2)
    moved = np.nan_to_num(steps, posinf=0.0).max(axis=1, initial=0.0)
    length = np.concatenate([[0.0], np.cumsum(moved)])
    if not length[-1] > 0.0:
        return [0] if count == 1 else [0, count - 1]
    wanted = np.linspace(0.0, length[-1], most)
    return sorted({int(np.argmin(np.abs(length - mark))) for mark in wanted} | {0, count - 1})


def nearest(times: Array, wanted: Array) -> Array:
    """Return the samples (K,) whose times (T,), in order, are nearest to those wanted (K,)."""
    right = np.clip(np.searchsorted(times, wanted), 1, max(1, len(times) - 1))
    if len(times) == 1:
        return np.zeros(len(wanted), dtype=int)
    left = right - 1
    return np.asarray(np.where(wanted - times[left] <= times[right] - wanted, left, right))

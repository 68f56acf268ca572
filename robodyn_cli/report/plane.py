"""The plane of a drawing in space: the two axes along which things extend most."""

from __future__ import annotations

import numpy as np

from robodyn_cli.report.decimate import extremes
from robodyn_cli.results.result import Array

AXES = ("x", "y", "z")


def main_plane(clouds: list[Array]) -> tuple[int, int]:
    """Return the two axes of largest extent over all ``clouds`` of shape (..., 3), in their usual order.

    Where extents are equal (nothing moves) the earlier axes win: x and y.
    """
    points = np.concatenate([cloud.reshape(-1, 3) for cloud in clouds])
    low, high = extremes(points)
    extent = high - low
    # Rounding errors of a planar mechanism must not outrank an axis.
    extent[extent < 1e-9 * max(1e-300, float(extent.max()))] = 0.0
    first, second = sorted(np.argsort(-extent, kind="stable")[:2].tolist())
    return first, second


def box_height(points: Array, width: float = 5.9, smallest: float = 2.6, largest: float = 5.2) -> float:
    """Return the height in inches of axes ``width`` wide that suit points of shape (N, 2) at equal scales."""
    low, high = extremes(points)
    extent = high - low
    if not extent[0] > 0.0:
        return largest if extent[1] > 0.0 else 3.3
    return float(np.clip(width * extent[1] / extent[0], smallest, largest))

"""The plane of a drawing in space: that of two axes on which things spread most."""

from __future__ import annotations

import numpy as np

from robodyn_cli.report.decimate import extremes
from robodyn_cli.spatial.algebra import Array

AXES = ("x", "y", "z")


def main_plane(clouds: list[Array]) -> tuple[int, int]:
    """Return the two axes of the plane on which all ``clouds`` of shape (..., 3) cast the largest shadow.

    That is where the determinant of the covariance is largest. Of equal ones the earlier axes win; where every
    shadow is a line, or nothing moves, the axes of largest extent do.
    """
    points = np.concatenate([cloud.reshape(-1, 3) for cloud in clouds])
    low, high = extremes(points)
    extent = high - low
    size = float(extent.max())
    # Rounding errors of a planar mechanism must not outrank an axis.
    extent[extent < 1e-9 * max(1e-300, size)] = 0.0
    rows = points[np.isfinite(points).all(axis=1)]
    best, largest = None, 1e-9
    if len(rows) > 1 and size > 0.0:
        C = np.cov((rows - low).T / size)
        for first, second in ((0, 1), (0, 2), (1, 2)):
            area = float(np.linalg.det(C[np.ix_([first, second], [first, second])]))
            if area > largest * (1.0 + 1e-6):
                best, largest = (first, second), area
    if best is not None:
        return best
    first, second = sorted(np.argsort(-extent, kind="stable")[:2].tolist())
    return first, second


def box_height(points: Array, width: float = 5.9, smallest: float = 2.6, largest: float = 5.2) -> float:
    """Return the height in inches of axes ``width`` wide that suit points of shape (N, 2) at equal scales."""
    low, high = extremes(points)
    extent = high - low
    if not extent[0] > 0.0:
        return largest if extent[1] > 0.0 else 3.3
    return float(np.clip(width * extent[1] / extent[0], smallest, largest))

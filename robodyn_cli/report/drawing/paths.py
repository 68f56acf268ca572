"""Paths of the named points of a result."""

from __future__ import annotations

import dataclasses

import numpy as np

from robodyn_cli.report.decimate import finite
from robodyn_cli.report.drawing.record import Drawing, Trail
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

STILL = 1e-6  # of the largest extent: less is no motion
SAME = 1e-9  # [m]


def moving_paths(result: Result) -> dict[str, Array]:
    """Return the places (T, 3) of the named points that move; of points that go the same way the first."""
    found: dict[str, Array] = {}
    for name, item in result.group("points").items():
        path = finite(item.data)
        same = (np.allclose(path, other, rtol=0.0, atol=SAME, equal_nan=True) for other in found.values())
        if _extent(path) > 0.0 and not any(same):
            found[name] = path
    size = max((_extent(path) for path in found.values()), default=0.0)
    return {name: path for name, path in found.items() if _extent(path) > STILL * size}


def drawing_of_paths(paths: list[Array], gravity: Array) -> Drawing:
    """Return a drawing of nothing but paths (T, 3)."""
    trails = tuple(
        Trail(str(k), np.arange(len(path), dtype=float), path, "#000000") for k, path in enumerate(paths)
    )
    nothing = np.zeros((1, 0, 3))
    drawing = Drawing(np.zeros(1), nothing, nothing, (), (), (), (), (), trails, None, gravity)
    extents = np.ptp(drawing.everything, axis=0) if len(drawing.everything) else np.zeros(3)
    thin = [axis for axis in (2, 1, 0) if extents[axis] <= STILL * extents.max()]
    return dataclasses.replace(drawing, flat=thin[0] if thin else None)


def _extent(points: Array) -> float:
    rows = points[np.isfinite(points).all(axis=1)]
    return float(np.ptp(rows, axis=0).max()) if len(rows) else 0.0

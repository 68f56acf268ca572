"""Thin out long records so that the drawing looks the same."""

from __future__ import annotations

import numpy as np

from robodyn_cli.results.result import Array

# About two bins a pixel of the widest axes.
BINS = 1200


def envelope(x: Array, y: Array, bins: int = BINS) -> tuple[Array, Array]:
    """Return the samples that are smallest or largest in their bin, with both ends: what a line shows.

    ``x`` and ``y`` have shape (T,); the result has some 2 ``bins`` samples. Samples that are not a number are
    passed over unless a whole bin is.
    """
    count = len(y)
    if count <= 4 * bins:
        return x, y
    rows = count // bins
    whole = rows * bins
    block = y[:whole].reshape(bins, rows)
    hidden = np.isnan(block)
    low = np.where(hidden, np.inf, block) if hidden.any() else block
    high = np.where(hidden, -np.inf, block) if hidden.any() else block
    start = np.arange(bins) * rows
    tail = np.arange(whole, count, max(1, rows // 8))
    kept = np.concatenate([[0], start + low.argmin(axis=1), start + high.argmax(axis=1), tail, [count - 1]])
    kept = np.unique(kept)
    return x[kept], y[kept]


def thin_path(points: Array, cells: int = 1500, limit: int = 100_000) -> Array:
    """Return ``points``, shape (T, 2), without those that stay within a cell of the drawing.

    ``cells`` is the number of cells along the larger side; ``limit`` bounds what is left.
    """
    if len(points) <= 4 * cells:
        return points
    low = np.nanmin(points, axis=0)
    extent = float(np.nanmax(np.nanmax(points, axis=0) - low))
    if not extent > 0.0:
        return points[[0, -1]]
    cell = np.floor(np.nan_to_num((points - low) / extent * cells, nan=-1.0)).astype(np.int64)
    moved = np.any(cell[1:] != cell[:-1], axis=1)
    kept = np.flatnonzero(np.concatenate([[True], moved]))
    if len(kept) > limit:
        kept = kept[:: -(-len(kept) // limit)]
    return points[np.union1d(kept, [len(points) - 1])]


def finite(values: Array, ceiling: float = 1e100) -> Array:
    """Return ``values`` with NaN for what is infinite or too large to scale an axis by."""
    with np.errstate(invalid="ignore"):
        wild = ~(np.abs(values) < ceiling)
    kept: Array = np.where(wild, np.nan, values) if wild.any() else values
    return kept

"""Thin out long records so that the drawing looks the same."""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.spatial.algebra import Array

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


def crest(x: Array, y: Array, bins: int = 250) -> tuple[Array, Array]:
    """Return the largest sample of each bin: the line below which a noisy error stays."""
    count = len(y)
    if count <= 2 * bins:
        return x, y
    filled = np.where(np.isnan(y), -np.inf, y)
    starts = np.arange(bins) * count // bins
    top = np.maximum.reduceat(filled, starts)
    centre = x[np.minimum((starts + count // (2 * bins)), count - 1)]
    centre[0], centre[-1] = x[0], x[-1]
    return centre, np.asarray(np.where(np.isinf(top), np.nan, top))


def thin_path(points: Array, cells: int = 1500, limit: int = 30_000) -> Array:
    """Return ``points``, shape (T, 2), without those that stay within a cell of the drawing.

    ``cells`` is the number of cells along the larger side; ``limit`` bounds what is left.
    """
    if len(points) <= 4 * cells:
        return points
    low, high = extremes(points)
    extent = float((high - low).max())
    if not extent > 0.0:
        return points[[0, -1]]
    cell = np.floor(np.nan_to_num((points - low) / extent * cells, nan=-1.0)).astype(np.int64)
    moved = np.any(cell[1:] != cell[:-1], axis=1)
    kept = np.flatnonzero(np.concatenate([[True], moved]))
    if len(kept) > limit:
        kept = kept[:: -(-len(kept) // limit)]
    thinned: Array = points[np.union1d(kept, [len(points) - 1])]
    return thinned


def largest(values: Array) -> float:
    """Return the largest of ``values`` that is a number; NaN if none is."""
    return float(np.fmax.reduce(values, axis=None)) if values.size else math.nan


def where_largest(values: Array) -> int:
    """Return the index of the largest number in ``values``, shape (T,); 0 if there is none."""
    return int(np.argmax(np.where(np.isnan(values), -np.inf, values)))


def extremes(points: Array) -> tuple[Array, Array]:
    """Return (smallest, largest) of each column over the rows that are numbers; zeros if there are none."""
    rows = points[np.isfinite(points).all(axis=1)]
    if not len(rows):
        return np.zeros(points.shape[1]), np.zeros(points.shape[1])
    return rows.min(axis=0), rows.max(axis=0)


def finite(values: Array, ceiling: float = 1e100) -> Array:
    """Return ``values`` with NaN for what is infinite or too large to scale an axis by."""
    with np.errstate(invalid="ignore"):
        wild = ~(np.abs(values) < ceiling)
    return np.asarray(np.where(wild, np.nan, values)) if wild.any() else values

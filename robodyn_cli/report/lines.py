"""Lines: long records thinned so that they look the same, what of them scales an axis, limits of joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from robodyn_cli.results.catalogue import JOINT_LIMITS
from robodyn_cli.results.result import Result, column_names
from robodyn_cli.spatial.algebra import Array

# About two bins a pixel of the widest axes.
BINS = 1200


def envelope(x: Array, y: Array, bins: int = BINS) -> tuple[Array, Array]:
    """Return the samples that are smallest or largest in their bin, with both ends: what a line shows.

    ``x`` and ``y`` have shape (T,); the result has some 2 ``bins`` samples. Samples that are not a number break the
    line; where that happens more often than in every fourth bin, they are passed over unless a whole bin is.
    """
    count = len(y)
    if count <= 4 * bins:
        return x, y
    edges = np.flatnonzero(np.diff(np.isnan(y))) + 1
    if 0 < len(edges) <= bins // 4:
        parts = [slice(a, b) for a, b in zip([0, *edges], [*edges, count])]
        kept_x, kept_y = zip(*(envelope(x[a], y[a], -(-bins * len(y[a]) // count)) for a in parts))
        return np.concatenate(kept_x), np.concatenate(kept_y)
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


NEAR = 0.3  # of the largest value of a joint: a limit further away would only make the curve small
LIMIT_NOTE = "; dotted: limits of the joints"


def limits_near(result: Result, path: str) -> dict[str, list[float]]:
    """Return the limits that the columns of a dataset come near or pass, by the names of the columns."""
    variable = result.variables[path]
    names = column_names(variable)
    by_name: dict[str, list[float]] = {}
    for limit, sides in JOINT_LIMITS.get(path, {}).items():
        stored = result.variables.get(f"joint_limits/{limit}")
        for name, size in zip(column_names(stored), stored.data) if stored is not None else ():
            values = finite(variable.data[:, names.index(name)])
            bottom, top = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
            room = NEAR * max(abs(bottom), abs(top))
            levels = [side * size for side in sides if bottom - room <= side * size <= top + room]
            if levels:
                by_name.setdefault(name, []).extend(levels)
    return by_name


def draw_limits(ax: Axes, near: dict[str, list[float]], names: Sequence[str], handles: Sequence[Any]) -> None:
    """Draw the limits of joints in the colours of their curves."""
    for name, handle in zip(names, handles):
        for level in near.get(name, ()):
            ax.axhline(level, color=handle.get_color(), linewidth=1.3, linestyle=(0, (1, 1.5)), zorder=1.5)
            low, high = ax.get_ylim()
            if not low <= level <= high:
                room = 0.05 * max(high - level, level - low)
                ax.set_ylim(min(low, level - room), max(high, level + room))

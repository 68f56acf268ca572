"""Lines over time: long records thinned so that they look the same, many columns (as a map where there are very many),
limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.style import degree_axis, labelled
from robodyn_cli.results.catalogue import JOINT_LIMITS
from robodyn_cli.results.result import Result, Variable, by_unit, column_names
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


NEAR = 0.3  # of the largest value of a joint: a limit further away would only make the curve small
LIMIT_NOTE = "; dotted: limits of the joints"


def limits_near(result: Result, path: str) -> dict[str, list[float]]:
    """Return the limits that the columns of a dataset come near or pass, by the names of the columns."""
    variable = result.variables[path]
    names = column_names(variable)
    found: dict[str, list[float]] = {}
    for limit, sides in JOINT_LIMITS.get(path, {}).items():
        stored = result.variables.get(f"joint_limits/{limit}")
        for name, size in zip(column_names(stored), stored.data) if stored is not None else ():
            values = finite(variable.data[:, names.index(name)])
            bottom, top = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
            room = NEAR * max(abs(bottom), abs(top))
            levels = [side * size for side in sides if bottom - room <= side * size <= top + room]
            if levels:
                found.setdefault(name, []).extend(levels)
    return found


def draw_limits(ax: Axes, near: dict[str, list[float]], names: Sequence[str], handles: Sequence[Any]) -> None:
    """Draw the limits of joints in the colours of their curves."""
    for name, handle in zip(names, handles):
        for level in near.get(name, ()):
            ax.axhline(level, color=handle.get_color(), linewidth=1.3, linestyle=(0, (1, 1.5)), zorder=1.5)


# More instants than pixels add nothing.
INSTANTS = 800
ROWS = 400


def draw_map(result: Result, variable: Variable, quantity: str, subtitle: str) -> Any:
    """Return a figure of a variable (T, n) with columns upwards and time to the right, a map for each unit."""
    names, groups = column_names(variable), by_unit(variable)
    sheet = TimeSheet(
        result,
        f"{subtitle}; {len(names)} columns, one row each",
        panels=len(groups),
        height=3.3 if len(groups) == 1 else 2.2,
        bars=True,
    )
    for ax, bar, (units, columns) in zip(sheet.axes, sheet.bars, groups.items()):
        drawn = _map(ax, result.time, variable.data[:, columns], [names[k] for k in columns])
        sheet.figure.colorbar(drawn, cax=bar).set_label(labelled(quantity, units))
    sheet.label_time()
    sheet.legend([], [])
    return sheet.figure


def _map(ax: Axes, time: Array, data: Array, names: list[str]) -> AxesImage:
    """Draw one map."""
    rows = _spread(len(names), ROWS)
    image = finite(data)[np.ix_(_spread(len(time), INSTANTS), rows)].T
    half = 0.5 if len(time) == 1 else 0.0
    extent = (time[0] - half, time[-1] + half, 0.5, len(names) + 0.5)
    # Lightness grows with the value, so a grey print keeps the order.
    drawn = ax.imshow(
        image, aspect="auto", origin="lower", extent=extent, cmap="cividis", interpolation="nearest"
    )
    ax.grid(False)
    marks = sorted({round(1 + index * (len(names) - 1) / 8) for index in range(9)})
    ax.set_yticks(marks, [_short(names[mark - 1]) for mark in marks])
    return drawn


def _spread(count: int, most: int) -> Any:
    """Return at most ``most`` indices evenly over ``count``."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _short(name: str) -> str:
    return name if len(name) <= 9 else name[:4] + "…" + name[-4:]


# of the largest value of its unit: less is what rounding leaves of zero
NOTHING = 1e-12


def draw_columns(ax: Axes, time: Array, data: Array, styles: list[dict[str, Any]] | None = None) -> list[Any]:
    """Draw the columns of ``data``, shape (T, n), over ``time``; return a legend handle for each."""
    data = finite(data)
    styles = styles or style.line_styles(data.shape[1])
    if len(time) == 1:
        handles: list[Any] = [
            ax.plot(time, data[:, column], marker="o", markersize=5, color=look["color"], linestyle="none")[0]
            for column, look in enumerate(styles)
        ]
        ax.set_xlim(time[0] - 0.5, time[0] + 0.5)
        return handles
    if len(styles) <= style.FEW:
        handles = [ax.plot(*envelope(time, data[:, column]), **look)[0] for column, look in enumerate(styles)]
    else:
        # A line of its own for each of a hundred columns costs more than all else in the drawing.
        bins = max(200, 8 * 1200 // len(styles))
        paths = [np.column_stack(envelope(time, data[:, column], bins)) for column in range(len(styles))]
        ax.add_collection(
            LineCollection(
                paths,
                colors=[look["color"] for look in styles],
                linestyles=[look["linestyle"] for look in styles],
                linewidths=styles[0]["linewidth"],
            )
        )
        ax.autoscale_view()
        handles = [Line2D([], [], **look) for look in styles]
    ax.set_xlim(time[0], time[-1])
    return handles


def draw_magnitudes(ax: Axes, time: Array, data: Array, low: float) -> list[Any]:
    """Draw noisy magnitudes, shape (T, n), faintly and their crests heavily; return handles of the crests.

    Zeros leave gaps in the faint lines, and crests that are zero lie at ``low``.
    """
    styles = style.line_styles(data.shape[1])
    if len(time) <= 2:
        return draw_columns(ax, time, np.maximum(data, low), styles)
    handles = []
    for column, look in enumerate(styles):
        values = finite(data[:, column])
        with np.errstate(invalid="ignore"):
            seen = np.where(values > 0.0, values, np.nan)
        ax.plot(*envelope(time, seen), color=look["color"], linewidth=0.5, alpha=0.45)
        x, top = crest(time, values)
        handles += ax.plot(x, np.maximum(top, low), **look)
    ax.set_xlim(time[0], time[-1])
    return handles


def panel_height(panels: int) -> float:
    """Return the height of a panel [inch], less where there are several."""
    return {1: 3.3, 2: 2.2}.get(panels, 1.6)


def draw_groups(sheet: TimeSheet, time: Array, data: Array, groups: Iterable[list[int]]) -> list[Any]:
    """Draw each group of columns in a panel of its own; return the handles in the order of the columns."""
    styles = style.line_styles(data.shape[1])
    handles: dict[int, Any] = {}
    for ax, columns in zip(sheet.axes, groups):
        drawn = draw_columns(ax, time, data[:, columns], [styles[k] for k in columns])
        handles.update(zip(columns, drawn))
    return [handles[k] for k in range(data.shape[1])]


def quiet_axis(ax: Axes, data: Array, scale: float = 0.0, magnitudes: bool = False) -> None:
    """Let an axis go to 1 where ``data`` is nothing beside ``scale``: it would show what rounding makes of zero."""
    if not np.nanmax(np.abs(data), initial=0.0) > NOTHING * scale:
        ax.set_ylim(
            -0.04 if magnitudes else -1.0, 1.0
        )  # the line at zero lies beside the axis, not behind it


def time_plot(result: Result, path: str, quantity: str, subtitle: str) -> Any:
    """Return a figure of all columns of one variable over time, with degrees where it is an angle."""
    variable = result.variables[path]
    names = column_names(variable)
    if len(names) > style.MANY:
        return draw_map(result, variable, quantity, subtitle)
    groups, near = by_unit(variable), limits_near(result, path)
    sheet = TimeSheet(
        result,
        subtitle + (LIMIT_NOTE if near else ""),
        panels=len(groups),
        height=panel_height(len(groups)),
        labels=names if len(names) > 1 else (),
        degrees="rad" in groups,
    )
    handles = draw_groups(sheet, result.time, variable.data, groups.values())
    sheet.label_time()
    for ax, (units, columns) in zip(sheet.axes, groups.items()):
        quiet_axis(ax, finite(variable.data[:, columns]))
        draw_limits(ax, near, [names[k] for k in columns], [handles[k] for k in columns])
        what = "quaternion" if path == "q" and units == "1" else quantity
        ax.set_ylabel(labelled(what if len(names) > 1 else f"{names[0]}: {what}", units))
        if units == "rad":
            degree_axis(ax)
    sheet.legend(*((handles, names) if len(names) > 1 else ([], [])))
    return sheet.figure

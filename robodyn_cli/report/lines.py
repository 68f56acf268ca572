"""Lines over time: many columns, long records, single samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import crest, envelope, finite
from robodyn_cli.report.heatmap import draw_map
from robodyn_cli.report.marks import mark_lock
from robodyn_cli.report.ticks import degree_axis, labelled
from robodyn_cli.results.result import Array, Result, Variable


def column_names(variable: Variable) -> list[str]:
    """Return the names of the columns; their numbers where they have none."""
    return list(variable.names) or [str(index + 1) for index in range(variable.data.shape[-1])]


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


def time_plot(result: Result, path: str, quantity: str, subtitle: str) -> Any:
    """Return a figure of all columns of one variable over time, with degrees where it is an angle."""
    variable = result.variables[path]
    names = column_names(variable)
    if len(names) > style.MANY:
        return draw_map(result, variable.data, names, quantity, variable.units, subtitle)
    angle = variable.units == "rad"
    sheet = Sheet(result, subtitle, labels=names if len(names) > 1 else (), degrees=angle)
    ax = sheet.ax
    handles = draw_columns(ax, result.time, variable.data)
    sheet.label_time()
    ax.set_ylabel(labelled(quantity if len(names) > 1 else f"{names[0]}: {quantity}", variable.units))
    if angle:
        degree_axis(ax)
    mark_lock([ax], result)
    if len(names) > 1:
        sheet.legend(handles, names)
    return sheet.figure

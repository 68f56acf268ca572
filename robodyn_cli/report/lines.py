"""Lines over time: many columns, long records, single samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import envelope, finite
from robodyn_cli.report.marks import mark_lock
from robodyn_cli.report.ticks import degree_axis, labelled
from robodyn_cli.results.result import Array, Result, Variable

# Beyond this many names a legend shows a choice of them.
MANY = 24


def column_names(variable: Variable) -> list[str]:
    """Return the names of the columns; their numbers where they have none."""
    return list(variable.names) or [str(index + 1) for index in range(variable.data.shape[-1])]


def legend_choice(count: int) -> list[int]:
    """Return the indices of the columns that a legend names."""
    if count <= MANY:
        return list(range(count))
    return sorted({round(index * (count - 1) / 7) for index in range(8)})


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
                paths, colors=[look["color"] for look in styles], linewidths=styles[0]["linewidth"]
            )
        )
        ax.autoscale_view()
        handles = [Line2D([], [], **look) for look in styles]
    ax.set_xlim(time[0], time[-1])
    return handles


def time_plot(result: Result, path: str, quantity: str, subtitle: str) -> Any:
    """Return a figure of all columns of one variable over time, with degrees where it is an angle."""
    variable = result.variables[path]
    names = column_names(variable)
    chosen = legend_choice(len(names))
    labels = [names[index] for index in chosen]
    if len(chosen) < len(names):
        subtitle += f"; {len(names)} columns in order of colour, some named"
    angle = variable.units == "rad"
    sheet = Sheet(result, subtitle, labels=labels if len(names) > 1 else (), degrees=angle)
    ax = sheet.ax
    handles = draw_columns(ax, result.time, variable.data)
    ax.set_xlabel("time [s]")
    ax.set_ylabel(labelled(quantity if len(names) > 1 else f"{names[0]}: {quantity}", variable.units))
    if angle:
        degree_axis(ax)
    mark_lock([ax], result)
    if len(names) > 1:
        sheet.legend([handles[index] for index in chosen], labels)
    return sheet.figure

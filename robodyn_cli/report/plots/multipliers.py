"""Lagrange multipliers of the loops: their norm and each of them, and where they grow beyond bounds."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite, where_largest
from robodyn_cli.report.lines import draw_columns
from robodyn_cli.report.marks import growth_times, loop_columns, sharing_note
from robodyn_cli.report.ticks import labelled, log_axis, number, positive_floor, unit
from robodyn_cli.results.columns import column_names
from robodyn_cli.results.moments import lock_time
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array


def applies(result: Result) -> bool:
    """Tell whether there are multipliers."""
    return "constraints/multipliers" in result and result["constraints/multipliers"].size > 0


def draw(result: Result) -> Any:
    """Return the figure: the whole run, and below it the time in which the multipliers grow."""
    variable = result.variables["constraints/multipliers"]
    data = np.abs(finite(variable.data))
    names = column_names(variable)
    loops = loop_columns(result, tuple(names))
    norm = np.sqrt(np.sum(data[:, loops] ** 2, axis=1))
    shown = data.shape[1] if data.shape[1] < style.FEW else 0
    labels = ["norm", *(f"|{name}|" for name in names[:shown])]
    growth = growth_times(result)
    top = where_largest(norm)
    subtitle = (
        f"Lagrange multipliers; largest norm {number(float(norm[top]), 6)} {unit(variable.units)}"
        f" at t = {number(float(result.time[top]), 6)} s{sharing_note(result)}"
    )
    if growth:
        labels.append("multiple of the running median")
    windows = [slice(None)]
    close = _window(result, growth)
    if close is not None:
        windows.append(close)
    sheet = TimeSheet(
        result, subtitle, panels=len(windows), height=3.3 if close is None else 2.4, gap=0.55, labels=labels
    )
    low, high = positive_floor(norm)
    # A component crosses zero while the norm does not; its dip may leave the picture.
    low = max(low * 1e-2, positive_floor(data)[0]) if shown else low
    columns = np.maximum(np.column_stack([data[:, :shown], norm]), low)
    handles: list[Any] = []
    for ax, window in zip(sheet.axes, windows):
        handles = draw_columns(ax, result.time[window], columns[window], _styles(shown))
        log_axis(ax, low, high)
        ax.set_ylabel(labelled("multiplier", variable.units))
        ax.set_xlabel("time [s]")
    sheet.mark()
    marks = _mark_growth(sheet.axes, result.time, norm, growth)
    sheet.legend([handles[-1], *handles[:-1], *marks], labels)
    return sheet.figure


def _styles(components: int) -> list[dict[str, Any]]:
    """Return the looks of the components, then that of the norm: heavy and black."""
    looks = [look for look in style.line_styles(style.FEW) if look["color"] != "#000000"]
    thin = [{**look, "linewidth": 1.1} for look in looks[:components]]
    return [*thin, {"color": "#000000", "linestyle": "-", "linewidth": 1.8}]


def _window(result: Result, growth: list[tuple[float, float]]) -> slice | None:
    """Return the samples around the growth or the lock, if that is but a part of the run."""
    time, end = result.time, lock_time(result)
    marks = [at for _, at in growth] + ([end] if end is not None else [])
    if not marks or len(time) < 20:
        return None
    span = max(max(marks) - min(marks), 0.01 * float(time[-1] - time[0]))
    first = int(np.searchsorted(time, min(marks) - 0.5 * span))
    last = int(np.searchsorted(time, max(marks) + 0.25 * span, side="right"))
    few = last - first < 10
    return None if few or last - first > 0.5 * len(time) else slice(first, last)


def _mark_growth(axes: list[Any], time: Array, norm: Array, growth: list[tuple[float, float]]) -> list[Any]:
    """Mark where the norm passed each factor; the factors are written in the last panel only."""
    handles: list[Any] = []
    look = {"color": "white", "markeredgecolor": style.ALARM, "markeredgewidth": 1.4, "linestyle": "none"}
    for factor, at in growth:
        value = float(np.interp(at, time, norm))
        for ax in axes:
            handles = ax.plot(at, value, marker="D", markersize=6, zorder=5, **look)
        axes[-1].annotate(
            f"{factor:g}×",
            (at, value),
            xytext=(-6, 7),
            textcoords="offset points",
            ha="right",
            color=style.ALARM,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
        )
    return handles

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
from robodyn_cli.results.moments import lock_time
from robodyn_cli.results.result import Result, by_unit, column_names
from robodyn_cli.spatial.algebra import Array


def applies(result: Result) -> bool:
    """Tell whether there are multipliers."""
    return "constraints/multipliers" in result and result["constraints/multipliers"].size > 0


def draw(result: Result) -> Any:
    """Return the figure: the whole run, and below it the time in which the multipliers grow; a panel a unit."""
    variable = result.variables["constraints/multipliers"]
    data = np.abs(finite(variable.data))
    names = column_names(variable)
    groups = by_unit(variable)
    norms = {
        units: _norm(data, columns, loop_columns(result, tuple(names))) for units, columns in groups.items()
    }
    shown = data.shape[1] if data.shape[1] < style.FEW else 0
    labels = ["norm", *(f"|{name}|" for name in names[:shown])]
    growth = growth_times(result)
    if growth:
        labels.append("multiple of the running median")
    close = _window(result, growth)
    windows = [slice(None)] if close is None else [slice(None), close]
    panels = [(units, window) for window in windows for units in groups]
    height = {1: 3.3, 2: 2.4}.get(len(panels), 1.8)
    sheet = TimeSheet(
        result, _subtitle(result, norms), panels=len(panels), height=height, gap=0.55, labels=labels
    )
    looks = _styles(shown)
    handles: dict[int, Any] = {}
    for ax, (units, window) in zip(sheet.axes, panels):
        columns = [column for column in groups[units] if column < shown]
        drawn = _draw(
            ax, result.time, window, data[:, columns], norms[units], [looks[k] for k in [*columns, -1]]
        )
        handles.update(zip([*columns, shown], drawn))
        ax.set_ylabel(labelled("multiplier", units))
        ax.set_xlabel("time [s]")
    sheet.mark()
    shown_norms = {ax: norms[units] for ax, (units, _) in zip(sheet.axes, panels)}
    marks = _mark_growth(shown_norms, len(groups), result.time, growth)
    sheet.legend([handles[shown], *(handles[k] for k in range(shown)), *marks], labels)
    return sheet.figure


def _norm(data: Array, columns: list[int], loops: list[int]) -> Array:
    """Return the norm (T,) of the columns of one unit that belong to loops, or of all of them where none does."""
    chosen = [column for column in columns if column in loops] or columns
    norm: Array = np.sqrt(np.sum(data[:, chosen] ** 2, axis=1))
    return norm


def _subtitle(result: Result, norms: dict[str, Array]) -> str:
    largest = []
    for units, norm in norms.items():
        top = where_largest(norm)
        time = number(float(result.time[top]), 6)
        largest.append(f"{number(float(norm[top]), 6)} {unit(units)} at t = {time} s")
    return f"Lagrange multipliers; largest norm {', '.join(largest)}{sharing_note(result)}"


def _draw(
    ax: Any, time: Array, window: slice, data: Array, norm: Array, looks: list[dict[str, Any]]
) -> list[Any]:
    """Draw the columns (T, n) of one unit, and last their norm, in a window of the time; return the handles."""
    low, high = positive_floor(norm)
    # A component crosses zero while the norm does not; its dip may leave the picture.
    low = max(low * 1e-2, positive_floor(data)[0]) if data.size else low
    columns = np.maximum(np.column_stack([data, norm]), low)
    handles = draw_columns(ax, time[window], columns[window], looks)
    log_axis(ax, low, high)
    return handles


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


def _mark_growth(
    norms: dict[Any, Array], groups: int, time: Array, growth: list[tuple[float, float]]
) -> list[Any]:
    """Mark on axes where the norm passed each factor; the factors are written in the last panel of each unit only."""
    handles: list[Any] = []
    look = {"color": "white", "markeredgecolor": style.ALARM, "markeredgewidth": 1.4, "linestyle": "none"}
    for factor, at in growth:
        for place, (ax, norm) in enumerate(norms.items()):
            value = float(np.interp(at, time, norm))
            handles = ax.plot(at, value, marker="D", markersize=6, zorder=5, **look)
            if place >= len(norms) - groups:
                ax.annotate(
                    f"{factor:g}×",
                    (at, value),
                    xytext=(-6, 7),
                    textcoords="offset points",
                    ha="right",
                    color=style.ALARM,
                    bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
                )
    return handles

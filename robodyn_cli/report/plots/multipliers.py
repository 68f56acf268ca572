"""Lagrange multipliers of the loops: their norm and each of them, and where they grow beyond bounds."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import finite
from robodyn_cli.report.lines import column_names, draw_columns
from robodyn_cli.report.marks import growth_times, mark_lock
from robodyn_cli.report.ticks import labelled, log_axis, number, positive_floor, unit
from robodyn_cli.results.result import Array, Result


def applies(result: Result) -> bool:
    """Tell whether there are multipliers."""
    return "constraints/multipliers" in result and result["constraints/multipliers"].size > 0


def draw(result: Result) -> Any:
    """Return the figure."""
    variable = result.variables["constraints/multipliers"]
    data = np.abs(finite(variable.data))
    norm = np.sqrt(np.sum(data**2, axis=1))
    shown = data.shape[1] if data.shape[1] < style.FEW else 0
    labels = ["norm", *(f"|{name}|" for name in column_names(variable)[:shown])]
    growth = growth_times(result)
    if growth:
        labels.append("multiple of the running median")
    largest = int(np.nanargmax(norm)) if np.isfinite(norm).any() else 0
    units = unit(variable.units)
    subtitle = (
        f"Lagrange multipliers; largest norm {number(float(norm[largest]), 6)} {units}"
        f" at t = {number(float(result.time[largest]), 6)} s"
    )
    sheet = Sheet(result, subtitle, labels=labels)
    ax = sheet.ax
    styles = style.line_styles(max(2, shown))[:shown]
    styles = [{**look, "linewidth": 1.1} for look in styles if look["color"] != "#000000"]
    styles += [{"color": style.COLOURS[-1], "linestyle": style.DASHES[-1], "linewidth": 1.1}] * (
        shown - len(styles)
    )
    low, high = positive_floor(norm)
    # A component crosses zero while the norm does not; its dip may leave the picture.
    low = max(low * 1e-3, positive_floor(data)[0]) if shown else low
    columns = [data[:, column] for column in range(shown)] + [norm]
    heavy = {"color": "#000000", "linestyle": "-", "linewidth": 1.8}
    handles = draw_columns(ax, result.time, np.maximum(np.column_stack(columns), low), [*styles, heavy])
    log_axis(ax, low, high)
    ax.set_xlabel("time [s]")
    ax.set_ylabel(labelled("multiplier", variable.units))
    mark_lock([ax], result)
    marks = _mark_growth(ax, result.time, norm, growth)
    sheet.legend([handles[-1], *handles[:-1], *marks], labels)
    return sheet.figure


def _mark_growth(ax: Any, time: Array, norm: Array, growth: list[tuple[float, float]]) -> list[Any]:
    """Mark where the norm passed each factor; labels step down so that close ones stay apart."""
    handles: list[Any] = []
    for factor, at in growth:
        value = float(np.interp(at, time, norm))
        handles = ax.plot(
            at,
            value,
            "D",
            color="white",
            markeredgecolor=style.ALARM,
            markeredgewidth=1.4,
            markersize=6,
            zorder=5,
        )
        ax.annotate(
            f"{factor:g}×",
            (at, value),
            xytext=(-8, 2),
            textcoords="offset points",
            ha="right",
            color=style.ALARM,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
        )
    return handles

"""How a controller follows its reference: motion against it, the error, and torques with their limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import envelope, finite
from robodyn_cli.report.lines import draw_columns, panel_height
from robodyn_cli.report.ticks import load_label, number
from robodyn_cli.results.columns import by_unit, column_names
from robodyn_cli.results.result import Result, Variable

MOST = 6  # coordinates that are drawn: those with the largest error


def applies(result: Result) -> bool:
    """Tell whether a controller has followed anything."""
    return "control/error" in result and bool(result["control/error"].size)


def draw(result: Result) -> Any:
    """Return the figure: a panel for the motion and one for the error of each unit, then one of the torques."""
    error, torque = result.variables["control/error"], result.variables["control/torque"]
    names, groups = column_names(error), _shown(error)
    labels = [f"{names[k]}: error up to {_size(result, names[k], units)}" for units, ks in groups for k in ks]
    loads = list(by_unit(torque).items())
    panels = 2 * len(groups) + len(loads)
    note = "; those with the largest errors" if len(labels) < len(names) else ""
    sheet = TimeSheet(
        result,
        f"Motion (lines) and reference (dashed), error, torque of the controller and its limits{note}",
        panels=panels,
        height=panel_height(panels),
        labels=labels,
    )
    colours = {name: style.COLOURS[i % len(style.COLOURS)] for i, name in enumerate(_order(names, groups))}
    axes, handles = list(sheet.axes), []
    for units, columns in groups:
        shown = [names[k] for k in columns]
        handles += _motion(axes.pop(0), result, columns, [colours[name] for name in shown], units)
        ax = axes.pop(0)
        draw_columns(
            ax, result.time, finite(error.data[:, columns]), _looks([colours[name] for name in shown])
        )
        ax.axhline(0.0, color=style.GREY, linewidth=0.6)
        ax.set_ylabel(f"error [{units}]")
    for units, columns in loads:
        _torques(axes.pop(0), result, columns, colours, units)
    sheet.label_time()
    sheet.legend(handles, labels)
    return sheet.figure


def _shown(variable: Variable) -> list[tuple[str, list[int]]]:
    """Return the columns that are drawn, by unit."""
    largest = np.abs(finite(variable.data)).max(axis=0, initial=0.0)
    chosen = set(np.argsort(-largest, kind="stable")[:MOST].tolist())
    found = ((units, [k for k in columns if k in chosen]) for units, columns in by_unit(variable).items())
    return [(units, columns) for units, columns in found if columns]


def _order(names: list[str], groups: list[tuple[str, list[int]]]) -> list[str]:
    drawn = [names[k] for _, columns in groups for k in columns]
    return [*drawn, *(name for name in names if name not in drawn)]


def _size(result: Result, name: str, units: str) -> str:
    data = result["control/error"][:, column_names(result.variables["control/error"]).index(name)]
    return f"{number(float(np.nanmax(np.abs(data))), 3)} {units}"


def _looks(colours: list[str]) -> list[dict[str, Any]]:
    return [{"color": colour, "linewidth": 1.3, "linestyle": "-"} for colour in colours]


def _motion(ax: Any, result: Result, columns: list[int], colours: list[str], units: str) -> list[Any]:
    """Draw motion and reference; return the handles of the motion."""
    wanted = finite(result["control/reference"][:, columns])
    actual = wanted - finite(result["control/error"][:, columns])
    handles = draw_columns(ax, result.time, actual, _looks(colours))
    for k, colour in enumerate(colours):
        ax.plot(
            *envelope(result.time, wanted[:, k]),
            color=colour,
            linewidth=1.0,
            linestyle=(0, (4, 3)),
            alpha=0.75,
        )
    ax.set_ylabel(f"position [{units}]")
    return handles


def _torques(ax: Any, result: Result, columns: list[int], colours: dict[str, str], units: str) -> None:
    """Draw torques with the limits of joints that reach a good part of theirs."""
    variable = result.variables["control/torque"]
    names, data = column_names(variable), finite(variable.data)
    control = result.summary.get("control") or {}
    limits = control.get("limits", {})
    drawn = "steps-post" if "period" in control else "default"  # held between samples
    for k in columns:
        colour = colours.get(names[k], style.COLOURS[k % len(style.COLOURS)])
        ax.plot(*envelope(result.time, data[:, k]), color=colour, linewidth=1.1, drawstyle=drawn)
        if names[k] in limits:
            for side in (-1.0, 1.0):
                ax.axhline(side * limits[names[k]], color=colour, linewidth=0.8, linestyle=style.DASHES[1])
    ax.set_ylabel(load_label("torque", units) if units == "N m" else f"force [{units}]")

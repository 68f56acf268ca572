"""How a controller follows its reference: motion against it, the error, and torques with their limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import envelope, finite
from robodyn_cli.report.lines import draw_columns, panel_height
from robodyn_cli.report.ticks import load_label, number
from robodyn_cli.results.result import Result, Variable, by_unit, column_names

MOST = 6  # coordinates that are drawn: those with the largest error
BAND = {"linewidth": 4.5, "alpha": 0.3, "solid_capstyle": "butt"}  # the reference, which motion lies on
Looks = Mapping[str, Mapping[str, Any]]


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
        f"Motion and reference (broad, pale), error, torque and its limits (thin){note}",
        panels=panels,
        height=panel_height(panels),
        labels=labels,
    )
    looks = {name: style.dashed_style(i) for i, name in enumerate(_order(names, groups))}
    axes, handles = list(sheet.axes), []
    for units, columns in groups:
        shown = [{**looks[names[k]], "linewidth": 1.5} for k in columns]
        handles += _motion(axes.pop(0), result, columns, shown, units)
        ax = axes.pop(0)
        draw_columns(ax, result.time, finite(error.data[:, columns]), shown)
        ax.axhline(0.0, color=style.GREY, linewidth=0.6)
        ax.set_ylabel(f"error [{units}]")
    for units, columns in loads:
        _torques(axes.pop(0), result, columns, looks, units)
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


def _motion(
    ax: Any, result: Result, columns: list[int], looks: list[dict[str, Any]], units: str
) -> list[Any]:
    """Draw motion and reference; return the handles of the motion."""
    wanted = finite(result["control/reference"][:, columns])
    actual = wanted - finite(result["control/error"][:, columns])
    for k, look in enumerate(looks):
        ax.plot(*envelope(result.time, wanted[:, k]), color=look["color"], **BAND)
    ax.set_ylabel(f"position [{units}]")
    return draw_columns(ax, result.time, actual, looks)


def _torques(ax: Any, result: Result, columns: list[int], looks: Looks, units: str) -> None:
    """Draw torques with the limits of joints that have some."""
    variable = result.variables["control/torque"]
    names, data = column_names(variable), finite(variable.data)
    control = result.summary.get("control") or {}
    limits = control.get("limits", {})
    drawn = "steps-post" if "period" in control else "default"  # held between samples
    for k in columns:
        look = looks.get(names[k]) or style.dashed_style(k)
        ax.plot(*envelope(result.time, data[:, k]), **look, linewidth=1.2, drawstyle=drawn)
        if names[k] in limits:
            for side in (-1.0, 1.0):
                ax.axhline(side * limits[names[k]], **look, linewidth=0.7)
    ax.set_ylabel(load_label("torque", units))

"""Forces and moments in joints and loop closures over time: their magnitudes."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite, where_largest
from robodyn_cli.report.lines import NOTHING, draw_columns, draw_map, quiet_axis
from robodyn_cli.report.marks import sharing_note
from robodyn_cli.report.ticks import labelled, log_axis, number
from robodyn_cli.results import result as wrenches
from robodyn_cli.results.result import Result, Variable
from robodyn_cli.spatial.algebra import Array

SPREAD = 30.0  # largest over typical load from which on the scale is logarithmic


def applies(result: Result) -> bool:
    """Tell whether reactions were recorded."""
    return bool(result.group("reactions"))


def draw(result: Result) -> Any:
    """Return the figure: forces above, moments below, or a map of the forces where there are very many.

    Moments that are nothing beside the forces have no panel.
    """
    loads = {**result.group("reactions"), **result.group("loop_reactions")}
    force = np.column_stack([magnitude(item, "f") for item in loads.values()])
    moment = np.column_stack([magnitude(item, "m") for item in loads.values()])
    names = list(loads)
    at, worst = np.unravel_index(where_largest(force.ravel()), force.shape)
    subtitle = (
        f"Reactions in joints and closures; largest force {number(float(force[at, worst]), 5)} N in {names[worst]} "
        f"at t = {number(float(result.time[at]), 5)} s{sharing_note(result)}"
    )
    if len(names) > style.MANY:
        return draw_map(
            result, Variable(force, ("time", "wrench"), "N", "force", tuple(names)), "force", subtitle
        )
    panels = [(force, labelled("force", "N"))]
    if np.nanmax(moment, initial=0.0) > NOTHING * np.nanmax(force, initial=0.0):
        panels.append((moment, labelled("moment", "N m")))
    else:
        subtitle += ", no moments"
    sheet = TimeSheet(result, subtitle, panels=len(panels), height=2.4, labels=names)
    handles: list[Any] = []
    for ax, (data, label) in zip(sheet.axes, panels):
        handles = _draw(ax, result.time, data)
        quiet_axis(ax, data, float(np.nanmax(force, initial=0.0)), magnitudes=True)
        ax.set_ylabel(label)
    sheet.label_time()
    sheet.legend(handles, names)
    return sheet.figure


def _draw(ax: Any, time: Array, data: Array) -> list[Any]:
    """Draw magnitudes: logarithmically where the largest would press the others to the ground."""
    top = float(np.nanmax(data, initial=0.0))
    typical = float(np.nanmedian(data.max(axis=1))) if data.size else 0.0
    if not 0.0 < SPREAD * typical < top:
        handles = draw_columns(ax, time, data)
        ax.set_ylim(bottom=0.0)
        return handles
    low = 1e-3 * typical
    handles = draw_columns(ax, time, np.where(data > low, data, np.nan))
    log_axis(ax, float(data[data > low].min()), top)
    return handles


def magnitude(item: Variable, letter: str) -> Array:
    """Return the length (T,) of the force (``f``) or the moment (``m``) of a wrench."""
    return wrenches.magnitude(finite(item.data), item.names, letter)

"""Actuator torques over time, with the peak and the root mean square of each."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import finite, where_largest
from robodyn_cli.report.heatmap import draw_map
from robodyn_cli.report.lines import by_unit, column_names, draw_groups, panel_height
from robodyn_cli.report.marks import torque_note
from robodyn_cli.report.ticks import labelled, number, unit
from robodyn_cli.results.result import Result
from robodyn_cli.solve.quadrature import root_mean_square_over

QUANTITY = {"N m": "torque", "N": "force"}


def applies(result: Result) -> bool:
    """Tell whether there are torques that someone asked for: given ones that are all zero are not drawn."""
    if "tau" not in result or not result["tau"].size or result.command == "deploy":
        return False
    return result.command == "inverse" or bool(np.any(result["tau"] != 0.0))


def draw(result: Result) -> Any:
    """Return the figure."""
    variable = result.variables["tau"]
    data, names = finite(variable.data), column_names(variable)
    units = [unit(u) for u in variable.column_units or [variable.units] * len(names)]
    rms = root_mean_square_over(result.time, data)
    peak = [where_largest(np.abs(data[:, column])) for column in range(data.shape[1])]
    few = len(names) <= style.FEW
    labels, subtitle = names, _worst(names, data, rms, units) + torque_note(result)
    if len(names) > style.MANY:
        return draw_map(result, data, names, "torque", variable.units, subtitle)
    if few:
        subtitle = f"Actuator torques; dot: peak, thin line: root mean square{torque_note(result)}"
        labels = [
            f"{name}: peak {number(data[at, k], 4)}, RMS {number(float(rms[k]), 4)} {units[k]}"
            for k, (name, at) in enumerate(zip(names, peak))
        ]
    groups = by_unit(variable)
    sheet = Sheet(result, subtitle, panels=len(groups), height=panel_height(len(groups)), labels=labels)
    handles = draw_groups(sheet, result.time, data, groups)
    panels = {column: ax for ax, columns in zip(sheet.axes, groups.values()) for column in columns}
    if few:
        for column, handle in enumerate(handles):
            ax = panels[column]
            at = peak[column]
            colour = handle.get_color()
            ax.plot(
                result.time[at], data[at, column], "o", color=colour, markersize=5, clip_on=False, zorder=3
            )
            ax.axhline(
                float(rms[column]), color=colour, linewidth=0.8, linestyle=handle.get_linestyle(), alpha=0.7
            )
    sheet.label_time()
    for ax, (units_here, columns) in zip(sheet.axes, groups.items()):
        if not np.any(data[:, columns]):
            ax.set_ylim(-1.0, 1.0)  # or the axis would show what rounding makes of zero
        ax.set_ylabel(labelled(QUANTITY.get(units_here, "torque or force"), units_here))
    sheet.legend(handles, labels)
    return sheet.figure


def _worst(names: list[str], data: Any, rms: Any, units: list[str]) -> str:
    largest = where_largest(rms)
    peak = data[where_largest(np.abs(data[:, largest])), largest]
    return (
        f"Actuator torques; largest RMS: {names[largest]} with {number(float(rms[largest]), 4)} {units[largest]},"
        f" peak {number(float(peak), 4)} {units[largest]}"
    )

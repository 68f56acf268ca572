"""Actuator torques over time, with the peak and the root mean square of each."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import finite, where_largest
from robodyn_cli.report.heatmap import draw_map
from robodyn_cli.report.lines import column_names, draw_columns
from robodyn_cli.report.ticks import labelled, number, unit
from robodyn_cli.results.result import Result


def applies(result: Result) -> bool:
    """Tell whether there are torques that someone asked for: given ones that are all zero are not drawn."""
    if "tau" not in result or not result["tau"].size or result.command == "deploy":
        return False
    return result.command == "inverse" or bool(np.any(result["tau"] != 0.0))


def draw(result: Result) -> Any:
    """Return the figure."""
    variable = result.variables["tau"]
    data, names = finite(variable.data), column_names(variable)
    units = unit(variable.units)
    counted = np.maximum(1, np.isfinite(data).sum(axis=0))
    rms = np.sqrt(np.nansum(data**2, axis=0) / counted)
    peak = [where_largest(np.abs(data[:, column])) for column in range(data.shape[1])]
    few = len(names) <= style.FEW
    if len(names) > style.MANY:
        return draw_map(result, data, names, "torque", variable.units, _worst(names, data, rms, units))
    labels, subtitle = names, _worst(names, data, rms, units)
    if few:
        subtitle = "Actuator torques; dot: peak, thin line: root mean square"
        labels = [
            f"{name}: peak {number(data[at, k], 4)}, RMS {number(float(rms[k]), 4)} {units}"
            for k, (name, at) in enumerate(zip(names, peak))
        ]
    sheet = Sheet(result, subtitle, labels=labels)
    ax = sheet.ax
    handles = draw_columns(ax, result.time, data)
    if few:
        for column, handle in enumerate(handles):
            at = peak[column]
            colour = handle.get_color()
            ax.plot(
                result.time[at], data[at, column], "o", color=colour, markersize=5, clip_on=False, zorder=3
            )
            ax.axhline(
                float(rms[column]), color=colour, linewidth=0.8, linestyle=handle.get_linestyle(), alpha=0.7
            )
    sheet.label_time()
    ax.set_ylabel(labelled("torque" if variable.units == "N m" else "torque or force", variable.units))
    sheet.legend(handles, labels)
    return sheet.figure


def _worst(names: list[str], data: Any, rms: Any, units: str) -> str:
    largest = where_largest(rms)
    peak = data[where_largest(np.abs(data[:, largest])), largest]
    return (
        f"Actuator torques; largest RMS: {names[largest]} with {number(float(rms[largest]), 4)} {units},"
        f" peak {number(float(peak), 4)} {units}"
    )

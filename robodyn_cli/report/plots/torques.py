"""Actuator torques over time, with the peak and the root mean square of each."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite, where_largest
from robodyn_cli.report.lines import (
    LIMIT_NOTE,
    draw_groups,
    draw_limits,
    draw_map,
    limits_near,
    panel_height,
    quiet_axis,
)
from robodyn_cli.report.marks import torque_note
from robodyn_cli.report.ticks import load_label, number, unit
from robodyn_cli.results.result import Result, Variable, by_unit, column_names, units_of
from robodyn_cli.solve.quadrature import root_mean_square_over
from robodyn_cli.spatial.algebra import Array

RATIO = 8.0  # of the peaks of two torques from which on each has a panel of its own


def applies(result: Result) -> bool:
    """Tell whether there are torques: those that were given, and not computed, are not drawn where all are zero."""
    if "tau" not in result or not result["tau"].size:
        return False
    return bool(result.group("torque_terms")) or bool(np.any(result["tau"] != 0.0))


def draw(result: Result) -> Any:
    """Return the figure; joints without any torque are left out where others have some."""
    variable = _working(result.variables["tau"])
    data, names = finite(variable.data), column_names(variable)
    units = [unit(u) for u in units_of(variable)]
    rms = root_mean_square_over(result.time, data)
    peak = [where_largest(np.abs(data[:, column])) for column in range(data.shape[1])]
    few = len(names) <= style.FEW
    zero = result["tau"].shape[1] - len(names)
    near = limits_near(result, "tau")
    note = (
        (f"; {zero} without any left out" if zero else "")
        + (LIMIT_NOTE if near else "")
        + torque_note(result)
    )
    labels, subtitle = names, _worst(names, data, rms, units) + note
    if len(names) > style.MANY:
        return draw_map(result, variable, "torque or force", subtitle)
    if few:
        subtitle = f"Actuator torques; dot: peak, thin line: root mean square, on the side of the peak{note}"
        labels = [
            f"{name}: peak {number(data[at, k], 4)}, RMS {number(float(rms[k]), 4)} {units[k]}"
            for k, (name, at) in enumerate(zip(names, peak))
        ]
    panels = (
        _panels(variable, np.nanmax(np.abs(data), axis=0, initial=0.0))
        if few
        else list(by_unit(variable).items())
    )
    sheet = TimeSheet(result, subtitle, panels=len(panels), height=panel_height(len(panels)), labels=labels)
    handles = draw_groups(sheet, result.time, data, [columns for _, columns in panels])
    for ax, (units_here, columns) in zip(sheet.axes, panels):
        for column in columns if few else ():
            colour, dash = handles[column].get_color(), handles[column].get_linestyle()
            largest = data[peak[column], column]
            ax.plot(
                result.time[peak[column]], largest, "o", color=colour, markersize=5, clip_on=False, zorder=3
            )
            level = float(np.copysign(rms[column], largest))
            ax.axhline(level, color=colour, linewidth=0.8, linestyle=dash, alpha=0.7)
        quiet_axis(ax, data[:, columns])
        draw_limits(ax, near, [names[k] for k in columns], [handles[k] for k in columns])
        ax.set_ylabel(load_label("torque or force", units_here))
    sheet.label_time()
    sheet.legend(handles, labels)
    return sheet.figure


def _panels(variable: Variable, peaks: Array) -> list[tuple[str, list[int]]]:
    """Return unit and columns of each panel: beside a torque that is much larger a small one would be a line."""
    found: list[tuple[str, list[int]]] = []
    for units, columns in by_unit(variable).items():
        largest = np.inf
        for column in sorted(columns, key=lambda k: -peaks[k]):
            if peaks[column] * RATIO < largest:
                largest = peaks[column]
                found.append((units, []))
            found[-1][1].append(column)
    return [(units, sorted(columns)) for units, columns in found]


def _working(variable: Variable) -> Variable:
    """Return the columns of joints with a torque, all of them where none has any."""
    columns = np.flatnonzero(np.any(variable.data != 0.0, axis=0))
    if not len(columns):
        return variable
    names, units = column_names(variable), units_of(variable)
    return dataclasses.replace(
        variable,
        data=variable.data[:, columns],
        names=tuple(names[k] for k in columns),
        column_units=tuple(units[k] for k in columns),
    )


def _worst(names: list[str], data: Any, rms: Any, units: list[str]) -> str:
    largest = where_largest(rms)
    peak = data[where_largest(np.abs(data[:, largest])), largest]
    return (
        f"Actuator torques; largest RMS: {names[largest]} with {number(float(rms[largest]), 4)} {units[largest]},"
        f" peak {number(float(peak), 4)} {units[largest]}"
    )

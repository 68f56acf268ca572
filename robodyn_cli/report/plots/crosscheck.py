"""How far another engine is off at its own settings, over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.curves import curves, zero_note
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import MANY, line_styles, positive_floor
from robodyn_cli.report.time_sheet import TimeSheet, panel_height
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.spatial.algebra import Array


@plot(lambda result: "crosscheck/q" in result)
def own_settings(result: Result) -> Any:
    """Gaps of closures, errors of accelerations and of the energy, on logarithmic axes."""
    parts = [*_gaps(result), *_errors(result)]
    summary = result.summary
    subtitle = f"{summary['engine']} {summary['version']} at its own settings, steps of {summary['step']:g} s"
    labels = [name for _, names, _ in parts for name in names]
    magnitudes = [np.abs(data) for _, _, data in parts]
    sheet = TimeSheet(
        result, subtitle + zero_note(*magnitudes), panels=len(parts), height=panel_height(len(parts)), labels=labels
    )
    looks = line_styles(len(labels))
    handles: list[Any] = []
    for ax, (label, names, _), data in zip(sheet.axes, parts, magnitudes):
        styles = looks[len(handles) : len(handles) + len(names)]
        shown = curves(data, names, [""] * len(names), 0.0)
        handles += sheet.draw_log(ax, shown, positive_floor(data), styles)
        ax.set_ylabel(label)
    sheet.finish(handles, labels)
    return sheet.figure


def _gaps(result: Result) -> list[tuple[str, list[str], Array]]:
    """Return a panel of distances and one of angles, as far as there are some, with the largest of the motion here."""
    if "crosscheck/gap" not in result:
        return []
    variable, here = result.variables["crosscheck/gap"], result["crosscheck/gap_here"]
    panels = []
    for unit, label, factor in (("m", "gap [mm]", 1e3), ("rad", "angle [rad]", 1.0)):
        columns = [k for k, one in enumerate(units_of(variable)) if one == unit]
        if columns:
            names = [column_names(variable)[k] for k in columns]
            data = factor * variable.data[:, columns]
            if len(columns) > MANY:
                names, data = [f"largest {label.partition(' ')[0]}"], data.max(axis=1, keepdims=True)
            own = np.full((len(data), 1), factor * here[:, columns].max())
            panels.append((label, [*names, f"largest {label.partition(' ')[0]} here"], np.column_stack([data, own])))
    return panels


def _errors(result: Result) -> list[tuple[str, list[str], Array]]:
    """Return a panel of the accelerations' error and one of the energy's."""
    return [
        (f"error of {name} [1]", [name], result[path][:, None])
        for name, path in (
            ("accelerations", "crosscheck/acceleration_error"),
            ("energy", "crosscheck/energy_error"),
        )
        if path in result
    ]

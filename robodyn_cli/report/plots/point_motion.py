"""Speed and acceleration of the named points over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite
from robodyn_cli.report.lines import draw_columns
from robodyn_cli.report.ticks import labelled
from robodyn_cli.results.result import Result


def applies(result: Result) -> bool:
    """Tell whether velocities and accelerations of points were recorded."""
    return bool(result.group("point_velocities")) and bool(result.group("point_accelerations"))


def draw(result: Result) -> Any:
    """Return the figure: speeds above, magnitudes of the accelerations below."""
    names = list(result.group("point_velocities"))[: style.FEW]
    sheet = TimeSheet(
        result, "Speed and acceleration of the named points", panels=2, height=2.4, labels=names
    )
    handles: list[Any] = []
    for ax, group, label in zip(
        sheet.axes,
        ("point_velocities", "point_accelerations"),
        (labelled("speed", "m/s"), labelled("acceleration", "m/s^2")),
    ):
        length = [np.linalg.norm(finite(result[f"{group}/{name}"]), axis=1) for name in names]
        handles = draw_columns(ax, result.time, np.column_stack(length))
        ax.set_ylabel(label)
        ax.set_ylim(bottom=0.0)
    sheet.label_time()
    sheet.legend(handles, names)
    return sheet.figure

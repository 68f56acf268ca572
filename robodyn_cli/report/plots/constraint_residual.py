"""How well the loops stay closed: position and velocity residuals on a logarithmic axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import finite, largest
from robodyn_cli.report.lines import draw_magnitudes
from robodyn_cli.report.marks import mark_lock
from robodyn_cli.report.ticks import log_axis, number, positive_floor, unit
from robodyn_cli.results.result import Result

KINDS = {"position_residual": "position", "velocity_residual": "velocity"}


def applies(result: Result) -> bool:
    """Tell whether there are residuals."""
    return any(f"constraints/{kind}" in result and result[f"constraints/{kind}"].size for kind in KINDS)


def draw(result: Result) -> Any:
    """Return the figure."""
    columns, labels = [], []
    for kind, word in KINDS.items():
        path = f"constraints/{kind}"
        if path not in result or not result[path].size:
            continue
        size = np.max(np.abs(finite(result[path])), axis=1)
        units = unit(result.variables[path].units)
        columns.append(size)
        labels.append(f"{word} [{units}], largest {number(largest(size))}")
    sheet = Sheet(
        result,
        "Residuals of the loop closures: the largest of all closures",
        labels=labels,
    )
    ax = sheet.ax
    data = np.column_stack(columns)
    low, high = positive_floor(data)
    # Roundings that happen to cancel reach down without end.
    low = max(low, high * 1e-6)
    handles = draw_magnitudes(ax, result.time, data, low)
    log_axis(ax, low, high)
    sheet.label_time()
    ax.set_ylabel("residual")
    mark_lock([ax], result)
    sheet.legend(handles, labels)
    return sheet.figure

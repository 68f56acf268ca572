"""How much of each limit a motion in the least time uses: one of them binds at every time."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite
from robodyn_cli.report.lines import draw_columns
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result, column_names

MOST = 8  # limits that are drawn with a name of their own: those that bind longest


def applies(result: Result) -> bool:
    """Tell whether the use of limits is stored."""
    return "limits/use" in result and bool(result["limits/use"].size)


def draw(result: Result) -> Any:
    """Return the figure."""
    variable = result.variables["limits/use"]
    data, names = finite(variable.data), column_names(variable)
    part = np.array([np.mean(result["limits/binding"] == k) for k in range(len(names))])
    binding = int(np.count_nonzero(part)) or len(part)
    order = np.argsort(-part, kind="stable")[: min(MOST, binding)]
    styles = [{"color": style.COLOURS[i % len(style.COLOURS)], "linewidth": 1.4} for i in range(len(order))]
    labels = [f"{names[k]}: binds {number(100.0 * part[k], 3)} % of the time" for k in order]
    left = len(names) - len(order)
    note = f"; {left} that bind less, or never, left out" if left else ""
    sheet = TimeSheet(
        result, f"Use of the limits on the path in the least time, 1: on the limit{note}", labels=labels
    )
    handles = draw_columns(sheet.ax, result.time, data[:, order], styles)
    sheet.ax.axhline(1.0, color=style.ALARM, linewidth=0.8, linestyle=style.DASHES[1])
    sheet.ax.set_ylim(0.0, 1.08)
    sheet.label_time()
    sheet.ax.set_ylabel("use of the limit [1]")
    sheet.legend(handles, labels)
    return sheet.figure

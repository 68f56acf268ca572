"""Kinetic, potential and total energy and the work done, over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite, largest
from robodyn_cli.report.lines import draw_columns
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result

KINDS = ("kinetic", "potential", "total", "work")


def applies(result: Result) -> bool:
    """Tell whether there are energies to follow."""
    return "energy/total" in result


def draw(result: Result) -> Any:
    """Return the figure."""
    kinds = [kind for kind in KINDS if f"energy/{kind}" in result]
    columns = {kind: finite(result[f"energy/{kind}"]) for kind in kinds}
    labels, subtitle = list(kinds), "Energies" + (" and work done" if "work" in kinds else "")
    datum = _datum(columns)
    if datum:
        for kind in ("potential", "total"):
            columns[kind] = columns[kind] - datum
        labels = [f"{kind} − V(0)" if kind in ("potential", "total") else kind for kind in kinds]
        subtitle += f"; potential and total counted from V(0) = {number(datum, 6)} J"
    sheet = TimeSheet(result, subtitle, labels=labels)
    ax = sheet.ax
    handles = draw_columns(ax, result.time, np.column_stack(list(columns.values())))
    sheet.label_time()
    ax.set_ylabel("energy [J]")
    sheet.legend(handles, labels)
    return sheet.figure


def _datum(columns: dict[str, Any]) -> float:
    """Return what to count the potential from: its start if its level would dwarf its changes, or 0."""
    if "potential" not in columns:
        return 0.0
    spread = max(largest(item) + largest(-item) for item in columns.values())
    start = float(columns["potential"][0])
    return start if abs(start) > 2.0 * spread > 0.0 else 0.0

"""Kinetic, potential and total energy and the work done, over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.lines import draw_columns
from robodyn_cli.report.marks import mark_lock
from robodyn_cli.results.result import Result

KINDS = ("kinetic", "potential", "total", "work")


def applies(result: Result) -> bool:
    """Tell whether there are energies."""
    return "energy/total" in result


def draw(result: Result) -> Any:
    """Return the figure."""
    kinds = [kind for kind in KINDS if f"energy/{kind}" in result]
    sheet = Sheet(result, "Energies" + (" and work done" if "work" in kinds else ""), labels=kinds)
    ax = sheet.ax
    handles = draw_columns(ax, result.time, np.column_stack([result[f"energy/{kind}"] for kind in kinds]))
    ax.set_xlabel("time [s]")
    ax.set_ylabel("energy [J]")
    mark_lock([ax], result)
    sheet.legend(handles, kinds)
    return sheet.figure

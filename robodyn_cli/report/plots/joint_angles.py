"""Joint angles (or displacements) over time."""

from __future__ import annotations

from typing import Any

from robodyn_cli.report.lines import time_plot
from robodyn_cli.results.result import Result


def applies(result: Result) -> bool:
    """Tell whether there are joint positions to draw."""
    return "q" in result and result["q"].shape[1] > 0


def draw(result: Result) -> Any:
    """Return the figure."""
    units = result.variables["q"].units
    quantity = {"rad": "joint angle", "m": "joint displacement"}.get(units, "joint position")
    return time_plot(result, "q", quantity, f"{quantity.capitalize()}s")

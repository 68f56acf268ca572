"""Joint velocities over time."""

from __future__ import annotations

from typing import Any

from robodyn_cli.report.lines import time_plot
from robodyn_cli.results.result import Result


def applies(result: Result) -> bool:
    """Tell whether there are joint velocities to draw."""
    return "qd" in result and result["qd"].shape[1] > 0


def draw(result: Result) -> Any:
    """Return the figure."""
    return time_plot(result, "qd", "joint rate", "Joint rates")

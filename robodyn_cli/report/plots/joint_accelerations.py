"""Joint accelerations over time."""

from __future__ import annotations

from typing import Any

from robodyn_cli.report.lines import time_plot
from robodyn_cli.results.result import Result


def applies(result: Result) -> bool:
    """Tell whether there are joint accelerations to draw."""
    return "qdd" in result and result["qdd"].shape[1] > 0


def draw(result: Result) -> Any:
    """Return the figure."""
    return time_plot(result, "qdd", "joint acceleration", "Joint accelerations")

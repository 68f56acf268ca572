"""Joint accelerations over time, of an inverse run: where they are an input."""

from __future__ import annotations

from typing import Any

from robodyn_cli.report.lines import time_plot
from robodyn_cli.results.result import Result


def applies(result: Result) -> bool:
    """Tell whether this is an inverse run with accelerations."""
    return "qdd" in result and result["qdd"].shape[1] > 0 and result.command == "inverse"


def draw(result: Result) -> Any:
    """Return the figure."""
    return time_plot(result, "qdd", "joint acceleration", "Joint accelerations")

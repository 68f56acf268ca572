"""``robodyn simulate``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.cli.scene_command import integrating_command
from robodyn_cli.cli.words import cost_line, error_lines, number


def describe(summary: Mapping[str, Any]) -> str:
    """Return the summary of a simulation."""
    tolerances = ", ".join(f"{k} {v:.4g}" for k, v in summary.get("tolerances", {}).items())
    lines = [
        f"{summary['title']}",
        f"  simulated          {number(summary['termination'].get('time'))} s, {summary['samples']} samples, "
        f"{summary['integrator']} ({tolerances})",
        *error_lines(summary),
        cost_line(summary),
    ]
    return "\n".join(lines)


command = integrating_command("simulate", describe)

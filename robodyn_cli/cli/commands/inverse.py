"""``robodyn inverse``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import (
    balance_lines,
    cost_lines,
    motorisation_lines,
    multiplier_lines,
)


def describe(summary: Mapping[str, Any], verbose: bool = True, figures: Sequence[str] = ()) -> str:
    """Return the summary of an inverse run."""
    lines = [f"{summary['title']}", *figures]
    lines += balance_lines(summary)
    lines += motorisation_lines(summary)
    lines += _fastest(summary)
    lines += multiplier_lines(summary)
    lines += cost_lines(summary, verbose)
    return "\n".join(lines)


def _fastest(summary: Mapping[str, Any]) -> list[str]:
    """Return the lines about a path in the least time."""
    least_time: Mapping[str, Any] | None = summary.get("fastest")
    if not least_time:
        return []
    parts = sorted(least_time["binding"].items(), key=lambda item: -item[1])
    binding = ", ".join(f"{name} {100.0 * part:.3g} %" for name, part in parts) or "none"
    return [f"  binding limits     {binding} of the time"]


EXAMPLES = (
    "inverse configs/2r_circle.yaml",
    "inverse configs/2r_circle.yaml --set trajectory.ik.branch=elbow_down --out outputs/elbow_down",
    "inverse configs/mechanisms/five_bar_circle.yaml --json",
)


def command(scene: SceneFile, shared: SharedOptions, strict: Strict = False) -> int:
    """Compute the torques of a motion; return the exit code."""
    return run_scene(shared.job("inverse", scene, strict), shared.console, describe)

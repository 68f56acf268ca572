"""``robodyn kinematics``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import closure_text, mobility_lines, number, table


def describe(summary: Mapping[str, Any]) -> str:
    """Return the summary of a kinematic analysis."""
    lines = [
        f"{summary['title']}",
        f"  moved              {number(summary['termination'].get('time'))} s, {summary['samples']} samples",
    ]
    rows = [["joint", "smallest", "largest", "peak speed", "peak acceleration"]]
    for name, row in summary.get("joints", {}).items():
        keys = ("smallest", "largest", "peak_speed", "peak_acceleration")
        rows.append([name, *(number(row[key]) for key in keys)])
    lines.append(table(rows))
    points = [["point", "path length", "peak speed", "peak acceleration"]]
    for name, row in summary.get("points", {}).items():
        points.append(
            [name, *(number(row[key]) for key in ("path_length", "peak_speed", "peak_acceleration"))]
        )
    if len(points) > 1:
        lines.append(table(points))
    lines += mobility_lines(summary)
    ratio = summary.get("singular_ratio")
    if ratio:
        lines.append(f"  nearest dead point ratio {ratio['smallest']:.3g} at t = {number(ratio['time'])} s")
    angle = summary.get("transmission_angle")
    if angle:
        lines.append(
            f"  transmission       {number(angle['smallest_deg'], 5)} to {number(angle['largest_deg'], 5)} deg"
        )
    closure = summary.get("error_estimate", {}).get("closure")
    if closure:
        lines.append("  closure            " + closure_text(closure))
    return "\n".join(lines)


def command(scene: SceneFile, shared: SharedOptions, strict: Strict = False) -> int:
    """Move a mechanism by its driven joints; return the exit code."""
    return run_scene(shared.job("kinematics", scene, strict), shared.console, describe)

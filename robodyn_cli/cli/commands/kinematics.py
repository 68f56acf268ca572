"""``robodyn kinematics``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import (
    AsJson,
    NoPlots,
    OutDir,
    Overrides,
    PlotFormat,
    PlotNames,
    Quiet,
    SceneFile,
    Strict,
    drawings,
)
from robodyn_cli.cli.runner import SceneRun, run_scene
from robodyn_cli.cli.words import closure_text, mobility_lines, number, table


def command(
    scene: SceneFile,
    out: OutDir = None,
    overrides: Overrides = None,
    no_plots: NoPlots = False,
    plots: PlotNames = None,
    format_: PlotFormat = "png",
    as_json: AsJson = False,
    quiet: Quiet = False,
    strict: Strict = False,
) -> int:
    """Run the command; return its exit code."""
    job = SceneRun("kinematics", scene, out, overrides or (), drawings(no_plots, plots, format_), strict)
    return run_scene(job, Console(as_json, quiet), describe)


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

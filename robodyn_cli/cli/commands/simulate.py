"""``robodyn simulate``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import (
    AsJson,
    NoErrorEstimate,
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
from robodyn_cli.cli.words import cost_line, error_lines, number


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
    no_error_estimate: NoErrorEstimate = False,
) -> int:
    """Run the command; return its exit code."""
    settings = [*(overrides or ()), *(["simulate.error_estimate=false"] if no_error_estimate else [])]
    job = SceneRun("simulate", scene, out, settings, drawings(no_plots, plots, format_), strict)
    return run_scene(job, Console(as_json, quiet), describe)


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

"""What the command line calls for commands that run one scene and take no options of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence

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
from robodyn_cli.cli.runner import Describe, SceneRun, run_scene


def scene_command(name: str, describe: Describe) -> Callable[..., int]:
    """Return the command ``name``; ``describe`` makes the text for the terminal from a summary."""

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
        job = SceneRun(name, scene, out, overrides or (), drawings(no_plots, plots, format_), strict)
        return run_scene(job, Console(as_json, quiet), describe)

    return command


def integrating_command(name: str, describe: Describe) -> Callable[..., int]:
    """Return the command ``name`` for a motion that is integrated, whose error a second integration estimates."""

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
        changes = settings(overrides, no_error_estimate)
        job = SceneRun(name, scene, out, changes, drawings(no_plots, plots, format_), strict)
        return run_scene(job, Console(as_json, quiet), describe)

    return command


def settings(overrides: Sequence[str] | None, no_error_estimate: bool) -> list[str]:
    """Return all overrides of keys that the options of an integration ask for."""
    return [*(overrides or ()), *(["simulate.error_estimate=false"] if no_error_estimate else [])]

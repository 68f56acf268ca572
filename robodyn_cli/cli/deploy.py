"""``robodyn deploy``."""

from __future__ import annotations

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.describe import describe_deploy
from robodyn_cli.cli.options import (
    AsJson,
    NoErrorEstimate,
    NoPlots,
    OutDir,
    Overrides,
    Quiet,
    SceneFile,
    Strict,
)
from robodyn_cli.cli.runner import run_scene, without_estimate


def command(
    scene: SceneFile,
    out: OutDir = None,
    overrides: Overrides = None,
    no_plots: NoPlots = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    strict: Strict = False,
    no_error_estimate: NoErrorEstimate = False,
) -> None:
    """Simulate a mechanism with loops until it locks."""
    console = Console(as_json, quiet)
    chosen = without_estimate(overrides, no_error_estimate)
    guarded(
        console,
        lambda: run_scene("deploy", scene, out, chosen, no_plots, strict, console, describe_deploy),
    )

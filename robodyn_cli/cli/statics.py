"""``robodyn statics``."""

from __future__ import annotations

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.describe_mechanism import describe_statics
from robodyn_cli.cli.options import AsJson, NoPlots, OutDir, Overrides, Quiet, SceneFile, Strict
from robodyn_cli.cli.runner import run_scene


def command(
    scene: SceneFile,
    out: OutDir = None,
    overrides: Overrides = None,
    no_plots: NoPlots = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    strict: Strict = False,
) -> None:
    """The balanced configuration, its stability and its loads, or the torques that hold one."""
    console = Console(as_json, quiet)
    guarded(
        console,
        lambda: run_scene("statics", scene, out, overrides, no_plots, strict, console, describe_statics),
    )

"""``robodyn assemble``."""

from __future__ import annotations

from typing import Annotated

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.describe_mechanism import describe_assemble
from robodyn_cli.cli.options import AsJson, NoPlots, OutDir, Overrides, Quiet, SceneFile, Strict
from robodyn_cli.cli.parameters import option
from robodyn_cli.cli.runner import run_scene


def command(
    scene: SceneFile,
    branches: Annotated[
        bool, option("--branches", help="Find and list all the ways in which the loops close.")
    ] = False,
    at: Annotated[
        list[str] | None,
        option("--at", metavar="q.NAME=...", help="Joints to hold, and where; rates as qd.NAME=... too."),
    ] = None,
    out: OutDir = None,
    overrides: Overrides = None,
    no_plots: NoPlots = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    strict: Strict = False,
) -> None:
    """Close the loops, and find the ways in which they close."""
    console = Console(as_json, quiet)

    def action() -> int:
        changes = list(overrides or ())
        if at:
            from robodyn_cli.run.mechanism.info import state_overrides
            from robodyn_cli.scene.load import load_scene

            changes += state_overrides(load_scene(scene, changes), at)
        if branches:
            changes.append("assemble.branches=true")
        return run_scene("assemble", scene, out, changes, no_plots, strict, console, describe_assemble)

    guarded(console, action)

"""The function of a command that runs one scene: arguments and options are the same for all of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.options import AsJson, NoPlots, OutDir, Overrides, Quiet, SceneFile, Strict
from robodyn_cli.cli.runner import run_scene


def scene_command(name: str, text: str, describe: Callable[[Any], str]) -> Callable[..., None]:
    """Return the function of a command.

    Parameters
    ----------
    name : of the command, in the registry of ``scene/commands.py``. text : its help.
    describe : from the summary of a run to the words for the terminal.
    """

    def command(
        scene: SceneFile,
        out: OutDir = None,
        overrides: Overrides = None,
        no_plots: NoPlots = False,
        as_json: AsJson = False,
        quiet: Quiet = False,
        strict: Strict = False,
    ) -> None:
        console = Console(as_json, quiet)
        guarded(console, lambda: run_scene(name, scene, out, overrides, no_plots, strict, console, describe))

    command.__doc__ = text
    return command

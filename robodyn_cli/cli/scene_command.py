"""The function of a command that runs one scene: arguments and options are the same for all of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from robodyn_cli.cli.console import Console, guarded
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
from robodyn_cli.cli.runner import run_scene


def scene_command(
    name: str, text: str, describe: Callable[[Any], str], integrates: bool = False
) -> Callable[..., None]:
    """Return the function of a command.

    Parameters
    ----------
    name : of the command, in the registry of ``scene/commands.py``. text : its help.
    describe : from the summary of a run to the words for the terminal.
    integrates : whether it integrates, and so has an error estimate that can be skipped.
    """

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
        console = Console(as_json, quiet)
        chosen = [*(overrides or ()), *(["simulate.error_estimate=false"] if no_error_estimate else [])]
        guarded(console, lambda: run_scene(name, scene, out, chosen, no_plots, strict, console, describe))

    command.__doc__ = text
    if not integrates:
        # Typer and `quick` read what a command takes from its signature
        found = inspect.signature(command, eval_str=True)
        kept = [p for p in found.parameters.values() if p.name != "no_error_estimate"]
        command.__signature__ = found.replace(parameters=kept)  # type: ignore[attr-defined]
    return command

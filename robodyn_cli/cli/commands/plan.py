"""``robodyn plan``."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from robodyn_cli.cli.console import width
from robodyn_cli.cli.offers import begun_by
from robodyn_cli.cli.options import Overrides, SceneFile, Told
from robodyn_cli.cli.runner import place_in_files, placed
from robodyn_cli.commands import places
from robodyn_cli.errors import CapabilityError, SceneError, did_you_mean, of_option

EXAMPLES = (
    "plan configs/2r_circle.yaml",
    "plan configs/four_bar_deploy.yaml",
    "plan configs/double_pendulum.yaml --json",
)


def command(
    scene: SceneFile,
    overrides: Overrides = None,
    for_command: Annotated[
        str | None,
        typer.Option(
            "--for",
            metavar="COMMAND",
            autocompletion=begun_by(places("plan")),
            help="Command to plan. [default: the scene's own]",
        ),
    ] = None,
    *,
    told: Told,
) -> int:
    """Print the plan; return 2 where data are missing that the command needs."""
    from robodyn_cli.over.commands import command_of
    from robodyn_cli.over.plan.plan import plan, render
    from robodyn_cli.scene.load import load_scene

    console, planned = told.console, places("plan")
    if for_command is not None and for_command not in planned:
        allowed = f"{did_you_mean(for_command, planned)}; allowed: {', '.join(planned)}"
        raise of_option(f"--for {for_command}", f"has no plan{allowed}", CapabilityError)
    loaded = load_scene(scene, list(overrides or ()))
    command = for_command or command_of(loaded)
    with console.waiting(lambda: "planning"), placed(scene, overrides or (), command):
        report = plan(loaded, command)
    console.data(report)
    console.say(render(report, width(sys.stdout)))
    if missing := report.get("missing"):
        message = f"{scene}: the equations need {', '.join(missing)}, which is not given"
        error = SceneError(message, missing=missing)
        place_in_files(error, scene, overrides or (), command)
        console.error(error.message)
        return error.exit_code
    return 0

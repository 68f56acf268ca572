"""``robodyn plan``."""

from __future__ import annotations

from typing import Annotated

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.options import Overrides, Quiet, ReportAsJson, SceneFile
from robodyn_cli.cli.parameters import option


def command(
    scene: SceneFile,
    overrides: Overrides = None,
    for_command: Annotated[
        str | None,
        option("--for", metavar="COMMAND", help="Command to plan. [default: the scene's own]"),
    ] = None,
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
) -> None:
    """What a scene needs, what is left out, and operations."""
    console = Console(as_json, quiet)

    def action() -> int:
        import json

        from robodyn_cli.run.plan.plan import plan, render
        from robodyn_cli.scene.load import load_scene

        found = plan(load_scene(scene, list(overrides or ())), for_command)
        console.data(json.dumps(found, indent=2, ensure_ascii=False))
        console.say(render(found))
        if found.get("missing"):
            console.error(f"{scene}: the equations need {', '.join(found['missing'])}, which is not given")
            return 2
        return 0

    guarded(console, action)

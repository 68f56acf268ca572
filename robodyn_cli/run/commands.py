"""The commands that run a scene, by name."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from robodyn_cli.results.result import Result
from robodyn_cli.results.writer import ResultWriter
from robodyn_cli.run.progress import Progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene

# the module of each command is imported when it runs: start-up time is a feature
COMMANDS = {
    "inverse": ("robodyn_cli.run.inverse", "inverse"),
    "simulate": ("robodyn_cli.run.simulate", "simulate"),
    "deploy": ("robodyn_cli.run.deploy", "deploy"),
}


# samples above which a simulation writes its file while it runs
STREAMED_ABOVE = 200_000


def streams(command: str, scene: Scene) -> bool:
    """Tell whether a run is so long that its file is written block by block."""
    return command in ("simulate", "deploy") and scene.simulate.samples > STREAMED_ABOVE


def execute(
    command: str, scene: Scene, progress: Progress, watch: Stopwatch, writer: ResultWriter | None = None
) -> Result:
    """Run a command on a scene."""
    module, name = COMMANDS[command]
    function: Callable[..., Result] = getattr(importlib.import_module(module), name)
    if writer is not None:
        return function(scene, progress=progress, watch=watch, writer=writer)
    return function(scene, progress=progress, watch=watch)

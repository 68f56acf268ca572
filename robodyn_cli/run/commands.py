"""The commands that run a scene, by name."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from robodyn_cli.results.result import Result
from robodyn_cli.run.progress import Progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene

# the module of each command is imported when it runs: start-up time is a feature
COMMANDS = {
    "inverse": ("robodyn_cli.run.inverse", "inverse"),
    "simulate": ("robodyn_cli.run.simulate", "simulate"),
    "deploy": ("robodyn_cli.run.deploy", "deploy"),
}


def execute(command: str, scene: Scene, progress: Progress, watch: Stopwatch) -> Result:
    """Run a command on a scene."""
    module, name = COMMANDS[command]
    function: Callable[..., Result] = getattr(importlib.import_module(module), name)
    return function(scene, progress=progress, watch=watch)

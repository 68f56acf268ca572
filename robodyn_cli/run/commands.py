"""Run a scene by the name of a command."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from robodyn_cli.results.result import Result
from robodyn_cli.results.writer import ResultWriter
from robodyn_cli.run.progress import Progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.commands import SCENE_COMMANDS
from robodyn_cli.scene.types import Scene

# samples above which a simulation writes its file while it runs
STREAMED_ABOVE = 200_000


def streams(command: str, scene: Scene) -> bool:
    """Tell whether a run is so long that its file is written block by block."""
    if command == "deploy" and scene.deploy.after == "continue":
        return False  # the latch adds columns to what was written before
    return SCENE_COMMANDS[command].streamed and scene.simulate.samples > STREAMED_ABOVE


def execute(
    command: str,
    scene: Scene,
    progress: Progress,
    watch: Stopwatch,
    writer: ResultWriter | None = None,
    **options: Any,
) -> Result:
    """Run a command on a scene; ``options`` are those that it has of its own."""
    entry = SCENE_COMMANDS[command]
    function: Callable[..., Result] = getattr(importlib.import_module(entry.module), entry.function)
    if writer is not None:
        options["writer"] = writer
    with np.errstate(all="ignore"):  # results are looked at; a user gets no warning of numpy's
        return function(scene, progress=progress, watch=watch, **options)

"""Run a scene by the name of a command."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.commands import COMMANDS, SCENE_COMMANDS
from robodyn_cli.errors import SceneError, no_linear_algebra, out_of_range
from robodyn_cli.registry import Registry

if TYPE_CHECKING:
    from robodyn_cli.results.hdf5.writer import ResultWriter
    from robodyn_cli.results.result import Result
    from robodyn_cli.scene.types import Scene
    from robodyn_cli.tools.progress import Progress
    from robodyn_cli.tools.stopwatch import Stopwatch

# samples above which a simulation writes its file while it runs
STREAMED_ABOVE = 200_000

functions: Registry[Callable[..., Result]] = Registry(
    "robodyn_cli", {name: COMMANDS[name].run for name in SCENE_COMMANDS}
)


def streams(command: str, scene: Scene) -> bool:
    """Tell whether a run is so long that its file is written block by block."""
    if command == "deploy" and scene.deploy.after == "continue":
        return False  # the latch adds columns to what was written before
    if scene.drives:
        return False  # their figures are of all samples
    return COMMANDS[command].streamed and scene.simulate.samples > STREAMED_ABOVE


def keeps_journal(command: str, scene: Scene) -> bool:
    """Tell whether a run leaves what it can go on from when it is killed."""
    return command == "simulate" and streams(command, scene)


def execute(
    command: str,
    scene: Scene,
    progress: Progress,
    watch: Stopwatch,
    writer: ResultWriter | None = None,
    **options: Any,
) -> Result:
    """Run a command on a scene; ``options`` are those that it has of its own.

    Raises
    ------
    RobodynError : whatever the command refuses or fails at; it may carry the result until then.
    """
    if scene.initial.source is not None and command != "simulate":
        raise SceneError(
            f"{scene.path}: initial.from: {command!r} does not go on from a stored run; allowed: 'simulate'",
            file=scene.path, key="initial.from",
        )  # fmt: skip
    if writer is not None:
        options["writer"] = writer
    with np.errstate(all="ignore"):  # results are looked at; a user gets no warning of numpy's
        try:
            return functions[command](scene, progress=progress, watch=watch, **options)
        except (np.linalg.LinAlgError, ZeroDivisionError) as error:
            raise no_linear_algebra(error) from error
        except OverflowError as error:
            raise out_of_range(error) from error

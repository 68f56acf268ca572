"""Run a scene by the name of a command, or try what the command does before its first step."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.commands import COMMANDS, places
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

functions: Registry[Callable[..., Result]] = Registry("robodyn_cli", places("run"))
checks: Registry[Callable[[Scene], Sequence[str]]] = Registry("robodyn_cli", places("check"))


def command_of(scene: Scene) -> str:
    """Return the command of a scene; for one without the key, what it is made for."""
    return scene.command or ("inverse" if scene.trajectory is not None else "simulate")


def locks(command: str | None) -> bool:
    """Tell whether a run of a command is one that is to lock."""
    return command is not None and COMMANDS[command].good == "locked"


def streams(command: str, scene: Scene) -> bool:
    """Tell whether a run is so long that its file is written block by block."""
    if locks(command) and scene.deploy.after == "continue":
        return False  # the latch adds columns to what was written before
    if scene.drives:
        return False  # their figures are of all samples
    return COMMANDS[command].streamed and scene.simulate.samples > STREAMED_ABOVE


def keeps_journal(command: str, scene: Scene) -> bool:
    """Tell whether a run leaves what it can go on from when it is killed."""
    return COMMANDS[command].goes_on and streams(command, scene)


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
    if writer is not None:
        options["writer"] = writer
    with _asked_of(command, scene):
        return functions[command](scene, progress=progress, watch=watch, **options)


def check(command: str, scene: Scene) -> Sequence[str]:
    """Try what a command does with a scene before its first step; return the names of data that it lacks.

    Raises
    ------
    RobodynError : what the command raises there.
    """
    with _asked_of(command, scene):
        return checks[command](scene)


@contextlib.contextmanager
def _asked_of(command: str, scene: Scene) -> Iterator[None]:
    """Refuse a start that a command does not take, and turn numpy's errors into ours."""
    if scene.initial.source is not None and not COMMANDS[command].goes_on:
        allowed = ", ".join(repr(name) for name, row in COMMANDS.items() if row.goes_on)
        raise SceneError(
            f"{scene.path}: initial.from: {command!r} does not go on from a stored run; allowed: {allowed}",
            file=scene.path, key="initial.from",
        )  # fmt: skip
    with np.errstate(all="ignore"):  # results are looked at; a user gets no warning of numpy's
        try:
            yield
        except (np.linalg.LinAlgError, ZeroDivisionError) as error:
            raise no_linear_algebra(error) from error
        except OverflowError as error:
            raise out_of_range(error) from error

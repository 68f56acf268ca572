"""Run a scene by the name of a command, or try what the command does before its first step; its errors with the place
of their key: file, line and column."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.commands import COMMANDS, places
from robodyn_cli.errors import (
    CapabilityError,
    GeometryError,
    RobodynError,
    SceneError,
    no_linear_algebra,
    out_of_range,
)
from robodyn_cli.registry import Registry
from robodyn_cli.scene.text.nodes import Node, Path, dotted, find, index_of, located, name_of, nearest
from robodyn_cli.scene.text.nodes import Sequence as SequenceNode

if TYPE_CHECKING:
    from robodyn_cli.results.hdf5.writer import ResultWriter
    from robodyn_cli.results.result import Result
    from robodyn_cli.scene.types import Scene
    from robodyn_cli.tools.progress import Progress, Stopwatch

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
    if scene.drives or scene.motorisation is not None:
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
    if scene.initial.source is not None and not COMMANDS[command].takes_up:
        allowed = ", ".join(repr(name) for name, row in COMMANDS.items() if row.takes_up)
        raise SceneError(
            f"{command!r} does not go on from a stored run; allowed: {allowed}", (scene.path, "initial.from"),
            file=scene.path, key="initial.from",
        )  # fmt: skip
    with np.errstate(all="ignore"):  # results are looked at; a user gets no warning of numpy's
        try:
            yield
        except (np.linalg.LinAlgError, ZeroDivisionError) as error:
            raise no_linear_algebra(error) from error
        except OverflowError as error:
            raise out_of_range(error) from error


ABOUT_SCENE = (SceneError, CapabilityError, GeometryError)  # others happen on the way, and tell a time
# details that name an item of a list
NAMED = (
    ("loop", "loops"),
    ("loop", "robot.loops"),
    ("joint", "robot.joints"),
    ("link", "robot.links"),
    ("coupler", "couplers"),
    ("coupler", "robot.couplers"),
)


def place(error: RobodynError, tree: Callable[[], Node | None], command: str) -> None:
    """Put the place of an error about a scene before its message, and into its details.

    Left alone are errors that have a place, in a file or an option, or that a run has met on its way.

    tree : returns the tree of the scene, None where it cannot be read. command : which was run.
    """
    details = error.details
    if "line" in details or "option" in details:
        return
    if not isinstance(error, ABOUT_SCENE) and "key" not in details:
        return
    if (root := tree()) is None:
        return
    path = path_of(error, root, command)
    placed = located(nearest(root, path), dotted(path), error.sentence)
    said = {root.source.name, str(details.get("key", "")), dotted(path), ": ".join(placed.about)}
    error.about = (*placed.about, *(x for x in error.about if x not in said))
    error.details = {**details, **placed.details}


def path_of(error: RobodynError, root: Node, command: str) -> Path:
    """Return the path of the key that an error is about, as far as it says; empty where it does not."""
    details = error.details
    if key := str(details.get("key", "")):
        of_robot = ("robot", *steps(key))  # as far as the scene leaves a part of the mechanism to its robot
        return of_robot if find(root, steps(key)[:1]) is None and find(root, of_robot[:2]) else steps(key)
    if lacking := owners(root, details.get("missing", ())):
        return lacking[0]
    for name, where in NAMED:
        items = find(root, steps(where))
        if name in details and isinstance(items, SequenceNode):
            index = index_of(items, str(details[name]))
            if index is not None:
                return (*steps(where), index)
    if isinstance(error, GeometryError):
        return (COMMANDS[command].blames,)
    return ()


def steps(key: str) -> Path:
    """Return the path of a dotted key."""
    return tuple(int(step) if step.isdecimal() else step for step in key.split("."))


def owners(root: Node, missing: Sequence[str]) -> list[Path]:
    """Return the paths of links and payloads that lack data; missing : such as ``mass of rod``."""
    names = {name.rpartition(" of ")[2] for name in missing}
    paths: list[Path] = []
    for where in (("robot", "links"), ("payloads",)):
        items = find(root, where)
        for k, item in enumerate(items.items if isinstance(items, SequenceNode) else ()):
            if name_of(item) in names:
                paths.append((*where, k))
    return paths

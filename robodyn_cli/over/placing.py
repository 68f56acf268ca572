"""Errors that a run raises about its scene, with the place of their key: file, line and column."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from robodyn_cli.commands import COMMANDS
from robodyn_cli.errors import CapabilityError, GeometryError, RobodynError, SceneError
from robodyn_cli.scene.text.nodes import Node, Path, dotted, find, index_of, located, name_of, nearest
from robodyn_cli.scene.text.nodes import Sequence as SequenceNode

ABOUT_SCENE = (SceneError, CapabilityError, GeometryError)  # others happen on the way, and tell a time
NAMED = {
    "loop": "loops",
    "joint": "robot.joints",
    "link": "robot.links",
}  # details that name an item of a list
KEY = re.compile(r"([a-z_]+(?:\.\w+)*)(?:: | \()")  # with which a message may begin


def place(error: RobodynError, tree: Callable[[], Node | None], command: str) -> None:
    """Put the place of an error about a scene before its message, and into its details.

    Left alone are errors that have a place, that are about options, or that a run has met on its way.

    tree : returns the tree of the scene, None where it cannot be read. command : which was run.
    """
    details = error.details
    if details.get("line") is not None or error.message.startswith("--"):
        return
    if not isinstance(error, ABOUT_SCENE) and "key" not in details:
        return
    if (root := tree()) is None:
        return
    sentence = error.message.removeprefix(f"{root.source.name}: ")
    if (said := re.match(re.escape(root.source.name) + r":(\d+):(\d+):", error.message)) is not None:
        error.details = {**details, "file": root.source.name, "line": int(said[1]), "column": int(said[2])}
        return
    path = path_of(error, sentence, root, command)
    found = located(nearest(root, path), dotted(path), sentence.removeprefix(f"{dotted(path)}: "))
    error.message, error.details = found.message, {**details, **found.details}
    error.args = (error.message,)


def path_of(error: RobodynError, sentence: str, root: Node, command: str) -> Path:
    """Return the path of the key that an error is about, as far as it says; empty where it does not."""
    details = error.details
    if key := str(details.get("key", "")):
        return steps(key)
    if lacking := owners(root, details.get("missing", ())):
        return lacking[0]
    begins = KEY.match(sentence)
    if begins and (path := steps(begins[1])) and find(root, path[:1]) is not None:
        return path
    for name, where in NAMED.items():
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
    found: list[Path] = []
    for where in (("robot", "links"), ("payloads",)):
        items = find(root, where)
        for k, item in enumerate(items.items if isinstance(items, SequenceNode) else ()):
            if name_of(item) in names:
                found.append((*where, k))
    return found

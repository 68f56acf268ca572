"""What a shell offers of a scene to complete a word: keys, names, the command; the schema is loaded for values alone.

Nothing where the file cannot be read: what is wrong with it is told when the command runs.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from typing import Any

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.errors import RobodynError
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.yaml_text import compose, read_text

# where the names stand that are in the keys of summaries, by their kinds
NAMED = {
    "JOINT": "robot.joints",
    "LINK": "robot.links",
    "POINT": "robot.points",
    "LOOP": "loops",
    "LATCH": "deploy.latches",
    "PAYLOAD": "payloads",
    "PAIR": "kinematics.design.ratios",
}


def offered_keys(scene: str, incomplete: str, numbers: bool = False) -> list[str]:
    """Return the keys of a scene that begin so, a level at a time; those of a file that it includes too.

    Where only one key is left, those below it, since a shell goes on to the next word behind a single one. A key of a
    value ends with ``=``. numbers : leave values without a digit out.
    """
    path, _, _ = incomplete.rpartition(".")
    try:
        while True:
            found = [key for key in _keys_below(scene, path, numbers) if key.startswith(incomplete)]
            if len(found) != 1 or found[0].endswith("="):
                return found
            path = found[0].removesuffix(".")
    except (RobodynError, OSError):
        return []


def _keys_below(scene: str, path: str, numbers: bool) -> Iterator[str]:
    """Yield the keys one level below a key, with the ``.`` or ``=`` that follows."""
    before = f"{path}." if path else ""
    for name, child in _children(_at(scene, path)):
        node = _whole(child)
        if any(_children(node)):
            yield f"{before}{name}."
        elif not numbers or (isinstance(node, nodes.Scalar) and re.search(r"\d", node.text)):
            yield f"{before}{name}="


# where the names stand that a key may hold, by what it names
HELD = {
    "joint": "robot.joints",
    "link": "robot.links",
    "motor": "catalogue.motors",
    "gear": "catalogue.gears",
    "brake": "catalogue.brakes",
}


def offered_values(scene: str, key: str) -> list[str]:
    """Return the words that a key of a scene may be, which are choices, kinds, true or false, or names; the schema is
    loaded for it."""
    from robodyn_cli.scene.text.includes import concrete
    from robodyn_cli.scene.text.numbers import below
    from robodyn_cli.scene.types import Scene
    from robodyn_cli.schema import fields

    kind: fields.Kind | None = fields.Section(Scene)
    node: nodes.Node | None = None
    with contextlib.suppress(RobodynError, OSError):
        node = _read(scene)
        for step in key.split("."):
            while isinstance(kind, fields.OrFile):
                kind = kind.item
            if isinstance(kind, fields.Tagged) and step == kind.tag:
                return list(kind.registry())
            if kind is not None and node is not None:
                kind = concrete(kind, node)
            kind, node = below(kind, step), _whole(dict(_children(node)).get(step))
        return list(_words_of(scene, kind))
    return []


def _words_of(scene: str, kind: Any) -> Iterator[str]:
    from robodyn_cli.schema import fields

    if isinstance(kind, fields.Either):
        for one in kind.kinds:
            yield from _words_of(scene, one)
    elif isinstance(kind, fields.Choice):
        yield from kind.options
    elif isinstance(kind, fields.Boolean):
        yield from ("true", "false")
    elif isinstance(kind, fields.Name) and kind.of in HELD:
        place = HELD[kind.of]
        section, _, part = place.partition(".")
        if section == "catalogue" and not names_below(scene, section):
            from robodyn_cli.scene.text.catalogue import EXAMPLE

            yield from names_below(str(EXAMPLE), part)
        else:
            yield from names_below(scene, place)


def names_below(scene: str, path: str) -> list[str]:
    """Return the names of what stands in a section of a scene."""
    try:
        return [name for name, _ in _children(_at(scene, path))]
    except (RobodynError, OSError):
        return []


def summary_names(scene: str) -> dict[str, list[str]]:
    """Return the names that keys of summaries of a scene may have in them, by kind, as far as they stand there."""
    return {kind: names_below(scene, path) for kind, path in NAMED.items()}


def command_in(scene: str) -> str | None:
    """Return the command of a scene, as ``over/commands.py`` does; None where it names one that there is not."""
    try:
        node = _at(scene, "command")
    except (RobodynError, OSError):
        return None
    if node is None:
        return "inverse" if "trajectory" in names_below(scene, "") else "simulate"
    return node.text if isinstance(node, nodes.Scalar) and node.text in SCENE_COMMANDS else None


def _at(scene: str, path: str) -> nodes.Node | None:
    """Return what stands under a key, or the tree of the file that it names."""
    node: nodes.Node | None = _read(scene)
    for step in path.split(".") if path else ():
        node = _whole(dict(_children(node)).get(step))
    return node


def _children(node: nodes.Node | None) -> Iterator[tuple[str, nodes.Node]]:
    """Yield what stands below a node: by key, items of lists by name or number."""
    if isinstance(node, nodes.Mapping):
        yield from ((key.text, value) for key, value in node.entries)
    elif isinstance(node, nodes.Sequence):
        for k, item in enumerate(node.items):
            name = item.get("name") if isinstance(item, nodes.Mapping) else None
            yield name.text if isinstance(name, nodes.Scalar) else str(k), item


def _whole(node: nodes.Node | None) -> nodes.Node | None:
    """Return a node, or the tree of the YAML file that it names."""
    if isinstance(node, nodes.Scalar) and node.text.endswith((".yaml", ".yml")):
        return _read(os.path.join(node.source.directory, node.text))
    return node


def _read(path: str) -> nodes.Node:
    source = nodes.Source(path, os.path.dirname(path) or ".", os.path.realpath(path))
    return compose(read_text(path, None, "", path), source, nodes.Faults())

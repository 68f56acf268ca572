"""The unit of a key of a scene."""

from __future__ import annotations

import dataclasses

from robodyn_cli.scene.text.includes import child_kind, concrete
from robodyn_cli.scene.text.nodes import Mapping, Node, Sequence, index_of
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import Inline, Kind, Section, key_name


def unit_of(root: Node, key: str) -> str:
    """Return the unit that the description of a scene's keys gives to ``robot.links.link1.mass``; "" if none.

    root : tree of the scene, with the files that it includes.
    """
    kind: Kind | None = Section(Scene)
    node: Node | None = root
    unit = ""
    for step in key.split("."):
        kind = concrete(kind, node) if kind is not None and node is not None else kind
        if isinstance(kind, Section):
            unit = _unit(kind.cls, step)
        kind = child_kind(kind, step)
        node = _child(node, step)
    return unit


def _unit(cls: type, step: str) -> str:
    for field in dataclasses.fields(cls):
        if key_name(field) == step and not isinstance(field.metadata.get("kind"), Inline):
            return str(field.metadata.get("unit", ""))
    return ""


def _child(node: Node | None, step: str) -> Node | None:
    if isinstance(node, Mapping):
        return node.get(step)
    if isinstance(node, Sequence):
        index = index_of(node, step)
        return None if index is None else node.items[index]
    return None

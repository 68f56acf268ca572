"""The keys of a scene that a shell offers to complete a word. No schema is loaded, and no number is read."""

from __future__ import annotations

import os
from collections.abc import Iterator

from robodyn_cli.errors import RobodynError
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.yaml_text import compose, read_text


def offered_keys(scene: str, incomplete: str) -> list[str]:
    """Return the keys of a scene that begin so, a level at a time; those of a file that it includes too.

    Nothing where the file cannot be read: what is wrong with it is told when the command runs.
    """
    path, _, _ = incomplete.rpartition(".")
    try:
        node: nodes.Node | None = _read(scene)
        for step in path.split(".") if path else ():
            node = _whole(dict(_children(node)).get(step))
        below = [(name, [*_children(_whole(child))]) for name, child in _children(node)]
    except (RobodynError, OSError):
        return []
    before = f"{path}." if path else ""
    found = [f"{before}{name}{'.' if inner else '='}" for name, inner in below]
    return [key for key in found if key.startswith(incomplete)]


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

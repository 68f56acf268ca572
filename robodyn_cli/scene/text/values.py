"""Data of Python (maps, lists, arrays, numbers, texts) as nodes of a scene, and as the texts of ``--set``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.yaml_text import MAX_DEPTH, flow

ALLOWED = "allowed: numbers, texts, truth values, None, lists, maps and arrays of these"

# keys with values, nested or dotted; texts ``key.path=value``; or one such text
Overrides = Mapping[str, Any] | Sequence[str] | str


def node_of(value: Any, directory: str = ".", path: nodes.Path = ()) -> nodes.Node:
    """Return the node of a value; texts are texts, whatever YAML would make of them.

    directory : where paths in the value start. path : where the value hangs in the scene, for messages.

    Raises
    ------
    SceneError : a value is no data, a key no text, or values are nested too deep.
    """
    return _node(
        value, nodes.Scalar(nodes.Source(nodes.IN_PYTHON, directory, positions=False), 1, 1, "", None), path
    )


def _node(value: Any, place: nodes.Scalar, path: nodes.Path) -> nodes.Node:
    if len(path) > MAX_DEPTH:
        raise nodes.located(place, nodes.dotted(path[:3]), f"nested more than {MAX_DEPTH} levels deep")
    if isinstance(value, Mapping):
        entries = [
            (_key(name, place, path), _node(x, place, (*path, str(name)))) for name, x in value.items()
        ]
        return nodes.mapping(place, entries)
    if type(value).__module__ == "numpy":  # arrays and their scalars, without numpy being imported here
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return nodes.sequence(place, [_node(x, place, (*path, k)) for k, x in enumerate(value)])
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if value is None or isinstance(value, (bool, int, float)):
        return nodes.scalar(place, value)
    if isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError:
            raise nodes.located(
                place, nodes.dotted(path), "half a surrogate pair; allowed: Unicode text"
            ) from None
        return nodes.scalar(place, value)
    kind = type(value).__name__
    raise nodes.located(place, nodes.dotted(path), f"{shown(value)} of type {kind} is no data; {ALLOWED}")


def _key(name: Any, place: nodes.Scalar, path: nodes.Path) -> nodes.Scalar:
    if not isinstance(name, str) or not name:
        raise nodes.located(
            place, nodes.dotted(path), f"key {shown(name)} is no text; allowed: names of keys"
        )
    return nodes.scalar(place, name)


def text_of(value: Any, path: nodes.Path = ()) -> str:
    """Return a value as YAML on one line, numbers with all their digits.

    Raises
    ------
    SceneError : as of ``node_of``.
    """
    return flow(node_of(value, path=path))


def settings(overrides: Overrides) -> list[str]:
    """Return overrides as texts ``key.path=value``.

    Maps are gone through to their values, each of which replaces what is there; so an empty map, a list or None does.

    Raises
    ------
    SceneError : what is given is neither a map nor texts; others as of ``node_of``.
    """
    if isinstance(overrides, str):
        return [overrides]
    if isinstance(overrides, Mapping):
        return [f"{key}={text_of(value, (key,))}" for key, value in _leaves(overrides, "", 0)]
    texts = list(overrides) if isinstance(overrides, Sequence) else None
    if texts is None or not all(isinstance(text, str) for text in texts):
        raise SceneError(
            f"overrides {shown(overrides)}: allowed: {{'key.path': value}}, nested maps, or texts 'key.path=value'"
        )
    return texts


def _leaves(values: Mapping[str, Any], above: str, depth: int) -> list[tuple[str, Any]]:
    if depth > MAX_DEPTH:
        raise SceneError(f"overrides {above[:60]}: nested more than {MAX_DEPTH} levels deep")
    found: list[tuple[str, Any]] = []
    for name, value in values.items():
        if not isinstance(name, (str, int)) or isinstance(name, bool) or name == "":
            raise SceneError(f"overrides {above}: key {shown(name)} is no text; allowed: names of keys")
        key = f"{above}.{name}" if above else str(name)
        found += _leaves(value, key, depth + 1) if isinstance(value, Mapping) and value else [(key, value)]
    return found

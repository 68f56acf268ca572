"""Data of Python (maps, lists, arrays, numbers, texts) as nodes of a scene, and as the texts of ``--set``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.yaml_text import MAX_DEPTH, flow

ALLOWED = "allowed: numbers, texts, truth values, None, lists, maps and arrays of these"

MOTIONS = ("trajectory", "control.reference")  # keys of motions, which arrays may give
MOTION = "allowed: (t, q), (t, q, qd) or (t, q, qd, qdd) with t (T,) and the others (T, n), a column a joint"

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
    if isinstance(value, tuple) and nodes.dotted(path) in MOTIONS:
        return _node(_motion(value, place, path), place, path)
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


def _motion(value: tuple[Any, ...], place: nodes.Scalar, path: nodes.Path) -> dict[str, Any]:
    """Return the table of a motion that is given by arrays: times (T,), positions (T, n), and perhaps rates and
    accelerations; of one joint (T,) goes too.

    Raises
    ------
    SceneError : their shapes do not fit.
    """
    import numpy as np

    try:
        t, *columns = (np.asarray(x, dtype=float) for x in value)
    except (TypeError, ValueError) as error:
        raise nodes.located(place, nodes.dotted(path), f"is no motion: {error}; {MOTION}") from None
    columns = [x[:, None] if x.ndim == 1 else x for x in columns]
    shapes = {x.shape for x in columns}
    if t.ndim != 1 or not 1 <= len(columns) <= 3 or len(shapes) != 1 or columns[0].shape[:-1] != t.shape:
        found = ", ".join(str(np.shape(x)) for x in value)
        raise nodes.located(place, nodes.dotted(path), f"is no motion: arrays of shapes {found}; {MOTION}")
    return {"type": "table", "rows": np.column_stack([t, *columns])}


def unnamed_tables(root: nodes.Mapping) -> list[str]:
    """Return the keys of the motions of a scene that are tables without names of columns, as arrays are."""
    tables = {key: _at(root, key.split(".")) for key in MOTIONS}
    return [
        key
        for key, table in tables.items()
        if isinstance(table, nodes.Mapping) and table.get("rows") is not None and table.get("columns") is None
    ]


def _at(node: nodes.Node | None, keys: Sequence[str]) -> nodes.Node | None:
    for key in keys:
        node = node.get(key) if isinstance(node, nodes.Mapping) else None
    return node


def with_columns(root: nodes.Mapping, motion: str, joints: Sequence[str]) -> nodes.Mapping:
    """Return a scene whose table has names of columns: ``t``, joints, and their rates where rows have them.

    Joints are all, or those that a controller names where the table is its reference.
    """
    above, _, last = motion.rpartition(".")
    if above:
        within = root.get(above)
        assert isinstance(within, nodes.Mapping)
        driven = within.get("joints")
        if isinstance(driven, nodes.Sequence):
            joints = [x.text for x in driven.items if isinstance(x, nodes.Scalar)]
        own = _named_columns(within, last, motion, joints)
        return root.replaced(root.key(above) or nodes.scalar(within, above), own)
    return _named_columns(root, last, motion, joints)


def _named_columns(within: nodes.Mapping, last: str, motion: str, joints: Sequence[str]) -> nodes.Mapping:
    table = within.get(last)
    assert isinstance(table, nodes.Mapping)
    rows = table.get("rows")
    first = rows.items[0] if isinstance(rows, nodes.Sequence) and rows.items else None
    if not isinstance(first, nodes.Sequence) or not joints:
        return within
    count, left = divmod(len(first.items) - 1, len(joints))
    if left or not 1 <= count <= 3:
        needed = ", ".join(str(1 + k * len(joints)) for k in (1, 2, 3))
        raise nodes.located(
            first, f"{motion}.rows.0", f"has {len(first.items)} numbers for the joints {', '.join(joints)}; needed "
            f"without 'columns': {needed} (t, positions, rates, accelerations)",
        )  # fmt: skip
    names = ["t", *(f"{sign}{joint}" for sign in ("", "qd.", "qdd.")[:count] for joint in joints)]
    columns = nodes.sequence(table, [nodes.scalar(table, name) for name in names])
    key = nodes.scalar(table, "columns")
    return within.replaced(within.key(last) or key, table.replaced(key, columns))


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

"""Load a scene: YAML to tree, files and options brought in, read, checked."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence

from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.checks.scene import validate
from robodyn_cli.scene.read import Names, Reader
from robodyn_cli.scene.text import overrides as options
from robodyn_cli.scene.text.emit import emit
from robodyn_cli.scene.text.includes import Includer
from robodyn_cli.scene.text.nodes import Mapping, Node, Scalar, Source, describe_node, located
from robodyn_cli.scene.text.nodes import Sequence as SequenceNode
from robodyn_cli.scene.text.yaml_nodes import compose
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import Section

NO_FILE = "<text>"


def load_scene(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Return the checked scene of a YAML file.

    Parameters
    ----------
    path : the file.
    overrides : ``key.path=value`` texts that replace values, in order.

    Raises
    ------
    SceneError : anything that is not allowed, with file, line, column and key.
    """
    includer = Includer()
    name = os.fspath(path)
    return _load(includer.open_root(name), name, overrides, includer)


def load_scene_text(text: str, path: str = NO_FILE, overrides: Sequence[str] = ()) -> Scene:
    """Return the checked scene of a YAML text; files that it names are relative to the folder of ``path``."""
    directory = "." if path == NO_FILE else os.path.dirname(path) or "."
    real = "" if path == NO_FILE else os.path.realpath(path)
    return _load(compose(text, Source(path, directory, real)), path, overrides, Includer())


def completed(root: Node, overrides: Sequence[str], includer: Includer) -> Node:
    """Return the tree of a scene with its overrides, and whole: nothing left to be included.

    Raises
    ------
    SceneError : the scene is no map; an override or a file that is included is wrong.
    """
    kind = Section(Scene)
    if not isinstance(root, Mapping):
        raise located(root, "", f"a scene is a map of keys and values (value {describe_node(root)})")
    for override in overrides:
        root = options.apply(root, kind, override, root.source.directory, includer)
    return includer.whole(kind, root)


def _load(root: Node, path: str, overrides: Sequence[str], includer: Includer) -> Scene:
    root = completed(root, overrides, includer)
    scene = validate(Reader(formula_names(root)).read(Scene, root), root)
    return dataclasses.replace(
        scene, path=path, text=emit(root), sources=tuple(dict.fromkeys(includer.sources))
    )


def formula_names(root: Node) -> Names:
    """Return the names that formulas may use, as far as the tree can be understood before it is read."""
    robot = root.get("robot") if isinstance(root, Mapping) else None
    joints = robot.get("joints") if isinstance(robot, Mapping) else None
    moving: list[str] = []
    rates: list[str] = []
    fixed: list[str] = []
    types: dict[str, str] = {}
    for joint in joints.items if isinstance(joints, SequenceNode) else ():
        name, type_ = (joint.get("name"), joint.get("type")) if isinstance(joint, Mapping) else (None, None)
        kind = joint_types.get(type_.text) if isinstance(type_, Scalar) else None
        if isinstance(name, Scalar):
            if kind is not None and kind.nv == 0:
                fixed.append(name.text)
                continue
            moving += kind.coordinates(name.text, kind.names) if kind else (name.text,)
            rates += kind.coordinates(name.text, kind.v_names) if kind else (name.text,)
            types[name.text] = type_.text if isinstance(type_, Scalar) else ""
    parameters = root.get("parameters") if isinstance(root, Mapping) else None
    keys = [key.text for key, _ in parameters.entries] if isinstance(parameters, Mapping) else []
    return Names(tuple(moving), tuple(keys), tuple(fixed), tuple(rates), types)

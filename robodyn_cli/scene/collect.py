"""All errors of a scene at once: the loader's own steps, made to go on after an error."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.record import record
from robodyn_cli.scene.checks.scene import validate
from robodyn_cli.scene.load import completed, formula_names
from robodyn_cli.scene.read import BROKEN, Reader
from robodyn_cli.scene.text.emit import emit
from robodyn_cli.scene.text.includes import Includer
from robodyn_cli.scene.text.nodes import Mapping, Node, Path, Source
from robodyn_cli.scene.text.nodes import Scalar as ScalarNode
from robodyn_cli.scene.text.yaml_nodes import compose, read_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import Kind, ListOf, MapOf, Name, Section


@record
class Examined:
    """A scene as far as it could be read: ``scene`` only if there is no error; ``root`` is its tree."""

    errors: tuple[SceneError, ...]
    scene: Scene | None = None
    root: Node | None = None


def examine(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Examined:
    """Return every error of a scene file, in the order of the files' lines.

    Errors that only follow from another one, in the same key or above or below it, are left out.
    """
    errors: list[SceneError] = []
    name = os.fspath(path)
    try:
        scene, root = _examine(name, overrides, errors)
    except SceneError as error:
        errors.append(error)
        scene = root = None
    errors = _in_order(errors)
    return Examined(tuple(errors), None if errors else scene, root)


def _examine(name: str, overrides: Sequence[str], errors: list[SceneError]) -> tuple[Scene | None, Node]:
    includer = _Includer(errors)
    root = completed(includer.open_root(name), overrides, includer)
    found = list(errors)
    reader = _Reader(root)
    scene = reader.value(Section(Scene), root, ())
    errors += _new(reader.errors, found)
    if scene is not BROKEN:
        checks: list[SceneError] = []
        try:
            scene = validate(scene, root, checks)
        except SceneError as error:
            checks.append(error)
        errors += _new(_without_broken_points(checks, errors), errors)
    if errors:
        return None, root
    sources = tuple(dict.fromkeys(includer.sources))
    return dataclasses.replace(scene, path=name, text=emit(root), sources=sources), root


def _key(error: SceneError) -> str:
    return str(error.details.get("key", ""))


def _new(errors: list[SceneError], known: Sequence[SceneError]) -> list[SceneError]:
    """Return the errors that are not about the same key as a known one, or above or below it."""

    def related(a: str, b: str) -> bool:
        return a == b or (a != "" and b.startswith(a + ".")) or (b != "" and a.startswith(b + "."))

    return [e for e in errors if not any(_key(k) and related(_key(e), _key(k)) for k in known)]


def _without_broken_points(checks: list[SceneError], known: Sequence[SceneError]) -> list[SceneError]:
    """Leave out complaints about unknown points where it is the points that could not be read."""
    if any(_key(error).startswith(("robot.points", "robot.frames")) for error in known):
        return [e for e in checks if "unknown point" not in e.message]
    return checks


def _in_order(errors: list[SceneError]) -> list[SceneError]:
    """Return errors file by file and line by line, each once."""
    files = list(dict.fromkeys(str(e.details.get("file")) for e in errors))

    def place(e: SceneError) -> tuple[int, int, int]:
        line, column = e.details.get("line") or 0, e.details.get("column") or 0
        return files.index(str(e.details.get("file"))), line, column

    return sorted({e.message: e for e in errors}.values(), key=place)


class _Includer(Includer):
    """Goes on without a file that cannot be brought in."""

    def __init__(self, errors: list[SceneError]) -> None:
        super().__init__()
        self.errors = errors

    def open_root(self, path: str) -> Node:
        text = read_text(path, None, "", path)
        self.sources.append(path)
        source = Source(path, os.path.dirname(path) or ".", os.path.realpath(path))
        return compose(text, source, collected=self.errors)

    def here(self, kind: Kind, node: Node, path: Path) -> Node:
        try:
            return super().here(kind, node, path)
        except SceneError as error:
            return self._without(error, node, path)

    def csv(self, kind: Any, key: str, section: Mapping, path: Path) -> Mapping:
        try:
            return super().csv(kind, key, section, path)
        except SceneError as error:
            self._without(error, section, (*path, key))
            return section

    def _without(self, error: SceneError, node: Node, path: Path) -> Node:
        # an error inside the file has a key of its own; that the value is missing follows from it
        key = ".".join(str(step) for step in path)
        error.details["key"] = key
        self.errors.append(error)
        return node


class _Reader(Reader):
    """Collects errors; what cannot be read is broken, and so is what cannot do without it."""

    def __init__(self, root: Node) -> None:
        super().__init__(formula_names(root))
        self.errors: list[SceneError] = []

    def report(self, error: SceneError) -> None:
        self.errors.append(error)

    def value(self, kind: Kind, node: Node, path: Path, unit: str = "") -> Any:
        try:
            return super().value(kind, node, path, unit)
        except SceneError as error:
            self.errors.append(error)
            return BROKEN

    def make(self, cls: type, values: dict[str, Any]) -> Any:
        known = {name: value for name, value in values.items() if value is not BROKEN}
        if cls is Scene:
            # the other checks can do without these
            known = {"schema": 1, "gravity": (0.0, 0.0, 0.0), **known}
        needed = [
            f.name
            for f in dataclasses.fields(cls)
            if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
        ]
        return cls(**known) if all(name in known for name in needed) else BROKEN

    def name(self, kind: Name, node: Node, path: Path, unit: str) -> str:
        try:
            return super().name(kind, node, path, unit)
        except SceneError as error:
            if not isinstance(node, ScalarNode) or not isinstance(node.value, str):
                raise
            # a bad name still tells things apart, and without it nothing of the list could be checked
            self.errors.append(error)
            return node.text

    def list_of(self, kind: ListOf, node: Node, path: Path, unit: str) -> Any:
        found = super().list_of(kind, node, path, unit)
        return BROKEN if any(x is BROKEN for x in found) else found

    def map_of(self, kind: MapOf, node: Node, path: Path, unit: str) -> dict[str, Any]:
        if not isinstance(node, Mapping):
            return super().map_of(kind, node, path, unit)
        result = {}
        for key, item in node.entries:
            try:
                self.check_name(kind.of, key, (*path, key.text))
            except SceneError as error:
                self.errors.append(error)
            value = self.value(kind.item, item, (*path, key.text), unit)
            if value is not BROKEN:
                result[key.text] = value
        return result


def is_part(path: str | os.PathLike[str]) -> bool:
    """Tell whether a YAML file is made to be included by scenes (a robot, a trajectory), not a scene itself."""
    try:
        root = Includer().open_root(os.fspath(path))
    except SceneError:
        return False
    if not isinstance(root, Mapping):
        return not isinstance(root, ScalarNode)
    return not any(root.get(key) is not None for key in ("schema", "robot", "command"))

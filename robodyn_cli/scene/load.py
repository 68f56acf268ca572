"""Load a scene: YAML to a tree, included files and options, reading, checks; all errors are collected."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import os
from collections.abc import Callable, Sequence
from collections.abc import Mapping as MappingOf
from typing import TYPE_CHECKING, Any

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.record import record
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.checks.scene import check_scene
from robodyn_cli.scene.points import PartlyRead
from robodyn_cli.scene.read import Reader
from robodyn_cli.scene.read_scalars import BROKEN, Names
from robodyn_cli.scene.text.includes import Includer
from robodyn_cli.scene.text.nodes import (
    IN_PYTHON,
    Faults,
    Mapping,
    Node,
    Scalar,
    Source,
    TooMany,
    describe_node,
    key_of,
    located,
)
from robodyn_cli.scene.text.nodes import Sequence as SequenceNode
from robodyn_cli.scene.text.yaml_text import compose, emit
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import Section

if TYPE_CHECKING:
    from robodyn_cli.scene.text.values import Overrides

NO_FILE = "<text>"
# what a scene is read from: a file, its text, the keys and values of a map, or a scene that was read before
GivenScene = str | os.PathLike[str] | MappingOf[str, Any] | Scene
# keys without which the rest of a scene can be checked
STAND_INS: dict[str, Any] = {"schema": 1, "gravity": (0.0, 0.0, 0.0)}


@record
class Examined:
    """A scene as far as it could be read: ``scene`` only without errors; ``root`` is its tree."""

    errors: tuple[SceneError, ...]
    scene: Scene | None = None
    root: Node | None = None

    def checked(self) -> Scene:
        """Return the scene.

        Raises
        ------
        SceneError : the first of the errors, with the messages of all others among its details.
        """
        if self.scene is None:
            first, *others = self.errors
            if others:
                first.details = {**first.details, "others": [error.message for error in others]}
            raise first
        return self.scene


def load_scene(source: GivenScene, overrides: Overrides = ()) -> Scene:
    """Return the checked scene of a YAML file, of a text or of data of Python.

    Parameters
    ----------
    source : the file's path; its text, which has more than one line; a map with the keys of a scene, whose arrays are
        lists, and whose ``trajectory`` and ``control.reference`` may be tuples of arrays ``(t, q)``, ``(t, q, qd)`` or
        ``(t, q, qd, qdd)``; or a scene, which is returned as it is unless there are overrides. Files that a text or a
        map names are relative to the working directory.
    overrides : values by key, ``{"robot.links.link1.mass": 3.0}`` or nested; or ``key.path=value`` texts, in order.

    Raises
    ------
    SceneError : the first thing that is not allowed, with file, line, column and key.
    """
    if isinstance(source, Scene) and not overrides:
        return source
    return examine(source, overrides).checked()


def load_scene_text(text: str, path: str = NO_FILE, overrides: Overrides = ()) -> Scene:
    """Return the checked scene of a YAML text; files that it names are relative to the folder of ``path``."""
    return _examined_text(text, path, _texts(overrides)).checked()


def _examined_text(text: str, path: str, overrides: Sequence[str] = ()) -> Examined:
    of_file = path not in (NO_FILE, IN_PYTHON)
    directory = (os.path.dirname(path) or ".") if of_file else "."
    real = os.path.realpath(path) if of_file else ""
    source = Source(path, directory, real)
    return examine_root(lambda includer: compose(text, source, includer.faults), path, overrides)


def examine(source: GivenScene, overrides: Overrides = ()) -> Examined:
    """Return the scene of a source, as of ``load_scene``, and every error in it, in the order of the files' lines.

    Errors that follow from another one (in the same key, or above or below it) are left out.

    Raises
    ------
    SceneError : what is given is no source of a scene, or data that no scene holds.
    """
    texts = _texts(overrides)
    if isinstance(source, Scene):
        return _examined_again(source, texts)
    if isinstance(source, MappingOf):
        from robodyn_cli.scene.text.values import node_of

        root = node_of(source)
        return examine_root(lambda includer: root, IN_PYTHON, texts)
    if isinstance(source, str) and "\n" in source:
        return _examined_text(source, NO_FILE, texts)
    if not isinstance(source, (str, os.PathLike)):
        raise SceneError(
            f"{shown(source)} of type {type(source).__name__} is no scene; allowed: a path, a text, a map, or a scene "
            "that was loaded"
        )
    name = os.fspath(source)
    return examine_root(lambda includer: includer.open_root(name), name, texts)


def _texts(overrides: Overrides) -> tuple[str, ...]:
    """Return overrides as texts ``key.path=value``; most are."""
    if isinstance(overrides, (list, tuple)) and all(isinstance(x, str) for x in overrides):
        return tuple(overrides)
    from robodyn_cli.scene.text.values import settings

    return tuple(settings(overrides))


def _examined_again(scene: Scene, overrides: Sequence[str]) -> Examined:
    """Return a scene that was read before with other values of keys; a function that controls it stays.

    Raises
    ------
    SceneError : as of ``_own_text``.
    """
    if not overrides:
        return dataclasses.replace(_examined_text(scene.text, scene.path), scene=scene)
    _own_text(scene)
    examined = _examined_text(scene.text, scene.path, overrides)
    given, changed = scene.control, examined.scene
    if changed is None or not all(x is not None and x.type == "python" for x in (given, changed.control)):
        return examined
    control = dataclasses.replace(changed.control, function=given.function)
    return dataclasses.replace(examined, scene=dataclasses.replace(changed, control=control))


def _own_text(scene: Scene) -> Examined:
    """Return what the text of a scene holds, which is the scene itself.

    Raises
    ------
    SceneError : the scene was changed in Python, so that its text is no longer what it is.
    """
    examined = _examined_text(scene.text, scene.path)
    if examined.scene != scene:
        raise SceneError(
            "the scene was changed in Python after it was loaded, so there is no text in which keys "
            "could have other values; allowed: scenes as they were loaded",
            (scene.path,),
        )
    return examined


class Family:
    """Scenes that differ in the values of some keys; their file is read once, and other processes get what was read.

    own : the scene as it stands, with the given overrides. found : what others have found of its keys, by name, so that
    they look once.

    Raises
    ------
    SceneError : the scene as it stands is wrong.
    """

    _positions: dict[str, float] | None = None  # in place of those that the scenes give

    def __init__(self, source: GivenScene, overrides: Overrides = ()) -> None:
        self.overrides = _texts(overrides)
        if isinstance(source, Scene):
            examined = examine(source, self.overrides) if overrides else _own_text(source)
            self._take(source.path, examined)
        else:
            examined = examine(source, self.overrides)
            self._take(examined.checked().path, examined)

    def _take(self, path: str, examined: Examined) -> None:
        self.path = path
        self.own = examined.checked()
        assert examined.root is not None
        self.root: Node = examined.root
        self.found: dict[str, Any] = {}

    @staticmethod
    def of(scene: GivenScene | Family) -> Family:
        """Return the family of a scene: of a file, or of one that was read before, with the files that it read then."""
        return scene if isinstance(scene, Family) else Family(scene)

    def with_values(self, overrides: Sequence[str]) -> Family:
        """Return the family of the scene with values of its own.

        Raises
        ------
        SceneError : a value is not allowed, or a key does not exist.
        """
        family = Family.__new__(Family)
        family.overrides = (*self.overrides, *overrides)
        family._take(self.path, examine_root(lambda includer: self.root, self.path, overrides))
        return family

    def scene(self, overrides: Sequence[str]) -> Scene:
        """Return the scene with values of its own.

        Raises
        ------
        SceneError : a value is not allowed, or a key does not exist.
        """
        scene = examine_root(lambda includer: self.root, self.path, overrides).checked()
        if self._positions is None:
            return scene
        return dataclasses.replace(scene, initial=dataclasses.replace(scene.initial, q=self._positions))

    def starting_at(self, positions: dict[str, float]) -> Family:
        """Return the family of the same scenes with other initial positions, by coordinate [rad or m]."""
        family = copy.copy(self)
        family._positions, family.found = positions, {}
        return family


def examine_root(open_root: Callable[[Includer], Node], path: str, overrides: Sequence[str]) -> Examined:
    """Return the scene of a tree, which ``open_root`` gives, as ``examine`` does; path : where it lies."""
    faults = Faults()
    includer = Includer(faults)
    scene: Scene | None = None
    root: Node | None = None
    with contextlib.suppress(TooMany), faults:
        root = _completed(open_root(includer), overrides, includer)
        scene = _checked(root, faults)
    if scene is None or root is None or faults.found:
        return Examined(tuple(faults.in_order()), None, root)
    sources = tuple(dict.fromkeys(includer.sources))
    scene = dataclasses.replace(
        scene,
        path=path,
        text=emit(root),
        sources=sources,
        notes=_notes(includer, scene)
        if includer.descriptions or includer.undrawn or includer.unnamed
        else (),
        warnings=tuple(
            dict.fromkeys(
                (
                    *scene.warnings,
                    *(f"{one.file}: {x}" for one in includer.descriptions for x in one.warnings),
                )
            )
        ),
    )
    return Examined((), scene, root)


def _notes(includer: Includer, scene: Scene) -> tuple[str, ...]:
    """Return what there is to say of files in other formats and of arrays as a motion, each once."""
    notes = [f"{one.file}: {text}" for one in includer.descriptions for text in one.notes]
    undrawn = list(dict.fromkeys(includer.undrawn))
    if undrawn:
        notes.append(f"meshes left out of pictures: {len(undrawn)}; the first: {undrawn[0]}")
    for key in includer.unnamed:
        motion = scene.trajectory if key == "trajectory" else scene.control and scene.control.reference
        if motion is not None:
            notes.append(f"{key}: {motion.told()}")
    return tuple(dict.fromkeys(notes))


def _completed(root: Node, overrides: Sequence[str], includer: Includer) -> Node:
    """Return the tree of a scene with its overrides and all included files.

    Raises
    ------
    SceneError : the scene is no map; an override is wrong.
    """
    kind = Section(Scene)
    if not isinstance(root, Mapping):
        raise located(root, "", f"a scene is a map of keys and values (value {describe_node(root)})")
    if root.get("drives") is not None:
        from robodyn_cli.scene.text.catalogue import with_catalogue

        root = with_catalogue(root)
    if overrides:
        from robodyn_cli.scene.text.overrides import apply

        for override in overrides:
            try:
                root = apply(root, kind, override, root.source.directory, includer)
            except SceneError as error:
                includer.faults.add_unrelated([error])
        if isinstance(root, Mapping) and root.get("drives") is not None:
            from robodyn_cli.scene.text.catalogue import with_catalogue

            root = with_catalogue(root)
    root = includer.whole(kind, root)
    if not isinstance(root, Mapping) or not _has_table(root):
        return root
    from robodyn_cli.scene.text.values import unnamed_tables, with_columns

    includer.unnamed = unnamed_tables(root)
    for motion in includer.unnamed:
        root = with_columns(root, motion, formula_names(root).joints)
    return root


def _has_table(root: Mapping) -> bool:
    """Tell whether a motion of a scene may be a table: the module for these is loaded for no other."""
    control = root.get("control")
    given = [root.get("trajectory"), control.get("reference") if isinstance(control, Mapping) else None]
    return any(isinstance(one, Mapping) and one.get("rows") is not None for one in given)


def _checked(root: Node, faults: Faults) -> Scene | None:
    """Return the scene of a whole tree, read and checked; None where too little of it could be read."""
    reading = Faults()
    scene = BROKEN
    reader = Reader(formula_names(root), reading, STAND_INS)
    with contextlib.suppress(TooMany):
        scene = reader.value(Section(Scene), root, ())
    faults.add_unrelated(reading.found)
    if scene is BROKEN:
        return None
    if any(key.startswith(("robot.points", "robot.frames")) for key in faults.keys):
        robot = dataclasses.replace(scene.robot, points=PartlyRead(scene.robot.points))
        scene = dataclasses.replace(scene, robot=robot)
    check = Check(root)
    with contextlib.suppress(TooMany), check:
        scene = check_scene(scene, check)
    errors = check.found
    if any(key.startswith("catalogue") for key in faults.keys):
        errors = [
            e for e in errors if not key_of(e).startswith("drives.")
        ]  # what it lacks may be what is wrong in it
    faults.add_unrelated(errors, sections=True)
    return dataclasses.replace(scene, warnings=tuple(dict.fromkeys(reader.doubts)))


def formula_names(root: Node) -> Names:
    """Return the names that formulas may use, as far as the tree can be understood before it is read."""
    robot = root.get("robot") if isinstance(root, Mapping) else None
    joints = robot.get("joints") if isinstance(robot, Mapping) else None
    moving: list[str] = []
    rates: list[str] = []
    fixed: list[str] = []
    types: dict[str, str] = {}
    units: dict[str, str] = {}
    for joint in joints.items if isinstance(joints, SequenceNode) else ():
        name, type_ = (joint.get("name"), joint.get("type")) if isinstance(joint, Mapping) else (None, None)
        kind = joint_types.get(type_.text) if isinstance(type_, Scalar) else None
        if isinstance(name, Scalar):
            if kind is not None and kind.nv == 0:
                fixed.append(name.text)
                continue
            moving += kind.coordinates(name.text, kind.names) if kind else (name.text,)
            rates += kind.coordinates(name.text, kind.v_names) if kind else (name.text,)
            if kind is not None:
                units |= zip(kind.coordinates(name.text, kind.v_names), kind.v_units)
                units |= zip(kind.coordinates(name.text, kind.names), kind.units)
            types[name.text] = type_.text if isinstance(type_, Scalar) else ""
    parameters = root.get("parameters") if isinstance(root, Mapping) else None
    keys = [key.text for key, _ in parameters.entries] if isinstance(parameters, Mapping) else []
    control = root.get("control") if isinstance(root, Mapping) else None
    states = _controller_states(control, moving) if isinstance(control, Mapping) else ()
    return Names(tuple(moving), tuple(keys), tuple(fixed), tuple(rates), types, states, units)


def _controller_states(control: Mapping, joints: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the states that a controller has: those of its own, or its integrals."""
    kind, own = control.get("type"), control.get("state")
    if isinstance(kind, Scalar) and kind.text == "pid":
        return tuple(f"integral.{name}" for name in joints)
    return tuple(key.text for key, _ in own.entries) if isinstance(own, Mapping) else ()

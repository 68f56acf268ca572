"""Load a scene: YAML to a tree, included files and options, reading, checks; all errors are collected."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Sequence
from collections.abc import Mapping as MappingOf
from typing import TYPE_CHECKING, Any

from robodyn_cli.errors import SceneError
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.record import record
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.checks.scene import check_scene
from robodyn_cli.scene.read import Reader
from robodyn_cli.scene.read_scalars import BROKEN, Names
from robodyn_cli.scene.text.includes import Includer, is_xml
from robodyn_cli.scene.text.nodes import (
    Faults,
    Mapping,
    Node,
    Scalar,
    Source,
    TooMany,
    describe_node,
    located,
    mapping,
    scalar,
    sequence,
)
from robodyn_cli.scene.text.nodes import Sequence as SequenceNode
from robodyn_cli.scene.text.yaml_text import compose, emit, read_text
from robodyn_cli.scene.types import Robot, Scene
from robodyn_cli.schema.fields import OrFile, Section

if TYPE_CHECKING:
    from robodyn_cli.scene.dialects import Description

NO_FILE = "<text>"
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
        SceneError : the first of the errors.
        """
        if self.scene is None:
            raise self.errors[0]
        return self.scene


def load_scene(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Return the checked scene of a YAML file.

    Parameters
    ----------
    path : the file.
    overrides : ``key.path=value`` texts that replace values, in order.

    Raises
    ------
    SceneError : the first thing that is not allowed, with file, line, column and key.
    """
    return examine(path, overrides).checked()


def load_scene_text(text: str, path: str = NO_FILE, overrides: Sequence[str] = ()) -> Scene:
    """Return the checked scene of a YAML text; files that it names are relative to the folder of ``path``."""
    return _examined_text(text, path, overrides).checked()


def _examined_text(text: str, path: str, overrides: Sequence[str] = ()) -> Examined:
    directory = "." if path == NO_FILE else os.path.dirname(path) or "."
    real = "" if path == NO_FILE else os.path.realpath(path)
    source = Source(path, directory, real)
    return _examine(lambda includer: compose(text, source, includer.faults), path, overrides)


def load_description(
    path: str | os.PathLike[str],
    packages: MappingOf[str, str] | None = None,
    overrides: Sequence[str] = (),
) -> tuple[Description, Scene]:
    """Return the robot of a file in another format, and a checked scene that holds nothing else.

    packages : folders of packages of meshes, by name. overrides : as of ``load_scene``, of the scene.

    Raises
    ------
    SceneError : the first thing that is not allowed, with file and line.
    """
    name = os.fspath(path)
    place = Scalar(Source(name, ".", positions=False), 1, 1, "", None)
    found: list[Description] = []

    def open_root(includer: Includer) -> Node:
        includer.packages = packages or {}
        robot = includer.include(OrFile(Section(Robot), robot=True), scalar(place, name), ())
        found.extend(includer.descriptions)
        if not found:
            raise located(
                place, "", "this is no URDF, SDF or MJCF, whose first character is '<'; allowed: one of them"
            )
        gravity = sequence(place, [scalar(place, 0)] * 3)
        values = {"schema": scalar(place, 1), "gravity": gravity, "robot": robot}
        return mapping(place, [(scalar(place, key), value) for key, value in values.items()])

    scene = _examine(open_root, name, overrides).checked()
    return found[0], scene


def load_robot(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Return the scene of a file, or of a robot in another format one with gravity along -z, 9.81 m/s^2.

    Raises
    ------
    SceneError : as of ``load_scene`` and ``load_description``.
    """
    name = os.fspath(path)
    if not is_xml(read_text(name, None, "", name)):
        return load_scene(path, overrides)
    return load_description(path, overrides=("gravity=[0, 0, -9.81]", *overrides))[1]


def examine(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Examined:
    """Return the scene of a YAML file and every error in it, in the order of the files' lines.

    Errors that follow from another one (in the same key, or above or below it) are left out.
    """
    name = os.fspath(path)
    return _examine(lambda includer: includer.open_root(name), name, overrides)


class Family:
    """Scenes that differ in the values of some keys; their file is read once, and other processes get what was read.

    own : the scene as it stands, with the given overrides.

    Raises
    ------
    SceneError : the scene as it stands is wrong.
    """

    def __init__(self, path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> None:
        self.overrides = tuple(overrides)
        self._take(os.fspath(path), examine(path, overrides))

    def _take(self, path: str, examined: Examined) -> None:
        self.path = path
        self.own = examined.checked()
        assert examined.root is not None
        self.root: Node = examined.root

    @staticmethod
    def of(scene: Scene | Family | str | os.PathLike[str]) -> Family:
        """Return the family of a scene: of a file, or of one that was read before, with the files that it read then."""
        if isinstance(scene, Family):
            return scene
        if not isinstance(scene, Scene):
            return Family(scene)
        family = Family.__new__(Family)
        family.overrides = ()
        family._take(scene.path, _examined_text(scene.text, scene.path))
        return family

    def with_values(self, overrides: Sequence[str]) -> Family:
        """Return the family of the scene with values of its own.

        Raises
        ------
        SceneError : a value is not allowed, or a key does not exist.
        """
        family = Family.__new__(Family)
        family.overrides = (*self.overrides, *overrides)
        family._take(self.path, _examine(lambda includer: self.root, self.path, overrides))
        return family

    def scene(self, overrides: Sequence[str]) -> Scene:
        """Return the scene with values of its own.

        Raises
        ------
        SceneError : a value is not allowed, or a key does not exist.
        """
        return _examine(lambda includer: self.root, self.path, overrides).checked()


def _examine(open_root: Callable[[Includer], Node], path: str, overrides: Sequence[str]) -> Examined:
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
        notes=_notes(includer) if includer.descriptions or includer.undrawn else (),
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


def _notes(includer: Includer) -> tuple[str, ...]:
    """Return what there is to say of files in other formats, each once."""
    notes = [f"{one.file}: {text}" for one in includer.descriptions for text in one.notes]
    undrawn = list(dict.fromkeys(includer.undrawn))
    if undrawn:
        notes.append(f"meshes left out of pictures: {len(undrawn)}; the first: {undrawn[0]}")
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
    return includer.whole(kind, root)


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
    check = Check(root)
    with contextlib.suppress(TooMany), check:
        scene = check_scene(scene, check)
    errors = check.found
    if any(key.startswith(("robot.points", "robot.frames")) for key in faults.keys):
        # the points could not be read; references to them are right
        errors = [e for e in errors if "unknown point" not in e.message]
    if any(key.startswith("catalogue") for key in faults.keys):
        errors = [
            e for e in errors if " drives." not in e.message
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


def is_part(path: str | os.PathLike[str]) -> bool:
    """Tell whether a YAML file is made to be included by scenes (a robot, a trajectory), not a scene itself."""
    try:
        root = Includer(Faults()).open_root(os.fspath(path))
    except SceneError:
        return False
    if not isinstance(root, Mapping):
        return not isinstance(root, Scalar)
    return not any(root.get(key) is not None for key in ("schema", "robot", "command"))

"""Read scalars of a tree (numbers, words, names, formulas) and values by joint; complaints name file, line and key.

Values by joint are flat, by column: ``slide.theta``, ``ball.qw``. Attitudes may be given as a quaternion, as roll,
pitch and yaw or as a rotation vector; numbers become the quaternion, formulas stay under ``ball.rpy``.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable
from typing import Any

from robodyn_cli.errors import SceneError, did_you_mean, shown, unknown_name
from robodyn_cli.expr import formula as fm
from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import (
    Faults,
    Mapping,
    Node,
    Path,
    Scalar,
    Sequence,
    describe_node,
    dotted,
    doubts_of_angle,
    located,
)
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    CsvFile,
    Formula,
    Integer,
    JointMap,
    Kind,
    MeshFile,
    Name,
    Number,
    Text,
    describe,
)

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_IN_FORMULAS = ("joint", "parameter")
BROKEN: Any = object()  # in place of a value that could not be read


@record
class Names:
    """What formulas may refer to."""

    joints: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()  # joints without a coordinate, for a better message
    rates: tuple[str, ...] = ()  # columns of v, where they differ from those of q
    types: dict[str, str] = dataclasses.field(default_factory=dict)  # of the joints
    states: tuple[str, ...] = ()  # of the controller


class ScalarReader:
    """Reads scalars; ``names`` are those that formulas may use, ``faults`` collects errors."""

    def __init__(self, names: Names, faults: Faults) -> None:
        self.names = names
        self.faults = faults
        self.doubts: list[str] = []
        # looked up for each formula: as sets, but in the order of the scene
        self.joints = dict.fromkeys(names.joints)
        self.rates = dict.fromkeys(names.rates or names.joints)
        self.parameters = dict.fromkeys(names.parameters)
        self.handlers: dict[type[Kind], Callable[[Any, Node, Path, str], Any]] = {
            Number: self.number,
            Integer: self.integer,
            Boolean: self.boolean,
            Text: self.text,
            Name: self.name,
            Choice: self.choice,
            Formula: self.formula,
            CsvFile: self.text,
            MeshFile: self.text,
        }

    def value(self, kind: Kind, node: Node, path: Path, unit: str = "") -> Any:
        """Return the value of ``node`` as ``kind`` asks; report a fault and return BROKEN where it cannot be read."""
        with self.faults:
            return self.handlers[type(kind)](kind, node, path, unit)
        return BROKEN

    def wrong(self, kind: Kind, node: Node, path: Path, unit: str, fault: str = "") -> SceneError:
        """Return the error of a value that ``kind`` does not allow."""
        allowed = describe(kind, unit)
        if isinstance(node, Scalar) and node.value is None and not fault:
            return located(node, dotted(path), f"has no value; allowed: {allowed}")
        if isinstance(node, Scalar) and type(node.value) in (int, float):
            fault = fault or "is a number"
        fault = fault or "is not allowed here"
        return located(node, dotted(path), f"{fault} (value {describe_node(node)}); allowed: {allowed}")

    @staticmethod
    def unknown(kind: Kind, node: Scalar, path: Path, hint: str) -> SceneError:
        """Return the error of a word that is none of the choices."""
        return located(
            node, dotted(path), f"unknown choice {shown(node.text)}{hint}; allowed: {describe(kind)}"
        )

    def number(self, kind: Number, node: Node, path: Path, unit: str) -> float:
        value = self.plain_number(kind, node, path, unit, kind.angle)
        self.check_range(kind, value, node, path, unit)
        return value

    def plain_number(self, kind: Kind, node: Node, path: Path, unit: str, angle: bool) -> float:
        """Return a finite number, from a number or from text that is a constant formula."""
        if not isinstance(node, Scalar) or node.value is None or isinstance(node.value, bool):
            raise self.wrong(kind, node, path, unit)
        if not isinstance(node.value, str):
            value = self.finite(node, path)
            if angle and abs(value) > math.tau:
                self.doubts += doubts_of_angle(value, node, path)
            return value
        tree = self.parse(kind, node, path, unit)
        if tree.constant is None:
            name = sorted(tree.names)[0]
            raise self.wrong(kind, node, path, unit, f"is not a number: {name!r} is part of it")
        if tree.degrees and not angle:
            raise self.wrong(kind, node, path, unit, "'deg' does not fit: this is not an angle")
        return tree.constant

    def finite(self, node: Scalar, path: Path) -> float:
        value = float(node.value) if isinstance(node.value, (int, float)) else math.nan
        if not math.isfinite(value):
            raise located(
                node, dotted(path), f"is not finite (value {describe_node(node)}); allowed: a finite number"
            )
        return value

    def check_range(self, kind: Number | Integer, value: float, node: Node, path: Path, unit: str) -> None:
        low, high = kind.minimum, kind.maximum
        if low is not None and low == high and value != low:
            raise self.wrong(kind, node, path, unit, "is not known here")
        strict = isinstance(kind, Number) and kind.exclusive
        if low is not None and (value < low or (strict and value == low)):
            raise self.wrong(kind, node, path, unit, "is too small")
        if high is not None and (value > high or (strict and value == high)):
            raise self.wrong(kind, node, path, unit, "is too large")

    def integer(self, kind: Integer, node: Node, path: Path, unit: str) -> int:
        value = self.plain_number(kind, node, path, unit, False)
        if not value.is_integer():
            raise self.wrong(kind, node, path, unit, "is not a whole number")
        self.check_range(kind, value, node, path, unit)
        return int(value)

    def boolean(self, kind: Boolean, node: Node, path: Path, unit: str) -> bool:
        if not isinstance(node, Scalar) or not isinstance(node.value, bool):
            raise self.wrong(kind, node, path, unit)
        return node.value

    def text(self, kind: Kind, node: Node, path: Path, unit: str) -> str:
        if isinstance(node, Scalar) and isinstance(node.value, str):
            return node.value
        fault = "is not text; put it in quotes" if isinstance(node, Scalar) and node.value is not None else ""
        raise self.wrong(kind, node, path, unit, fault)

    def name(self, kind: Name, node: Node, path: Path, unit: str) -> str:
        if not isinstance(node, Scalar) or node.value is None:
            raise self.wrong(kind, node, path, unit)
        try:
            self.check_name(kind.of, node, path)
        except SceneError as error:
            if not isinstance(node.value, str):
                raise
            # keep a bad name: it still distinguishes entries, and the rest of the list can be checked
            self.faults.report(error)
        return node.text

    def check_name(self, of: str, node: Scalar, path: Path) -> None:
        """Refuse what cannot be a name, and words that mean something else in formulas."""
        if not _NAME.fullmatch(node.text):
            fault = (
                f"{shown(node.text)} cannot be the name of a {of}" if of else f"{shown(node.text)} is no name"
            )
            raise located(
                node, dotted(path), f"{fault}; allowed: letters, digits, _ and -, not first a digit"
            )
        if of in _IN_FORMULAS and "-" in node.text:
            message = f"{shown(node.text)}: '-' is a sign in formulas; allowed: letters, digits, _"
            raise located(node, dotted(path), message)
        if of in _IN_FORMULAS and node.text in fm.RESERVED:
            raise located(
                node, dotted(path), f"{shown(node.text)} has a meaning in formulas; choose another name"
            )

    def choice(self, kind: Choice, node: Node, path: Path, unit: str) -> str:
        if not isinstance(node, Scalar):
            raise self.wrong(kind, node, path, unit)
        if node.text not in kind.options or not isinstance(node.value, str):
            hint = did_you_mean(node.text, kind.options)
            if not node.text:
                raise self.wrong(kind, node, path, unit)
            raise self.unknown(kind, node, path, hint)
        return node.text

    def formula(self, kind: Formula, node: Node, path: Path, unit: str) -> fm.FormulaTree:
        if not isinstance(node, Scalar) or node.value is None or isinstance(node.value, bool):
            raise self.wrong(kind, node, path, unit)
        if not isinstance(node.value, str):
            return fm.FormulaTree.number(self.finite(node, path))
        tree = self.parse(kind, node, path, unit)
        self.check_moving(tree, node, path)
        try:
            tree = tree.resolve(self.joints, self.parameters, kind.variables, self.rates, self.names.states)
        except SceneError as error:
            raise located(node, dotted(path), error.message) from None
        where = str(located(node, dotted(path), "").message).removesuffix(": ")
        return dataclasses.replace(tree, where=where)

    def check_moving(self, tree: fm.FormulaTree, node: Node, path: Path) -> None:
        """Refuse the names of joints without a coordinate."""
        for name in tree.names:
            if name.endswith(")"):
                continue
            parts = name.split(".")
            joint = parts[1] if len(parts) > 1 else name
            if joint in self.names.fixed:
                message = f"joint {joint!r} is fixed: it has no coordinate for a formula"
                raise located(node, dotted(path), f"{message} (value {describe_node(node)})")

    @staticmethod
    def parse(kind: Kind, node: Scalar, path: Path, unit: str) -> fm.FormulaTree:
        try:
            return fm.parse(node.text)
        except SceneError as error:
            raise located(node, dotted(path), f"{error.message}; allowed: {describe(kind, unit)}") from None


ATTITUDES = {"quaternion": 4, "rpy": 3, "rotation_vector": 3}
QUATERNION = ("qw", "qx", "qy", "qz")
POSITION = ("x", "y", "z")
LENGTH = 1e-3  # tolerance of a quaternion's length 1: three digits


def joint_map(reader: ScalarReader, kind: JointMap, node: Node, path: Path, unit: str) -> dict[str, Any]:
    """Return values by column of q or v."""
    if isinstance(node, Scalar) and node.value is None:
        return {}
    if not isinstance(node, Mapping):
        raise reader.wrong(kind, node, path, unit)
    result: dict[str, Any] = {}
    for key, item in node.entries:
        here = (*path, key.text)
        with reader.faults:
            reader.check_name(kind.of, key, here)
            values = joint_values(reader, kind, key.text, item, here, unit)
            result.update({name: value for name, value in values.items() if value is not BROKEN})
    return result


def joint_values(
    reader: ScalarReader, kind: JointMap, name: str, node: Node, path: Path, unit: str
) -> dict[str, Any]:
    """Return what is given for the joint called ``name``, by column.

    Raises
    ------
    SceneError : the value does not fit the joint's coordinates.
    """
    if kind.word and isinstance(node, Scalar) and node.text == kind.word:
        return {name: kind.word}
    joint = joint_types.get(reader.names.types.get(name, ""))
    items = {} if joint is None else _items(kind, joint)
    if joint is None or not items:
        slides = joint is not None and joint.units == ("m",)
        item = _item(kind.item, "m") if slides and kind.coordinates == "q" else kind.item
        return {name: reader.value(item, node, path, unit)}
    names = tuple(items)
    if isinstance(node, Sequence):
        if len(node.items) != len(names):
            raise located(
                node, dotted(path), f"has {len(node.items)} entries; needed: {len(names)}, {', '.join(names)}"
            )
        values = {
            x: reader.value(items[x], item, (*path, k), unit)
            for k, (x, item) in enumerate(zip(names, node.items))
        }
    elif isinstance(node, Mapping):
        values = _from_map(reader, kind, joint, node, path, unit)
    else:
        raise located(
            node, dotted(path), f"{_wanted(joint, kind, name, names)} (value {describe_node(node)})"
        )
    if any(value is BROKEN for value in values.values()):
        return {}
    if joint.quasi and kind.coordinates == "q":
        values = _attitude(kind, joint, values, node, path)
    return {f"{name}.{x}": value for x, value in values.items()}


def _items(kind: JointMap, joint: Joint) -> dict[str, Kind]:
    """Return the kind of each coordinate of a joint; nothing for a single one, which has the joint's own name."""
    if kind.coordinates == "q":
        return {name: _item(kind.item, unit) for name, unit in zip(joint.names, joint.units)}
    return {name: _item(kind.item, unit) for name, unit in zip(joint.v_names, joint.v_units)}


def _item(item: Kind, unit: str) -> Kind:
    """Return the kind of one coordinate: only angles may be written in degrees."""
    return dataclasses.replace(item, angle=unit == "rad") if isinstance(item, Number) else item


def _wanted(joint: Joint, kind: JointMap, name: str, names: tuple[str, ...]) -> str:
    text = (
        f"joint {name!r} is {joint.type} and has {len(names)} coordinates here; allowed: a list or a map of"
    )
    forms = ""
    if joint.quasi and kind.coordinates == "q":
        place = "xyz and " if "x" in joint.names else ""
        forms = f"; or {place}one of {', '.join(ATTITUDES)}"
    return f"{text} {', '.join(names)}{forms}"


def _from_map(
    reader: ScalarReader, kind: JointMap, joint: Joint, node: Mapping, path: Path, unit: str
) -> dict[str, Any]:
    """Return what a map gives: coordinates by name, and lists for ``xyz`` and the forms of an attitude."""
    items = _items(kind, joint)
    groups: dict[str, int] = {}
    if joint.quasi and kind.coordinates == "q":
        groups = dict(ATTITUDES)
        if "x" in joint.names:
            groups["xyz"] = 3
    values: dict[str, Any] = {}
    for key, item in node.entries:
        here = (*path, key.text)
        if key.text in items:
            values[key.text] = reader.value(items[key.text], item, here, unit)
        elif key.text in groups:
            values.update(_group(reader, kind, key, item, groups[key.text], here))
        else:
            allowed = [*items, *groups]
            raise located(key, dotted(here), unknown_name("coordinate", key.text, allowed))
    return values


def _group(
    reader: ScalarReader, kind: JointMap, key: Scalar, node: Node, size: int, path: Path
) -> dict[str, Any]:
    """Return a list of so many entries: positions by coordinate, an attitude under its own name."""
    item = _item(kind.item, "rad" if key.text in ("rpy", "rotation_vector") else "m")
    if not isinstance(node, Sequence) or len(node.items) != size:
        raise located(
            node, dotted(path), f"(value {describe_node(node)}) is not allowed here; allowed: {size} entries, each "
            f"{describe(item)}"
        )  # fmt: skip
    values = tuple(reader.value(item, x, (*path, k), "") for k, x in enumerate(node.items))
    if any(value is BROKEN for value in values):
        return {key.text: BROKEN}
    return dict(zip(POSITION, values)) if key.text == "xyz" else {key.text: values}


def _attitude(
    kind: JointMap, joint: Joint, entries: dict[str, Any], node: Node, path: Path
) -> dict[str, Any]:
    """Return the columns with one whole attitude and position; numbers as a unit quaternion."""
    given = [x for x in ATTITUDES if x in entries]
    parts = [x for x in QUATERNION if x in entries]
    forms = f"one of {', '.join(ATTITUDES)}"
    if len(given) + bool(parts) != 1:
        fault = "gives the attitude twice" if given or parts else "lacks the attitude"
        raise located(node, dotted(path), f"{fault}; needed: {forms}")
    if parts and len(parts) < 4:
        raise located(node, dotted(path), f"lacks {', '.join(x for x in QUATERNION if x not in parts)}; needed: all of "
                      f"{', '.join(QUATERNION)}, or {forms}")  # fmt: skip
    missing = [x for x in joint.names if x in POSITION and x not in entries]
    if missing:
        raise located(node, dotted(path), f"lacks {', '.join(missing)}; needed: xyz, or x, y and z")
    form = given[0] if given else "quaternion"
    values = entries[form] if given else tuple(entries[x] for x in QUATERNION)
    rest = {x: value for x, value in entries.items() if x in POSITION}
    if not isinstance(kind.item, Number):
        return {**rest, form: values}
    return {**rest, **dict(zip(QUATERNION, _quaternion(form, values, node, path)))}


def _quaternion(form: str, values: tuple[float, ...], node: Node, path: Path) -> tuple[float, ...]:
    """Return the unit quaternion of an attitude in numbers."""
    from robodyn_cli.spatial import quaternion

    if form == "rpy":
        return tuple(quaternion.from_rpy(values))
    if form == "rotation_vector":
        return tuple(quaternion.from_rotation_vector(values))
    length = math.sqrt(sum(x * x for x in values))
    if abs(length - 1.0) > LENGTH:
        message = f"the quaternion (w, x, y, z) has length {length:.6g}; needed: length 1, to three digits"
        raise located(node, dotted(path), message)
    return tuple(x / length for x in values)

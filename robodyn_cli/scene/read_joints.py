"""Read values by joint: flat, by column, such as ``slide.theta`` and ``ball.qw``.

Attitudes may be given as a quaternion, as roll, pitch and yaw or as a rotation vector; numbers become the quaternion,
formulas stay under ``ball.rpy``.
"""

from __future__ import annotations

import math
from typing import Any

from robodyn_cli.errors import unknown_name
from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.read_scalars import BROKEN, ScalarReader
from robodyn_cli.scene.text.nodes import (
    Mapping,
    Node,
    Path,
    Scalar,
    Sequence,
    describe_node,
    dotted,
    located,
)
from robodyn_cli.schema.fields import JointMap, Number, describe

ATTITUDES = {"quaternion": 4, "rpy": 3, "rotation_vector": 3}
QUATERNION = ("qw", "qx", "qy", "qz")
POSITION = ("x", "y", "z")
LENGTH = 1e-3  # tolerance of a quaternion's length 1: three digits


def joint_map(reader: ScalarReader, kind: JointMap, node: Node, path: Path, unit: str) -> dict[str, Any]:
    """Return values by column of q or v."""
    result: dict[str, Any] = {}
    for key, item in reader.entries_of(kind, node, path, unit):
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
    units = {} if joint is None else _units(kind, joint)
    if joint is None or not units:
        with reader.of_coordinate(coordinate_of(joint), name):
            return {name: reader.value(kind.item, node, path, unit)}
    names = tuple(units)
    if isinstance(node, Sequence):
        if len(node.items) != len(names):
            raise located(
                node, dotted(path), f"has {len(node.items)} entries; needed: {len(names)}, {', '.join(names)}"
            )
        values = {
            x: _value_of(reader, kind, units[x], item, (*path, k), unit)
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


def coordinate_of(joint: Joint | None) -> str:
    """Return the unit of the coordinates of a joint, empty where they differ or it is not known."""
    kinds = set() if joint is None else set(joint.v_units)
    return kinds.pop() if len(kinds) == 1 else ""


def _units(kind: JointMap, joint: Joint) -> dict[str, str]:
    """Return the unit of each coordinate of a joint; nothing for a single one, which has the joint's own name."""
    if kind.coordinates == "q":
        return dict(zip(joint.names, joint.units))
    return dict(zip(joint.v_names, joint.v_units))


def _value_of(
    reader: ScalarReader, kind: JointMap, coordinate: str, node: Node, path: Path, unit: str
) -> Any:
    """Return the value of one coordinate of a joint with several."""
    with reader.of_coordinate(coordinate):
        return reader.value(kind.item, node, path, "1" if coordinate == "1" else unit)


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
    units = _units(kind, joint)
    groups: dict[str, int] = {}
    if joint.quasi and kind.coordinates == "q":
        groups = dict(ATTITUDES)
        if "x" in joint.names:
            groups["xyz"] = 3
    values: dict[str, Any] = {}
    for key, item in node.entries:
        here = (*path, key.text)
        if key.text in units:
            values[key.text] = _value_of(reader, kind, units[key.text], item, here, unit)
        elif key.text in groups:
            values.update(_group(reader, kind, key, item, groups[key.text], here))
        else:
            allowed = [*units, *groups]
            raise located(key, dotted(here), unknown_name("coordinate", key.text, allowed))
    return values


def _group(
    reader: ScalarReader, kind: JointMap, key: Scalar, node: Node, size: int, path: Path
) -> dict[str, Any]:
    """Return a list of so many entries: positions by coordinate, an attitude under its own name."""
    unit = {"xyz": "m", "quaternion": "1"}.get(key.text, "rad")
    if not isinstance(node, Sequence) or len(node.items) != size:
        raise located(
            node, dotted(path), f"(value {describe_node(node)}) is not allowed here; allowed: {size} entries, each "
            f"{describe(kind.item, unit)}"
        )  # fmt: skip
    values = tuple(reader.value(kind.item, x, (*path, k), unit) for k, x in enumerate(node.items))
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

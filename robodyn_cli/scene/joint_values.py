"""Read values by joint: one for a joint with one coordinate, a list or a map by coordinate for others.

The result is flat, by column: ``hinge``, ``slide.theta``, ``ball.qw``. Attitudes may be given as a quaternion, as roll,
pitch and yaw or as a rotation vector; numbers become the quaternion, formulas stay as they are under ``ball.rpy``.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from robodyn_cli.errors import unknown_name
from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.read_scalars import BROKEN, ScalarReader
from robodyn_cli.scene.text.nodes import Mapping, Node, Path, Scalar, Sequence, describe_node, dotted, located
from robodyn_cli.schema.describe import describe
from robodyn_cli.schema.fields import JointMap, Kind, Number

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
            found = joint_values(reader, kind, key.text, item, here, unit)
            result.update({name: value for name, value in found.items() if value is not BROKEN})
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
        found = {
            x: reader.value(items[x], item, (*path, k), unit)
            for k, (x, item) in enumerate(zip(names, node.items))
        }
    elif isinstance(node, Mapping):
        found = _from_map(reader, kind, joint, node, path, unit)
    else:
        raise located(
            node, dotted(path), f"{_wanted(joint, kind, name, names)} (value {describe_node(node)})"
        )
    if any(value is BROKEN for value in found.values()):
        return {}
    if joint.quasi and kind.coordinates == "q":
        found = _attitude(kind, joint, found, node, path)
    return {f"{name}.{x}": value for x, value in found.items()}


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
        f"joint {name!r} is {joint.type} and has {len(names)} coordinates here; allowed: a list or a map of "
    )
    return text + ", ".join(names) + _forms(joint, kind)


def _forms(joint: Joint, kind: JointMap) -> str:
    if not joint.quasi or kind.coordinates != "q":
        return ""
    place = "xyz and " if "x" in joint.names else ""
    return f"; or {place}one of {', '.join(ATTITUDES)}"


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
    found: dict[str, Any] = {}
    for key, item in node.entries:
        here = (*path, key.text)
        if key.text in items:
            found[key.text] = reader.value(items[key.text], item, here, unit)
        elif key.text in groups:
            found.update(_group(reader, kind, key, item, groups[key.text], here))
        else:
            allowed = [*items, *groups]
            raise located(key, dotted(here), unknown_name("coordinate", key.text, allowed))
    return found


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


def _attitude(kind: JointMap, joint: Joint, found: dict[str, Any], node: Node, path: Path) -> dict[str, Any]:
    """Return the columns with one whole attitude and position; numbers as a unit quaternion."""
    given = [x for x in ATTITUDES if x in found]
    parts = [x for x in QUATERNION if x in found]
    forms = f"one of {', '.join(ATTITUDES)}"
    if len(given) + bool(parts) != 1:
        what = "gives the attitude twice" if given or parts else "lacks the attitude"
        raise located(node, dotted(path), f"{what}; needed: {forms}")
    if parts and len(parts) < 4:
        raise located(node, dotted(path), f"lacks {', '.join(x for x in QUATERNION if x not in parts)}; needed: all of "
                      f"{', '.join(QUATERNION)}, or {forms}")  # fmt: skip
    missing = [x for x in joint.names if x in POSITION and x not in found]
    if missing:
        raise located(node, dotted(path), f"lacks {', '.join(missing)}; needed: xyz, or x, y and z")
    form = given[0] if given else "quaternion"
    values = found[form] if given else tuple(found[x] for x in QUATERNION)
    rest = {x: value for x, value in found.items() if x in POSITION}
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
        raise located(
            node,
            dotted(path),
            f"the quaternion (w, x, y, z) has length {length:.6g}; needed: length 1, to three digits",
        )
    return tuple(x / length for x in values)

"""Descriptions of robots in other formats, each a dialect by the root element of its XML: one line here for each.

A robot that was read from one as readable YAML: one line a value, with comments.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import textwrap
from collections.abc import Callable
from collections.abc import Mapping as MappingOf

from robodyn_cli.errors import listed
from robodyn_cli.record import record
from robodyn_cli.registry import Registry
from robodyn_cli.scene.text.nodes import (
    Faults,
    Mapping,
    Node,
    Scalar,
    Sequence,
    Source,
    TooMany,
    mapping,
    scalar,
    sequence,
)
from robodyn_cli.scene.text.yaml_text import block
from robodyn_cli.scene.urdf.xml import XmlElement, parse_xml

WIDTH = 110
Packages = MappingOf[str, str]


@record
class RobotTree:
    """The tree of a robot; ``remarks`` : what the YAML says of a joint or link, by its name in the scene."""

    root: Mapping
    joint_remarks: dict[str, list[str]]
    link_remarks: dict[str, list[str]]


@record
class Description:
    """A robot that was read from the file ``file``.

    tree : what stands for ``robot`` in a scene. heading : what it is and holds, for the YAML made of it. notes : what
    the file leaves open. warnings : what makes its equations doubtful. None of them has the name of the file. files :
    others that were read with it.
    """

    file: str
    tree: RobotTree
    heading: tuple[str, ...]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What there is to say of the whole."""
        return (*self.heading, *self.notes, *(f"Doubtful: {text}" for text in self.warnings))


# f(root element, faults, packages) -> Description; faults takes errors behind which it goes on reading, so that all are
# listed: what it returns then does not matter; packages: folders of packages of meshes, by name
dialects: Registry[Callable[[XmlElement, Faults, Packages], Description | None]] = Registry(
    "robodyn_cli.scene",
    {
        "robot": "urdf.read:read_urdf",
        "sdf": "sdf.read:read_sdf",
        "mujoco": "mjcf.read:read_mjcf",
    },
)


def read_description(text: str, source: Source, faults: Faults, packages: Packages) -> Description:
    """Return the robot of an XML text, read by the dialect of its root element.

    faults : takes all errors but the last, which is raised. packages : folders of packages of meshes, by name.

    Raises
    ------
    SceneError : the text is no XML, of no dialect that is known, or what it says is not allowed.
    """
    root = parse_xml(text, source)
    if root.tag not in dialects:
        known = ", ".join(f"<{tag}>" for tag in dialects)
        raise root.error(f"the root element is <{root.tag}>; allowed: {known}")
    own, found = Faults(), None
    with contextlib.suppress(TooMany), own:
        found = dialects[root.tag](root, own, packages)
    if found is None or own.found:
        for error in own.found[:-1]:
            faults.report(error)
        raise own.found[-1]
    motors = found.tree.root.get("actuated")
    if not isinstance(motors, Sequence):
        return found
    names = listed([motor.text for motor in motors.items if isinstance(motor, Scalar)])
    return dataclasses.replace(found, notes=(*found.notes, f"joints with motors: {names}"))


def robot_yaml(urdf: Description, folder: str) -> str:
    """Return the text of a robot file in a folder, which scenes include."""
    lines = [line for text in urdf.remarks for line in _comment(text)]
    remarks = {
        "joints": urdf.tree.joint_remarks,
        "links": urdf.tree.link_remarks,
        "couplers": {},
        "loops": {},
    }
    old = os.path.dirname(os.path.abspath(urdf.file))
    for key, items in urdf.tree.root.entries:
        items = _meshes_from(items, old, os.path.abspath(folder)) if key.text == "links" else items
        if key.text not in remarks or not isinstance(items, Sequence):
            lines += block(mapping(items, [(key, items)]))
            continue
        if key.text == "couplers":
            lines += ["# coupled joints: the sum of coefficient times q is the value, 0 where none is given"]
        lines.append(f"{key.text}:")
        for item in items.items:
            assert isinstance(item, Mapping)
            lines += _item(item, remarks[key.text])
    return "\n".join(lines) + "\n"


def _meshes_from(node: Node, old: str, new: str) -> Node:
    """Return links that name their meshes from another folder."""
    if isinstance(node, Sequence):
        return sequence(node, [_meshes_from(item, old, new) for item in node.items])
    if not isinstance(node, Mapping):
        return node
    named = node.get("mesh")
    if isinstance(named, Scalar):
        path = os.path.relpath(os.path.join(old, named.text), new)
        return node.replaced(scalar(named, "mesh"), scalar(named, path))
    return mapping(node, [(key, _meshes_from(value, old, new)) for key, value in node.entries])


def _item(item: Mapping, remarks: MappingOf[str, list[str]]) -> list[str]:
    """Return the lines of an item of a list, with the remarks on it above."""
    name = item.get("name")
    assert isinstance(name, Scalar)
    comments = [line for remark in remarks.get(name.text, ()) for line in _comment(remark, "  ")]
    return [*comments, *(f"  {line}" for line in block(sequence(item, [item])))]


def _comment(text: str, indent: str = "") -> list[str]:
    """Return comment lines of one text, on which a name in it makes no line of its own."""
    printable = "".join(x if x.isprintable() else " " for x in text)
    return textwrap.wrap(printable, WIDTH, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}#   ",
                         break_long_words=False, break_on_hyphens=False)  # fmt: skip

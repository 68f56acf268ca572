"""A robot that was read from a URDF as readable YAML: one line a value, with comments."""

from __future__ import annotations

import os
import textwrap
from collections import Counter
from collections.abc import Iterator
from collections.abc import Mapping as MappingOf

from robodyn_cli.scene.text.nodes import Mapping, Node, Scalar, Sequence, mapping, scalar, sequence
from robodyn_cli.scene.text.yaml_text import block
from robodyn_cli.scene.urdf.read import Urdf

WIDTH = 110


def robot_yaml(found: Urdf, folder: str) -> str:
    """Return the text of a robot file in a folder, which scenes include."""
    lines = _head(found)
    remarks = {"joints": found.tree.joint_remarks, "links": found.tree.link_remarks, "couplers": {}}
    old = os.path.dirname(os.path.abspath(found.file))
    for key, items in found.tree.root.entries:
        items = _meshes_from(items, old, os.path.abspath(folder)) if key.text == "links" else items
        assert isinstance(items, Sequence)
        if key.text == "couplers":
            lines += [
                "# joints that mimic others: the sum of coefficient times q is the value, 0 where none is given"
            ]
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


def _visuals(root: Mapping) -> Iterator[Sequence]:
    """Yield the shapes of each link that has some."""
    links = root.get("links")
    for link in links.items if isinstance(links, Sequence) else ():
        shapes = link.get("visual") if isinstance(link, Mapping) else None
        if isinstance(shapes, Sequence):
            yield shapes


def _item(item: Mapping, remarks: MappingOf[str, list[str]]) -> list[str]:
    """Return the lines of an item of a list, with the remarks on it above."""
    name = item.get("name")
    assert isinstance(name, Scalar)
    comments = [line for remark in remarks.get(name.text, ()) for line in _comment(remark, "  ")]
    return [*comments, *(f"  {line}" for line in block(sequence(item, [item])))]


def _head(found: Urdf) -> list[str]:
    """Return comments about the whole: where it is from, what it holds, what it leaves out."""
    robot = found.robot
    file = os.path.basename(robot.element.place.source.name)
    kinds = Counter(joint.type for joint in robot.joints)
    mass = sum(link.inertial.mass for link in robot.links if link.inertial is not None)
    drawn = sum(len(shapes.items) for shapes in _visuals(found.tree.root))
    shapes = sum(len(link.shapes) for link in robot.links)
    left = Counter({"visual and collision": shapes - drawn}) + robot.ignored
    texts = [
        f"{robot.name or 'Robot'}, from {file} by `robodyn import`. SI units, angles in radians.",
        f"{len(robot.links)} links of {mass:.6g} kg in all; joints: "
        + (", ".join(f"{n} {kind}" for kind, n in kinds.items()) or "none"),
        "Frames, centres of mass and inertias are those of the URDF: inertias are about the centre of mass.",
    ]
    if left:
        texts.append(
            "No part of the equations, so left out: " + ", ".join(f"{n} {what}" for what, n in left.items())
        )
    doubtful = [f"Doubtful: {text}" for text in found.warnings]
    return [line for text in (*texts, *found.notes, *doubtful) for line in _comment(text)]


def _comment(text: str, indent: str = "") -> list[str]:
    """Return comment lines of one text, on which a name in it makes no line of its own."""
    printable = "".join(x if x.isprintable() else " " for x in text)
    return textwrap.wrap(printable, WIDTH, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}#   ",
                         break_long_words=False, break_on_hyphens=False)  # fmt: skip

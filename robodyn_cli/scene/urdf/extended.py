"""The YAML file beside a robot of the Extended URDF (arXiv 2504.04767): its loops, and other types of its joints.

Names in ``closed_loop`` are those of links, or of joints, which stand for the frame of the link that they move. ``3d``
ties points and ``6d`` poses. ``joint_type`` of a name in ``joint_name`` : SPHERICAL, FIXED (at q = 0), or UJOINT_PQ,
which turns about the axis P of its frame, then about Q; the joint's own axis does not count then.
"""

from __future__ import annotations

import dataclasses
import os
import re

from robodyn_cli.errors import listed, nearest_word, unknown_name
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import (
    Faults,
    Mapping,
    Node,
    Scalar,
    Sequence,
    Source,
    describe_node,
    located,
)
from robodyn_cli.scene.text.yaml_text import compose, read_text
from robodyn_cli.scene.ties import Closure, LoopEnd
from robodyn_cli.scene.urdf.elements import UrdfJoint, UrdfRobot

LOOPS = "closed_loop"
KEYS = (LOOPS, "type", "name_mot", "joint_name", "joint_type")
_TIES = {"3d": "spherical", "6d": "fixed"}
_CROSS = re.compile(r"UJOINT_([XYZ])([XYZ])")
_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


@record
class Beside:
    """What the file beside a URDF says; ``file`` : its path, empty without one. motors : joints that are driven."""

    file: str
    robot: UrdfRobot
    closures: tuple[Closure, ...] = ()
    motors: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What there is to say of it."""
        return (
            (f"{len(self.closures)} loops from {os.path.basename(self.file)} beside it",) if self.file else ()
        )


def with_file_beside(robot: UrdfRobot, faults: Faults) -> Beside:
    """Return a robot with what the YAML file of its name beside it says, if that has ``closed_loop``."""
    path = os.path.splitext(robot.element.place.source.name)[0] + ".yaml"
    if not robot.element.place.source.real or not os.path.isfile(path):
        return Beside("", robot)
    with faults:
        root = compose(read_text(path, None, "", path), Source(path, os.path.dirname(path)), faults)
        if not isinstance(root, Mapping) or root.get(LOOPS) is None:
            _refuse_slips(root)
            return Beside("", robot)
        return _Reader(robot, root).beside(path)
    return Beside("", robot)


def _refuse_slips(root: Node | None) -> None:
    """Refuse a key that must be meant for the one by which the file is known."""
    for key, _ in root.entries if isinstance(root, Mapping) else ():
        if nearest_word(key.text, [LOOPS], 0.8):
            raise located(key, "", unknown_name("key", key.text, KEYS))


class _Reader:
    def __init__(self, robot: UrdfRobot, root: Mapping) -> None:
        self.robot, self.root = robot, root
        self.joints = {joint.name: joint for joint in robot.joints}
        self.frames = {joint.name: joint.child for joint in robot.joints}
        self.frames |= {link.name: link.name for link in robot.links}

    def beside(self, path: str) -> Beside:
        for key, _ in self.root.entries:
            if key.text not in KEYS:
                raise located(key, "", unknown_name("key", key.text, KEYS))
        retyped = {
            self._joint(name).name: self._with_type(name, kind)
            for name, kind in self._pairs("joint_name", "joint_type")
        }
        joints = tuple(retyped.get(joint.name, joint) for joint in self.robot.joints)
        robot = dataclasses.replace(self.robot, joints=joints)
        closures = tuple(self._closure(k, *pair) for k, pair in enumerate(self._pairs(LOOPS, "type")))
        motors = tuple(self._motor(name, joints) for name in self._list("name_mot"))
        return Beside(path, robot, closures, motors)

    def _list(self, key: str) -> tuple[Node, ...]:
        node = self.root.get(key)
        if node is None:
            return ()
        if not isinstance(node, Sequence):
            raise located(node, key, f"must be a list (value {describe_node(node)})")
        return node.items

    def _pairs(self, first: str, second: str) -> list[tuple[Node, Node]]:
        one, other = self._list(first), self._list(second)
        if len(one) != len(other):
            place = self.root.get(second) or self.root
            raise located(place, second, f"has {len(other)} entries; allowed: {len(one)}, as {first!r}")
        return list(zip(one, other))

    def _joint(self, name: Node) -> UrdfJoint:
        text = _text(name)
        if text not in self.joints:
            raise located(name, "", unknown_name("joint", text, self.joints))
        return self.joints[text]

    def _motor(self, name: Node, joints: tuple[UrdfJoint, ...]) -> str:
        moving = [joint.name for joint in joints if joint.type != "fixed"]
        if (own := self._joint(name).name) not in moving:
            raise located(name, "name_mot", f"joint {own!r} is fixed; allowed: {listed(moving)}")
        return own

    def _with_type(self, name: Node, kind: Node) -> UrdfJoint:
        joint, text = self._joint(name), _text(kind)
        cross = _CROSS.fullmatch(text)
        if cross is not None and cross[1] != cross[2]:
            return dataclasses.replace(
                joint, type="universal", axis=_AXES[cross[1]], axis2=_AXES[cross[2]], mimic=None
            )
        if text not in ("SPHERICAL", "FIXED"):
            allowed = "allowed: SPHERICAL, FIXED, or UJOINT_ and two different letters of X, Y, Z"
            raise located(kind, "joint_type", f"{describe_node(kind)} is no type of a joint; {allowed}")
        return dataclasses.replace(joint, type=text.lower(), mimic=None)

    def _closure(self, k: int, pair: Node, tie: Node) -> Closure:
        kind = _text(tie).lower()
        if kind not in _TIES:
            raise located(tie, "type", unknown_name("type", _text(tie), _TIES))
        if not isinstance(pair, Sequence) or len(pair.items) != 2:
            raise located(pair, LOOPS, f"must be a list of two frames (value {describe_node(pair)})")
        ends = []
        for end in pair.items:
            if _text(end) not in self.frames:
                raise located(end, LOOPS, unknown_name("link or joint", _text(end), self.frames))
            ends.append(LoopEnd(self.frames[_text(end)]))
        return Closure(pair, f"loop{k + 1}", _TIES[kind], (ends[0], ends[1]))


def _text(node: Node) -> str:
    if not isinstance(node, Scalar):
        raise located(node, "", f"must be a text (value {describe_node(node)})")
    return node.text

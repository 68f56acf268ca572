"""A URDF robot as the tree of a scene's ``robot``: every value knows the line of the URDF that it comes from."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable
from collections.abc import Mapping as MappingOf
from typing import Any

from robodyn_cli.scene.dialects import RobotTree
from robodyn_cli.scene.text.nodes import Mapping, Node, plain, sequence
from robodyn_cli.scene.ties import Coupling, Ties, tie_entries
from robodyn_cli.scene.urdf.drake import Rotor
from robodyn_cli.scene.urdf.elements import (
    ACCELERATION,
    UNLIMITED,
    ZERO,
    Inertial,
    UrdfJoint,
    UrdfLink,
    UrdfPose,
    UrdfRobot,
    UrdfShape,
)
from robodyn_cli.scene.urdf.meshes import drawn_shapes
from robodyn_cli.scene.urdf.structure import SINGLE, Relation, root_of
from robodyn_cli.scene.urdf.xml import GROUND, joint_names, link_names, scene_names

ROOT_JOINT = "root_joint"
Drawn = tuple[UrdfShape, str]  # with the file of a mesh
WITHOUT_AXIS = ("fixed", "floating", "spherical")
# the scene's type where it has another name
_TYPES = {"continuous": "revolute"}


def robot_tree(
    robot: UrdfRobot,
    relations: dict[str, Relation],
    ties: Ties,
    urdf: str,
    packages: MappingOf[str, str],
) -> RobotTree:
    """Return the tree of a robot whose structure and mimics have been checked.

    ties : what closes its loops, and couplings of its joints.
    urdf, packages : where the meshes are looked for, see ``mesh_file``.
    """
    shapes = {link.name: drawn_shapes(link, urdf, packages) for link in robot.links}
    tree = _Tree(robot, relations, shapes, os.path.dirname(os.path.abspath(urdf)))
    return tree.tree(ties)


class _Tree:
    def __init__(
        self, robot: UrdfRobot, relations: dict[str, Relation], shapes: dict[str, list[Drawn]], folder: str
    ) -> None:
        self.robot, self.relations = robot, relations
        self.joints = joint_names(joint.name for joint in robot.joints)
        self.root_joint = scene_names([ROOT_JOINT], self.joints.values())[ROOT_JOINT]
        self.links = link_names(link.name for link in robot.links)
        self.joint_remarks: dict[str, list[str]] = {}
        self.written = LinkEntries(self.links, shapes, folder, "URDF")

    def tree(self, ties: Ties) -> RobotTree:
        place = self.robot.element.place
        root = root_of(self.robot)
        first = {"name": self.root_joint, "type": "fixed", "parent": GROUND, "link": self.links[root.name]}
        joints = [plain(root.element.place, first), *(self.joint(joint) for joint in self.robot.joints)]
        self.joint_remarks[self.root_joint] = [
            "holds the robot in the world; a robot that stands or flies freely has type: floating here"
        ]
        links = [self.written.link(link) for link in self.robot.links]
        entries: dict[str, Any] = {"joints": sequence(place, joints), "links": sequence(place, links)}
        mimics = [
            self.coupler(joint, relation)
            for joint in self.robot.joints
            if (relation := self.relations.get(joint.name)) is not None and relation.joint
        ]
        motors = None if ties.motors is None else tuple(self.joints[name] for name in ties.motors)
        ties = dataclasses.replace(ties, couplings=tuple(map(self.coupling, ties.couplings)), motors=motors)
        closing = tie_entries(ties, self.joints.values(), self.links)
        if couplers := [*mimics, *closing.pop("couplers", ())]:
            entries["couplers"] = sequence(place, couplers)
        entries |= closing
        return RobotTree(plain(place, entries), self.joint_remarks, self.written.remarks)

    # -- joints ---------------------------------------------------------------------------------------
    def joint(self, joint: UrdfJoint) -> Mapping:
        name = self.joints[joint.name]
        remarks = self.joint_remarks.setdefault(name, [])
        if name != joint.name:
            remarks.append(f"in the URDF: {joint.name!r}")
        relation = self.relations.get(joint.name)
        held = relation is not None and relation.joint is None
        kind = "fixed" if held else _TYPES.get(joint.type, joint.type)
        place = joint.element.place
        entries: dict[str, Any] = {
            "name": name,
            "type": kind,
            "parent": self.links[joint.parent],
            "link": self.links[joint.child],
        }
        if held and relation is not None and joint.mimic is not None:
            remarks.append(f"mimics {joint.mimic.joint!r}, which does not move: held at {relation.offset!r}")
            moved = moved_along(joint.pose, joint.axis, relation.offset, joint.type == "prismatic")
            entries |= origin_of(place, moved)
        else:
            if joint.mimic is not None and kind == "fixed":
                remarks.append(f"mimics {joint.mimic.joint!r}, which means nothing for a fixed joint")
            entries |= origin_of(place, joint.pose)
            entries |= {} if kind in WITHOUT_AXIS else {"axis": plain(place, joint.axis)}
            entries |= {} if joint.axis2 is None else {"axis2": plain(place, joint.axis2)}
            entries |= {"pitch": joint.pitch} if joint.pitch else {}
            entries |= self.drive(joint, remarks)
        return plain(place, entries)

    def drive(self, joint: UrdfJoint, remarks: list[str]) -> dict[str, Any]:
        """Return limits and friction of a joint with one coordinate."""
        if joint.type not in SINGLE:
            parts = {name: {"viscous": x} for name, x in joint.dampings.items()}
            return {"friction": plain(joint.element.place, parts.get("", parts))} if parts else {}
        entries: dict[str, Any] = {}
        limits = dict(joint.limits)
        if joint.type == "continuous":
            limits = {k: x for k, x in limits.items() if k not in ("lower", "upper")}
        elif limits:
            # the format's default of each is 0
            lower, upper = limits.setdefault("lower", 0.0), limits.setdefault("upper", 0.0)
            if lower >= upper:
                remarks.append(f"its limits {lower:g} and {upper:g} leave no room: taken as not stated")
                del limits["lower"], limits["upper"]
        else:
            remarks.append("the URDF states no limits")
        for k in ("effort", "velocity", ACCELERATION):
            if limits.get(k, 1.0) <= 0.0:
                remarks.append(f"{k} {limits.pop(k):g}: taken as not stated")
        limits = {k: x for k, x in limits.items() if abs(x) < UNLIMITED}
        order = {
            "lower": "lower",
            "upper": "upper",
            "speed": "velocity",
            "acceleration": ACCELERATION,
            "effort": "effort",
        }
        stated = {name: limits[k] for name, k in order.items() if k in limits}
        if stated:
            entries["limits"] = plain(joint.element.place, stated)
        friction: dict[str, Any] = {"viscous": joint.damping} if joint.damping else {}
        if joint.friction:
            friction |= {"coulomb": joint.friction, "law": "set_valued"}
        if friction:
            entries["friction"] = plain(joint.element.place, friction)
        return entries | rotor_entries(joint.rotor)

    def coupler(self, joint: UrdfJoint, relation: Relation) -> Mapping:
        """Return q - multiplier q_joint = offset."""
        name, mimic = joint.name, joint.mimic
        assert mimic is not None and relation.joint is not None
        place = mimic.element.place
        terms = {self.joints[name]: 1.0, self.joints[relation.joint]: -relation.multiplier}
        entries: dict[str, Any] = {"name": self.joints[name], "terms": plain(place, terms)}
        if relation.offset:
            entries["value"] = relation.offset
        return plain(place, entries)

    def coupling(self, coupling: Coupling) -> Coupling:
        """Return a coupling of joints by their names in the scene; those that are held count by where they are."""
        held = {joint: x.offset for joint, x in self.relations.items() if x.joint is None}
        terms = {self.joints[joint]: x for joint, x in coupling.terms.items() if joint not in held}
        value = coupling.value - sum(x * held[joint] for joint, x in coupling.terms.items() if joint in held)
        return dataclasses.replace(coupling, terms=terms, value=value)


def rotor_entries(rotor: Rotor) -> dict[str, Any]:
    """Return the keys of a joint with the rotor of its motor."""
    return {"gear_ratio": rotor.gear_ratio, "rotor_inertia": rotor.inertia} if rotor.inertia else {}


class LinkEntries:
    """Links as entries of ``links``.

    names : theirs in the scene, which the ``remarks`` are by. shapes : what each is drawn with. folder : of the file.
    """

    def __init__(
        self, names: dict[str, str], shapes: dict[str, list[Drawn]], folder: str, format: str
    ) -> None:
        self.names, self.shapes, self.folder, self.format = names, shapes, folder, format
        self.remarks: dict[str, list[str]] = {}

    def link(self, link: UrdfLink) -> Mapping:
        """Return a link with its inertia and what it is drawn with."""
        name = self.names[link.name]
        remarks = self.remarks.setdefault(name, [])
        if name != link.name:
            remarks.append(f"in the {self.format}: {link.name!r}")
        place, inertial = link.element.place, link.inertial
        if inertial is None or link.massless:
            remarks.append("massless: " + ("no <inertial>" if inertial is None else "mass and inertia are 0"))
            return plain(place, {"name": name, "mass": 0.0, **self.visual(link)})
        place = inertial.element.place
        inertia = _turned(inertial)
        if inertia != inertial.inertia:
            remarks.append("the inertia was turned from the axes of <inertial> into those of the link")
        return plain(
            link.element.place,
            {
                "name": name,
                "mass": plain(place, inertial.mass),
                "com": plain(place, inertial.pose.xyz),
                "inertia": plain(place, {k: inertia[k] for k in ("xx", "yy", "zz", "xy", "xz", "yz")}),
                **self.visual(link),
            },
        )

    def visual(self, link: UrdfLink) -> dict[str, Any]:
        """Return the key ``visual``, left out where there is nothing to draw."""
        shapes = [self.shape(shape, file) for shape, file in self.shapes[link.name]]
        return {"visual": sequence(link.element.place, shapes)} if shapes else {}

    def shape(self, shape: UrdfShape, file: str) -> Mapping:
        """Return a shape; the file of a mesh is named from the folder of the file."""
        place = shape.element.place
        if shape.kind == "mesh":
            entries: dict[str, Any] = {"mesh": os.path.relpath(file, self.folder)}
            if shape.sizes != (1.0, 1.0, 1.0):
                entries["scale"] = plain(place, shape.sizes)
        elif shape.kind == "sphere":
            entries = {"sphere": shape.sizes[0]}
        else:
            entries = {shape.kind: plain(place, shape.sizes)}
        return plain(place, entries | origin_of(place, shape.pose))


def origin_of(place: Node, pose: UrdfPose) -> dict[str, Any]:
    """Return the key ``origin``, left out where the frames coincide."""
    entries: dict[str, Any] = {"xyz": plain(place, pose.xyz)} if pose.xyz != ZERO else {}
    if pose.quaternion is not None:
        entries["quaternion"] = plain(place, pose.quaternion)
    elif pose.rpy != ZERO:
        entries["rpy"] = plain(place, pose.rpy)
    return {"origin": plain(place, entries)} if entries else {}


# -- geometry ----------------------------------------------------------------------------------------------
def moved_along(pose: UrdfPose, axis: Iterable[float], q: float, slides: bool) -> UrdfPose:
    """Return the pose of a joint's link at q, in the parent link's frame; ``pose`` : at q = 0."""
    from robodyn_cli.spatial import quaternion

    axis = tuple(axis)
    step = [q * a / math.hypot(*axis) for a in axis]
    if slides:
        xyz = tuple(float(p + d) for p, d in zip(pose.xyz, pose.rotation @ step))
        return UrdfPose(xyz, pose.rpy, pose.quaternion)
    turned = quaternion.product(pose.unit_quaternion, quaternion.from_rotation_vector(step))
    return UrdfPose(pose.xyz, quaternion=tuple(float(x) for x in turned))


def _turned(inertial: Inertial) -> dict[str, float]:
    """Return the inertia about the centre of mass in the axes of the link: R I R^T."""
    pose, given = inertial.pose, inertial.inertia
    if pose.quaternion is None and pose.rpy == ZERO:
        return given
    import numpy as np

    xyz = "xyz"
    tensor = np.array([[given["".join(sorted(a + b))] for b in xyz] for a in xyz])
    R = np.array(pose.rotation, dtype=float)
    turned = R @ tensor @ R.T
    return {k: float(turned[xyz.index(k[0]), xyz.index(k[1])]) for k in given}

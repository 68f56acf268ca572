"""Read a URDF file: XML, elements, structure, mimics, and the tree that stands for ``robot`` in a scene, whose every
value knows the line that it comes from."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping as MappingOf
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults, Mapping, Node, Scalar, Source, mapping, scalar, sequence
from robodyn_cli.scene.urdf import elements
from robodyn_cli.scene.urdf.structure import (
    SINGLE,
    Relation,
    check_structure,
    moving_links,
    relations,
    root_of,
)
from robodyn_cli.scene.urdf.xml import GROUND, joint_names, link_names, parse_xml, scene_names

ROOT_JOINT = "root_joint"
Drawn = tuple[elements.UrdfShape, str]  # with the file of a mesh
# the scene's type where it has another name
_TYPES = {"continuous": "revolute"}


@record
class RobotTree:
    """The tree of a robot; ``remarks`` : what the YAML says of a joint or link, by its name in the scene."""

    root: Mapping
    joint_remarks: dict[str, list[str]]
    link_remarks: dict[str, list[str]]


def robot_tree(
    robot: elements.UrdfRobot, relations: dict[str, Relation], urdf: str, packages: MappingOf[str, str]
) -> RobotTree:
    """Return the tree of a robot whose structure and mimics have been checked.

    urdf, packages : where the meshes are looked for, see ``mesh_file``.
    """
    shapes = {link.name: elements.drawn_shapes(link, urdf, packages) for link in robot.links}
    return _Tree(robot, relations, shapes, os.path.dirname(os.path.abspath(urdf))).tree()


class _Tree:
    def __init__(
        self,
        robot: elements.UrdfRobot,
        relations: dict[str, Relation],
        shapes: dict[str, list[Drawn]],
        folder: str,
    ) -> None:
        self.robot, self.relations, self.shapes, self.folder = robot, relations, shapes, folder
        self.joints = joint_names(joint.name for joint in robot.joints)
        self.root_joint = scene_names([ROOT_JOINT], self.joints.values())[ROOT_JOINT]
        self.links = link_names(link.name for link in robot.links)
        self.joint_remarks: dict[str, list[str]] = {}
        self.link_remarks: dict[str, list[str]] = {}

    def tree(self) -> RobotTree:
        place = self.robot.element.place
        root = root_of(self.robot)
        first = {"name": self.root_joint, "type": "fixed", "parent": GROUND, "link": self.links[root.name]}
        joints = [_map(root.element.place, first), *(self.joint(joint) for joint in self.robot.joints)]
        self.joint_remarks[self.root_joint] = [
            "holds the robot in the world; a robot that stands or flies freely has type: floating here"
        ]
        links = [self.link(link) for link in self.robot.links]
        entries: dict[str, Any] = {"joints": sequence(place, joints), "links": sequence(place, links)}
        couplers = [
            self.coupler(name, relation) for name, relation in self.relations.items() if relation.joint
        ]
        if couplers:
            entries["couplers"] = sequence(place, couplers)
        return RobotTree(_map(place, entries), self.joint_remarks, self.link_remarks)

    # -- joints ---------------------------------------------------------------------------------------
    def joint(self, joint: elements.UrdfJoint) -> Mapping:
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
            entries |= _origin(place, _moved(joint, relation.offset))
        else:
            if joint.mimic is not None and kind == "fixed":
                remarks.append(f"mimics {joint.mimic.joint!r}, which means nothing for a fixed joint")
            entries |= _origin(place, joint.pose)
            entries |= {} if kind in ("fixed", "floating") else {"axis": _numbers(place, joint.axis)}
            entries |= self.drive(joint, remarks)
        return _map(place, entries)

    def drive(self, joint: elements.UrdfJoint, remarks: list[str]) -> dict[str, Any]:
        """Return limits and friction of a joint with one coordinate."""
        if joint.type not in SINGLE:
            return {}
        found: dict[str, Any] = {}
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
        for k in ("effort", "velocity"):
            if limits.get(k, 1.0) <= 0.0:
                remarks.append(f"{k} {limits.pop(k):g}: taken as not stated")
        order = {"lower": "lower", "upper": "upper", "speed": "velocity", "effort": "effort"}
        stated = {name: limits[k] for name, k in order.items() if k in limits}
        if stated:
            found["limits"] = _map(joint.element.place, stated)
        friction: dict[str, Any] = {"viscous": joint.damping} if joint.damping else {}
        if joint.friction:
            friction |= {"coulomb": joint.friction, "law": "set_valued"}
        if friction:
            found["friction"] = _map(joint.element.place, friction)
        return found

    def coupler(self, name: str, relation: Relation) -> Mapping:
        """Return q - multiplier q_joint = offset."""
        mimic = next(joint.mimic for joint in self.robot.joints if joint.name == name)
        assert mimic is not None and relation.joint is not None
        place = mimic.element.place
        terms = {self.joints[name]: 1.0, self.joints[relation.joint]: -relation.multiplier}
        entries: dict[str, Any] = {"name": self.joints[name], "terms": _map(place, terms)}
        if relation.offset:
            entries["value"] = relation.offset
        return _map(place, entries)

    # -- links ----------------------------------------------------------------------------------------
    def link(self, link: elements.UrdfLink) -> Mapping:
        name = self.links[link.name]
        remarks = self.link_remarks.setdefault(name, [])
        if name != link.name:
            remarks.append(f"in the URDF: {link.name!r}")
        place, inertial = link.element.place, link.inertial
        if inertial is None or link.massless:
            remarks.append("massless: " + ("no <inertial>" if inertial is None else "mass and inertia are 0"))
            return _map(place, {"name": name, "mass": 0.0, **self.visual(link)})
        place = inertial.element.place
        inertia = _turned(inertial)
        if inertia != inertial.inertia:
            remarks.append("the inertia was turned from the axes of <inertial> into those of the link")
        return _map(
            link.element.place,
            {
                "name": name,
                "mass": _scalar(place, inertial.mass),
                "com": _numbers(place, inertial.pose.xyz),
                "inertia": _map(place, {k: inertia[k] for k in ("xx", "yy", "zz", "xy", "xz", "yz")}),
                **self.visual(link),
            },
        )

    def visual(self, link: elements.UrdfLink) -> dict[str, Any]:
        """Return the key ``visual``, left out where there is nothing to draw."""
        shapes = [self.shape(shape, file) for shape, file in self.shapes[link.name]]
        return {"visual": sequence(link.element.place, shapes)} if shapes else {}

    def shape(self, shape: elements.UrdfShape, file: str) -> Mapping:
        """Return a shape; the file of a mesh is named from the folder of the URDF."""
        place = shape.element.place
        if shape.kind == "mesh":
            entries: dict[str, Any] = {"mesh": os.path.relpath(file, self.folder)}
            if shape.sizes != (1.0, 1.0, 1.0):
                entries["scale"] = _numbers(place, shape.sizes)
        elif shape.kind == "sphere":
            entries = {"sphere": shape.sizes[0]}
        else:
            entries = {shape.kind: _numbers(place, shape.sizes)}
        return _map(place, entries | _origin(place, shape.pose))


# -- values ------------------------------------------------------------------------------------------------
def _scalar(place: Node, value: float | str) -> Scalar:
    """Return a number, whole ones without a point, or a text."""
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e6:
        return scalar(place, int(value))
    return scalar(place, value)


def _numbers(place: Node, values: tuple[float, ...]) -> Node:
    return sequence(place, [_scalar(place, x) for x in values])


def _map(place: Node, entries: dict[str, Any]) -> Mapping:
    items = [(k, x if isinstance(x, Node) else _scalar(place, x)) for k, x in entries.items()]
    return mapping(place, [(scalar(place, k), x) for k, x in items])


def _origin(place: Node, pose: elements.UrdfPose) -> dict[str, Any]:
    """Return the key ``origin``, left out where the frames coincide."""
    entries: dict[str, Any] = {"xyz": _numbers(place, pose.xyz)} if pose.xyz != elements.ZERO else {}
    if pose.quaternion is not None:
        entries["quaternion"] = _numbers(place, pose.quaternion)
    elif pose.rpy != elements.ZERO:
        entries["rpy"] = _numbers(place, pose.rpy)
    return {"origin": _map(place, entries)} if entries else {}


# -- geometry ----------------------------------------------------------------------------------------------
def _quaternion(pose: elements.UrdfPose) -> Any:
    from robodyn_cli.spatial import quaternion

    return quaternion.from_rpy(pose.rpy) if pose.quaternion is None else quaternion.unit(pose.quaternion)


def _rotation(pose: elements.UrdfPose) -> Any:
    from robodyn_cli.spatial import quaternion
    from robodyn_cli.spatial.algebra import rotation_rpy

    return rotation_rpy(pose.rpy) if pose.quaternion is None else quaternion.rotation(_quaternion(pose))


def _moved(joint: elements.UrdfJoint, q: float) -> elements.UrdfPose:
    """Return the pose of a joint's link at q, in the parent link's frame."""
    from robodyn_cli.spatial import quaternion

    length = math.hypot(*joint.axis)
    step = [q * a / length for a in joint.axis]
    if joint.type == "prismatic":
        xyz = tuple(float(p + d) for p, d in zip(joint.pose.xyz, _rotation(joint.pose) @ step))
        return elements.UrdfPose(xyz, joint.pose.rpy, joint.pose.quaternion)
    turned = quaternion.product(_quaternion(joint.pose), quaternion.from_rotation_vector(step))
    return elements.UrdfPose(joint.pose.xyz, quaternion=tuple(float(x) for x in turned))


def _turned(inertial: elements.Inertial) -> dict[str, float]:
    """Return the inertia about the centre of mass in the axes of the link: R I R^T."""
    pose, given = inertial.pose, inertial.inertia
    if pose.quaternion is None and pose.rpy == elements.ZERO:
        return given
    import numpy as np

    xyz = "xyz"
    tensor = np.array([[given["".join(sorted(a + b))] for b in xyz] for a in xyz])
    R = np.array(_rotation(pose), dtype=float)
    turned = R @ tensor @ R.T
    return {k: float(turned[xyz.index(k[0]), xyz.index(k[1])]) for k in given}


NO_PACKAGES: MappingOf[str, str] = {}


@record
class Urdf:
    """A URDF file that was read, under the name ``file``.

    notes : what the file leaves open. warnings : what makes its equations doubtful; without the file's name.
    """

    file: str
    robot: elements.UrdfRobot
    tree: RobotTree
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def read_urdf(text: str, source: Source, faults: Faults, packages: MappingOf[str, str] = NO_PACKAGES) -> Urdf:
    """Return the robot of a URDF text.

    Parameters
    ----------
    faults : takes all errors but the last, which is raised.
    packages : folders of packages of meshes, by name.

    Raises
    ------
    SceneError : the file is no URDF, or what it says is not allowed.
    """
    robot, relation = _checked(text, source, faults)
    tree = robot_tree(robot, relation, source.name, packages)
    notes = (*_notes(robot), *_missing(robot, source.name, packages))
    return Urdf(source.name, robot, tree, notes, _warnings(robot))


def _checked(text: str, source: Source, faults: Faults) -> tuple[elements.UrdfRobot, dict[str, Relation]]:
    own = Faults()
    robot = None
    found: dict[str, Relation] = {}
    with own:
        robot = elements.read_elements(parse_xml(text, source), own)
    if robot is not None and not own.found:
        check_structure(robot, own)
    if robot is not None and not own.found:
        with own:
            found = relations({joint.name: joint for joint in robot.joints})
    if robot is None or own.found:
        for error in own.found[:-1]:
            faults.report(error)
        raise own.found[-1]
    return robot, found


def _notes(robot: elements.UrdfRobot) -> tuple[str, ...]:
    massless = [link.name for link in robot.links if link.massless]
    return (f"massless links: {', '.join(massless)}",) if massless else ()


def _missing(robot: elements.UrdfRobot, urdf: str, packages: MappingOf[str, str]) -> tuple[str, ...]:
    missing = elements.missing_meshes(robot, urdf, packages)
    if not missing:
        return ()
    what = "a mesh is" if len(missing) == 1 else f"{len(missing)} meshes are"
    return (f"{what} not there, which matters for pictures only; the first: {missing[0]}",)


def _warnings(robot: elements.UrdfRobot) -> tuple[str, ...]:
    moving = moving_links(robot)
    hollow = [link.name for link in robot.links if link.massless and link.shapes and link.name in moving]
    drag = [j.name for j in robot.joints if j.type in ("floating", "planar") and (j.damping or j.friction)]
    texts = {
        "links that have a shape but no mass, and move as if they weighed nothing": hollow,
        "damping and friction of joints with several coordinates, which are left out": drag,
        "limits whose lower is above their upper, which are left out": _crossed(robot),
    }
    return tuple(f"{what}: {', '.join(names)}" for what, names in texts.items() if names)


def _crossed(robot: elements.UrdfRobot) -> list[str]:
    """List the joints whose limits are the wrong way round, with their lines."""
    found = []
    for joint in robot.joints:
        lower, upper = (joint.limits.get(k, 0.0) for k in ("lower", "upper"))
        limit = joint.element.one("limit", joint.name)
        if limit is not None and joint.type in SINGLE and joint.type != "continuous" and lower > upper:
            found.append(f"{joint.name} (line {limit.place.line}: lower {lower:g}, upper {upper:g})")
    return found

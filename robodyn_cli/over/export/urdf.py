"""URDF with the loops of two dialects: URDF+, and the Extended URDF with its YAML file (see ``scene/urdf``).

Rotors are written as Drake's elements of transmissions. A limit that is not stated is ``UNLIMITED``, since readers of
URDF want all four.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from robodyn_cli.over.export.robot import (
    GROUND,
    ExportedCoupler,
    ExportedLink,
    ExportedLoop,
    ExportedRobot,
    followers,
    fresh,
    held_root,
    rotor_notes,
    words,
    xml_text,
)
from robodyn_cli.over.export.scene import Format
from robodyn_cli.scene.sdf.frames import pose_between
from robodyn_cli.scene.text.nodes import Scalar, Source, plain
from robodyn_cli.scene.text.yaml_text import emit
from robodyn_cli.scene.urdf.closures import chain_terms
from robodyn_cli.scene.urdf.elements import UNLIMITED, UrdfPose
from robodyn_cli.spatial.algebra import rotation_to_z

SINGLE = ("revolute", "prismatic")
_AXIAL = ("revolute", "planar")  # closures with an axis in each link


class UrdfWriter:
    """Writes links, joints and mimics of a robot; ``root`` is the element that grows."""

    def __init__(self, robot: ExportedRobot, notes: list[str]) -> None:
        self.robot, self.notes = robot, notes
        self.root = Element("robot", {"name": robot.name, "xmlns:drake": "http://drake.mit.edu"})
        self.links = [link.name for link in robot.links]
        self.joints = [link.joint for link in robot.links]
        self.mimics, self.others = followers(robot.couplers)
        self.ground = ""
        if not held_root(robot):
            self.ground = fresh("world", self.links)
            SubElement(self.root, "link", {"name": self.ground})
        for link in robot.links:
            self.link(link)
        for link in robot.links:
            if self.ground or link.parent != GROUND:
                self.joint(link)
        for link in robot.links:
            self.transmission(link)
        notes += rotor_notes(robot)

    def name(self, link: str) -> str:
        """Return the name of a link, or of what stands for the ground."""
        return link if link != GROUND else self.ground

    def link(self, link: ExportedLink) -> None:
        """Add a link with its inertia."""
        element = SubElement(self.root, "link", {"name": link.name})
        if link.massless:
            return
        inertial = SubElement(element, "inertial")
        SubElement(inertial, "origin", {"xyz": words(link.com), "rpy": "0.0 0.0 0.0"})
        SubElement(inertial, "mass", {"value": words(link.mass)})
        axes = "xyz"
        pairs = [(i, j) for i in range(3) for j in range(i, 3)]
        SubElement(inertial, "inertia", {f"i{axes[i]}{axes[j]}": words(link.inertia[i, j]) for i, j in pairs})

    def joint(self, link: ExportedLink) -> None:
        """Add the joint of a link with what acts in it."""
        kinds = {"revolute": _turning(link), "universal": "continuous", "spherical": "continuous"}
        kind = kinds.get(link.type, link.type)
        joint = add_joint(self.root, link.joint, kind, (self.name(link.parent), link.name), link.pose)
        if link.type not in ("fixed", "floating"):
            SubElement(joint, "axis", {"xyz": words(link.axis)})
        if link.type not in SINGLE:
            return
        (one,) = link.coordinates
        if kind != "continuous" or one.limits:
            keys = {"lower": "lower", "upper": "upper", "effort": "effort", "speed": "velocity"}
            keys = {k: keys[k] for k in keys if kind != "continuous" or k in ("effort", "speed")}
            given = {
                key: one.limits.get(k, -UNLIMITED if k == "lower" else UNLIMITED) for k, key in keys.items()
            }
            SubElement(joint, "limit", {key: words(x) for key, x in given.items()})
        if one.damping or one.friction:
            SubElement(joint, "dynamics", {"damping": words(one.damping), "friction": words(one.friction)})
        if link.joint in self.mimics:
            leader, multiplier, offset, _ = self.mimics[link.joint]
            attributes = {"joint": leader, "multiplier": words(multiplier), "offset": words(offset)}
            SubElement(joint, "mimic", attributes)

    def transmission(self, link: ExportedLink) -> None:
        """Add the rotor of a joint, as Drake reads it."""
        for one in link.coordinates:
            if one.rotor_inertia == 0.0:
                continue
            own = SubElement(self.root, "transmission", {"name": f"{link.joint}_transmission"})
            SubElement(own, "type").text = "transmission_interface/SimpleTransmission"
            SubElement(own, "joint", {"name": link.joint})
            actuator = SubElement(own, "actuator", {"name": f"{link.joint}_motor"})
            SubElement(actuator, "drake:rotor_inertia", {"value": words(one.rotor_inertia)})
            SubElement(actuator, "drake:gear_ratio", {"value": words(one.gear_ratio)})


def _turning(link: ExportedLink) -> str:
    limits = link.coordinates[0].limits if link.coordinates else {}
    return "revolute" if {"lower", "upper"} & limits.keys() else "continuous"


def add_joint(root: Element, name: str, kind: str, ends: tuple[str, str], pose: UrdfPose) -> Element:
    """Add a joint between a parent and a child link."""
    joint = SubElement(root, "joint", {"name": name, "type": kind})
    for tag, end in zip(("parent", "child"), ends):
        SubElement(joint, tag, {"link": end})
    add_origin(joint, pose)
    return joint


def add_origin(element: Element, pose: UrdfPose) -> None:
    """Add an origin, but where it is none."""
    if any((*pose.xyz, *pose.rpy)):
        SubElement(element, "origin", {"xyz": words(pose.xyz), "rpy": words(pose.rpy)})


def _problems(robot: ExportedRobot) -> Iterator[str]:
    """Yield what no URDF holds."""
    for link in robot.links:
        if link.type not in SINGLE and any(one.rotor_inertia for one in link.coordinates):
            yield f"the rotor of joint {link.joint!r}, which is {link.type}"


# -- URDF+ -------------------------------------------------------------------------------------------------
def write_plus(robot: ExportedRobot, notes: list[str]) -> dict[str, str]:
    """Return the file of a robot in URDF+."""
    writer = UrdfWriter(robot, notes)
    _mark_dependent(writer)
    for loop in robot.loops:
        first, second = frames_of(loop)
        element = SubElement(writer.root, "loop", {"name": loop.name, "type": loop.type})
        for tag, end, pose in zip(("predecessor", "successor"), loop.ends, (first, second)):
            add_origin(SubElement(element, tag, {"link": writer.name(end.link)}), pose)
        if loop.type != "fixed":
            axis = np.array(loop.ends[0].axis) @ np.array(first.rotation, dtype=float)
            SubElement(element, "axis", {"xyz": words(axis)})
    for coupler in writer.others:
        predecessor, successor, ratio = _coupling(robot, coupler)
        element = SubElement(writer.root, "coupling", {"name": coupler.name})
        SubElement(element, "predecessor", {"link": writer.name(predecessor)})
        SubElement(element, "successor", {"link": writer.name(successor)})
        SubElement(element, "ratio", {"value": words(ratio)})
    return {f"{robot.name}.urdf": xml_text(writer.root)}


def frames_of(loop: ExportedLoop) -> tuple[UrdfPose, UrdfPose]:
    """Return the frames of a closure's ends in their links, with the closure's axis equal in both."""
    first, second = (end.pose.xyz for end in loop.ends)
    if loop.type not in _AXIAL:
        turned = np.eye(4)
        turned[:3, :3] = loop.attitude
        return UrdfPose(first, pose_between(turned).rpy), UrdfPose(second)
    axes = [np.array(end.axis) for end in loop.ends]
    if np.array_equal(axes[0], axes[1]):
        return UrdfPose(first), UrdfPose(second)
    turned = np.eye(4)
    turned[:3, :3] = rotation_to_z(loop.ends[1].axis) @ rotation_to_z(loop.ends[0].axis).T
    return UrdfPose(first), UrdfPose(second, pose_between(turned).rpy)


def _mark_dependent(writer: UrdfWriter) -> None:
    """Mark the joints that follow from others: those of loops and couplers that no motor drives, where that is told."""
    robot = writer.robot
    if robot.actuated is None:
        return
    above = {link.name: link for link in robot.links}
    closed = {name for coupler in robot.couplers for name in coupler.terms}
    for loop in robot.loops:
        ways = [{link.joint for link in _way(end.link, above)} for end in loop.ends]
        closed |= ways[0] ^ ways[1]
    for joint in writer.root.iter("joint"):
        name = joint.get("name")
        if joint.get("type") not in (None, "fixed") and name in closed and name not in robot.actuated:
            joint.set("independent", "false")


def _way(link: str, above: Mapping[str, ExportedLink]) -> Iterator[ExportedLink]:
    """Yield the links from one to the ground."""
    while link != GROUND:
        yield above[link]
        link = above[link].parent


def _plus_problems(robot: ExportedRobot) -> Iterator[str]:
    """Yield what URDF+ has not."""
    yield from _problems(robot)
    for coupler in followers(robot.couplers)[1]:
        if _coupling(robot, coupler) is None:
            yield (
                f"coupler {coupler.name!r} of {len(coupler.terms)} joints (allowed: two, or all between two links, "
                "with one coefficient towards each and the value 0)"
            )


def _coupling(robot: ExportedRobot, coupler: ExportedCoupler) -> Any:
    """Return predecessor, successor and ratio of a coupling with the terms of a coupler, None where there is none."""
    above = {link.name: link for link in robot.links}
    owners = [robot.joint(name) for name in coupler.terms]
    inner = {link.joint for owner in owners for link in list(_way(owner.name, above))[1:]}
    ends = [owner for owner in owners if owner.joint not in inner]
    if coupler.value or len(ends) > 2:
        return None
    top = list(_way(ends[0].name, above))
    behind = [link for link in top if link.joint in coupler.terms][-1].parent
    second = ends[1].name if len(ends) == 2 else behind
    ratio = -coupler.terms[ends[0].joint] / coupler.terms[ends[1].joint] if len(ends) == 2 else 1.0
    chains = [[(x.joint, x.type) for x in _way(link, above)] for link in (ends[0].name, second)]
    terms = chain_terms(chains[0], chains[1], ratio)
    scale = coupler.terms[ends[0].joint] / terms[ends[0].joint]
    same = {name: x * scale for name, x in terms.items()}
    close = same.keys() == coupler.terms.keys() and all(
        abs(same[k] - x) <= 1e-15 * abs(x) for k, x in coupler.terms.items()
    )
    return (ends[0].name, second, ratio) if close else None


# -- the Extended URDF -------------------------------------------------------------------------------------
def write_extended(robot: ExportedRobot, notes: list[str]) -> dict[str, str]:
    """Return the files of a robot in the Extended URDF; points and turned frames of loops become massless links."""
    writer = UrdfWriter(robot, notes)
    beside: dict[str, list[Any]] = {"closed_loop": [], "type": []}
    for loop in robot.loops:
        first, second = frames_of(loop)
        ends = [
            _marker(writer, loop.name, role, end.link, pose if loop.type == "fixed" else UrdfPose(pose.xyz))
            for role, end, pose in zip(("first", "second"), loop.ends, (first, second))
        ]
        beside["closed_loop"].append(ends)
        beside["type"].append("6d" if loop.type == "fixed" else "3d")
    if robot.actuated is not None:
        beside["name_mot"] = list(robot.actuated)
    retyped = [link for link in robot.links if link.type in ("universal", "spherical")]
    beside["joint_name"] = [link.joint for link in retyped]
    beside["joint_type"] = ["SPHERICAL" if link.type == "spherical" else "UJOINT_ZX" for link in retyped]
    place = Scalar(Source(robot.name, "."), 1, 1, "", None)
    text = emit(plain(place, {key: x for key, x in beside.items() if x or key == "closed_loop"}))
    return {f"{robot.name}.urdf": xml_text(writer.root), f"{robot.name}.yaml": text}


def _marker(writer: UrdfWriter, loop: str, role: str, link: str, pose: UrdfPose) -> str:
    """Return the link whose frame is an end of a loop, a new one where no link has it."""
    name = writer.name(link)
    if not any((*pose.xyz, *pose.rpy)):
        return name
    marker = fresh(f"{loop}_{role}", (*writer.links, *writer.joints))
    writer.links.append(marker)
    SubElement(writer.root, "link", {"name": marker})
    joint = fresh(f"{marker}_joint", writer.joints)
    writer.joints.append(joint)
    add_joint(writer.root, joint, "fixed", (name, marker), pose)
    return marker


def _extended_problems(robot: ExportedRobot) -> Iterator[str]:
    """Yield what the Extended URDF has not."""
    yield from _problems(robot)
    for coupler in followers(robot.couplers)[1]:
        yield f"coupler {coupler.name!r} of {len(coupler.terms)} joints (allowed: two, of which one follows)"


_PLAIN = ("revolute", "prismatic", "fixed", "floating", "planar")
URDF_PLUS = Format(
    "URDF+",
    _PLAIN,
    ("revolute", "prismatic", "planar", "fixed"),
    write_plus,
    _plus_problems,
    turned=("planar",),
    by_effort=True,
)
EXTENDED_URDF = Format(
    "the Extended URDF",
    (*_PLAIN, "universal", "spherical"),
    ("spherical", "fixed"),
    write_extended,
    _extended_problems,
    turned=("planar", "universal"),
)

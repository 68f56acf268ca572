"""SDF: links with poses relative to their parents, loops as joints that are to be cut (see ``scene/sdf``)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from robodyn_cli.errors import listed
from robodyn_cli.over.export.robot import (
    GROUND,
    Coordinate,
    ExportedLink,
    ExportedLoop,
    ExportedRobot,
    followers,
    rotor_notes,
    words,
    xml_text,
)
from robodyn_cli.over.export.scene import Format
from robodyn_cli.scene.sdf.frames import WORLD

VERSION = "1.11"
_KINDS = {"helical": "screw", "spherical": "ball"}
_TURNING = ("revolute", "prismatic", "helical")


def write_sdf(robot: ExportedRobot, notes: list[str]) -> dict[str, str]:
    """Return the file of a robot in SDF."""
    root = Element("sdf", {"version": VERSION, "xmlns:drake": "http://drake.mit.edu"})
    model = SubElement(root, "model", {"name": robot.name})
    mimics, _ = followers(robot.couplers)
    for link in robot.links:
        _link(model, link)
    for link in robot.links:
        if link.type == "floating":
            notes.append(f"joint {link.joint!r} is that no joint holds link {link.name!r}, as SDF says it")
            continue
        joint = _joint(model, link.joint, _KINDS.get(link.type, link.type), (link.parent, link.name))
        _rotor(joint, link)
        if link.type == "helical":
            SubElement(joint, "screw_thread_pitch").text = words(link.pitch * math.tau)
        directions = {"universal": (link.axes[:, 2], link.axes[:, 0])}.get(link.type, (link.axis,))
        for tag, u, one in zip(("axis", "axis2"), directions, link.coordinates):
            if link.type == "spherical":
                break
            axis = _axis(joint, tag, u)
            _acting(axis, one)
            if link.joint in mimics:
                leader, multiplier, offset, _ = mimics[link.joint]
                mimic = SubElement(axis, "mimic", {"joint": leader})
                for key, x in {"multiplier": multiplier, "offset": offset, "reference": 0.0}.items():
                    SubElement(mimic, key).text = words(x)
    for loop in robot.loops:
        _loop(model, loop, robot)
    notes += rotor_notes(robot)
    massless = [link.name for link in robot.links if link.mass == 0.0]
    if massless:
        notes.append(f"links without mass, which not every reader of SDF takes: {listed(massless)}")
    notes.append("gravity is not written: it is that of the world into which an SDF model is put")
    return {f"{robot.name}.sdf": xml_text(root)}


def _link(model: Element, link: ExportedLink) -> None:
    element = SubElement(model, "link", {"name": link.name})
    pose = SubElement(element, "pose", {"relative_to": link.parent} if link.parent != GROUND else {})
    pose.text = words((*link.pose.xyz, *link.pose.rpy))
    inertial = SubElement(element, "inertial")
    SubElement(inertial, "pose").text = words((*link.com, 0.0, 0.0, 0.0))
    SubElement(inertial, "mass").text = words(link.mass)
    inertia = SubElement(inertial, "inertia")
    for i in range(3):
        for j in range(i, 3):
            SubElement(inertia, f"i{'xyz'[i]}{'xyz'[j]}").text = words(link.inertia[i, j])


def _joint(model: Element, name: str, kind: str, ends: tuple[str, str]) -> Element:
    joint = SubElement(model, "joint", {"name": name, "type": kind})
    for tag, end in zip(("parent", "child"), ends):
        SubElement(joint, tag).text = end if end != GROUND else WORLD
    return joint


def _rotor(joint: Element, link: ExportedLink) -> None:
    """Add the rotor of a joint with one coordinate, as Drake reads it."""
    for one in link.coordinates:
        if one.rotor_inertia:
            SubElement(joint, "drake:rotor_inertia").text = words(one.rotor_inertia)
            SubElement(joint, "drake:gear_ratio").text = words(one.gear_ratio)


def _axis(joint: Element, tag: str, direction: Any) -> Element:
    axis = SubElement(joint, tag)
    SubElement(axis, "xyz").text = words(direction)
    return axis


def _acting(axis: Element, one: Coordinate) -> None:
    """Add limits, friction, spring and rotor of a coordinate."""
    if one.limits:
        limit = SubElement(axis, "limit")
        for key, tag in {"lower": "lower", "upper": "upper", "effort": "effort", "speed": "velocity"}.items():
            if key in one.limits:
                SubElement(limit, tag).text = words(one.limits[key])
    values = {
        "damping": one.damping, "friction": one.friction,
        "spring_reference": one.rest if one.stiffness else 0.0, "spring_stiffness": one.stiffness,
    }  # fmt: skip
    if any(values.values()):
        dynamics = SubElement(axis, "dynamics")
        for tag, x in values.items():
            SubElement(dynamics, tag).text = words(x)


def _loop(model: Element, loop: ExportedLoop, robot: ExportedRobot) -> None:
    """Add a closure as a joint; its frame has the axes of the child, and lies at the point of the child."""
    parent, child = loop.ends if loop.ends[1].link != GROUND else loop.ends[::-1]  # the world is no child
    joint = _joint(model, loop.name, _KINDS.get(loop.type, loop.type), (parent.link, child.link))
    SubElement(joint, "pose").text = words((*child.pose.xyz, 0.0, 0.0, 0.0))
    if loop.type == "revolute":
        _axis(joint, "axis", child.axis)
    elif loop.type == "prismatic":  # its axis is given in the frame of the first end
        first = np.array(loop.ends[0].axis)
        _axis(joint, "axis", first if child is loop.ends[0] else loop.attitude.T @ first)
    elif loop.type == "universal":
        turn = robot.attitude(child.link).T @ robot.attitude(parent.link)
        _axis(joint, "axis", turn @ np.array(parent.axis))
        _axis(joint, "axis2", child.axis)
    simbody = SubElement(SubElement(joint, "physics"), "simbody")
    SubElement(simbody, "must_be_loop_joint").text = "true"


def _problems(robot: ExportedRobot) -> Iterator[str]:
    """Yield what SDF has not."""
    names = {link.joint for link in robot.links}
    for name in sorted(names & {link.name for link in robot.links}):
        yield f"{name!r} names a joint and a link"
    for link in robot.links:
        if link.type == "floating" and link.parent != GROUND:
            yield f"joint {link.joint!r} is floating and hangs on a link (allowed: on the ground)"
        if link.type not in _TURNING and any(one.rotor_inertia for one in link.coordinates):
            yield f"the rotor of joint {link.joint!r}, which is {link.type}"
    for loop in robot.loops:
        if loop.name in names:
            yield f"loop {loop.name!r} has the name of a joint"
    for coupler in followers(robot.couplers)[1]:
        yield f"coupler {coupler.name!r} of {len(coupler.terms)} joints (allowed: two, of which one follows)"


SDF = Format(
    f"SDF {VERSION}",
    ("revolute", "prismatic", "fixed", "helical", "universal", "spherical", "floating"),
    ("revolute", "prismatic", "universal", "spherical", "fixed"),
    write_sdf,
    _problems,
    along=("universal",),
    springs=True,
    assembled=True,
    reserved=(WORLD,),
    by_effort=True,
)

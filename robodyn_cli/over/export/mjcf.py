"""MJCF: bodies in bodies, closures as equalities between sites, which need not meet at the file's poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from robodyn_cli.errors import listed
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.over.export.robot import (
    GROUND,
    Coordinate,
    ExportedLink,
    ExportedRobot,
    followers,
    words,
    xml_text,
)
from robodyn_cli.over.export.scene import Format
from robodyn_cli.scene.sdf.frames import inverse, matrix, pose_between
from robodyn_cli.scene.urdf.elements import UrdfPose
from robodyn_cli.spatial.algebra import Array

# by kind of joint: MuJoCo's joints of one body, outermost first, each with its axis among the joint's own
JOINTS: Mapping[str, tuple[tuple[str, int], ...]] = {
    "fixed": (),
    "revolute": (("hinge", 2),),
    "prismatic": (("slide", 2),),
    "cylindrical": (("hinge", 2), ("slide", 2)),
    "universal": (("hinge", 2), ("hinge", 0)),
    "planar": (("slide", 0), ("slide", 1), ("hinge", 2)),
    "spherical": (("ball", 2),),
    "floating": (("slide", 0), ("slide", 1), ("slide", 2), ("ball", 2)),
}
_PASSED = (
    "revolute",
    "prismatic",
    "cylindrical",
    "universal",
    "planar",
)  # joints that others of their body may follow
MOST = 6  # coordinates of a body
Chain = tuple[ExportedLink, ...]
_COORDINATES = {"hinge": 1, "slide": 1, "ball": 3}
LEAST, ROUNDING = (
    1e-15,
    1e-12,
)  # mass [kg] and moments [kg m^2] that MuJoCo takes; of what moments may add up to
ACROSS = 0.1  # distance [m] along its axis of the two points that a pin ties


def write_mjcf(robot: ExportedRobot, notes: list[str]) -> dict[str, str]:
    """Return the file of a robot in MJCF."""
    notes += _notes(robot)
    return {f"{robot.name}.xml": mjcf_text(robot, chains=_chains(robot))}


def mjcf_text(
    robot: ExportedRobot, flags: Mapping[str, str] | None = None, chains: Mapping[str, Chain] | None = None
) -> str:
    """Return a robot in MJCF; flags : of what MuJoCo does, beside its defaults. chains : see ``add_bodies``."""
    root = mujoco_element(robot, flags)
    sites, equality = _closures(robot)
    tree = SubElement(root, "worldbody")
    for name, pose in sites.get(GROUND, {}).items():
        _site(tree, name, pose)
    bodies = add_bodies(tree, robot, chains)
    for link, placed in sites.items():
        for name, pose in placed.items():
            if link != GROUND:
                _site(bodies[link], name, pose)
    equality += [*_couplers(root, robot)]
    if equality:
        SubElement(root, "equality").extend(equality)
    actuated = [one for one in robot.actuated or () if len(robot.joint(one).coordinates) == 1]
    if actuated:
        actuator = SubElement(root, "actuator")
        for name in actuated:
            SubElement(actuator, "motor", {"name": f"{name}_motor", "joint": name})
    return xml_text(root)


def _notes(robot: ExportedRobot) -> Iterator[str]:
    """Yield what MuJoCo does in its own way."""
    if robot.loops or robot.couplers:
        yield "equalities of MuJoCo are soft: loops and couplers give way as solref and solimp let them"
    pins = [loop.name for loop in robot.loops if loop.type == "revolute"]
    if pins:
        yield f"pins are two points each, {ACROSS} m apart along the axis: {listed(pins)}"
    if any({"lower", "upper"} <= one.limits.keys() for link in robot.links for one in link.coordinates):
        yield "ranges of joints are stops in MuJoCo, and soft"
    ends = {"lower", "upper"}
    open_ = [
        one.name for link in robot.links for one in link.coordinates if len(ends & one.limits.keys()) == 1
    ]
    if open_:
        yield f"left out, for a range has two ends: {listed(open_)}"
    flying = [link.joint for link in robot.links if link.type == "floating" and link.parent != GROUND]
    if flying:
        yield f"floating joints on other links are three slides and a ball: {listed(flying)}"
    light = [link.name for link in robot.links if link.mass < LEAST and not link.massless]
    if light:
        yield f"links that turn and have no mass are given {LEAST:g} kg, the least that MuJoCo takes: {listed(light)}"


def mujoco_element(robot: ExportedRobot, flags: Mapping[str, str] | None = None) -> Element:
    """Return the head of an MJCF, with what is computed as it is written."""
    root = Element("mujoco", {"model": robot.name})
    SubElement(root, "compiler", {"angle": "radian", "inertiafromgeom": "false", "balanceinertia": "false"})
    option = SubElement(root, "option", {"gravity": words(robot.gravity)})
    if flags:
        SubElement(option, "flag", dict(flags))
    return root


def _chains(robot: ExportedRobot) -> dict[str, Chain]:
    """Return the links of each body, by the last of them: links without mass between two joints need no body."""
    children = Counter(link.parent for link in robot.links)
    tied = {end.link for loop in robot.loops for end in loop.ends}
    between = {
        link.name: link
        for link in robot.links
        if link.massless and link.type in _PASSED and children[link.name] == 1 and link.name not in tied
    }
    chains: dict[str, Chain] = {}
    for last in (link for link in robot.links if link.name not in between):
        link: ExportedLink | None = last
        while link is not None:
            chain: Chain = (link,)
            room = MOST - len(link.coordinates)
            link = between.get(link.parent)
            while (
                link is not None
                and chain[0].type in (*_PASSED, "spherical")
                and room >= len(link.coordinates)
            ):
                chain, room = (link, *chain), room - len(link.coordinates)
                link = between.get(link.parent)
            chains[chain[-1].name] = chain
    return chains


def add_bodies(
    tree: Element, robot: ExportedRobot, chains: Mapping[str, Chain] | None = None
) -> dict[str, Element]:
    """Add all links as bodies; return their elements by name.

    chains : the links of each body, by the last of them; by default each link is a body with our coordinates, for
    which no joint is free.
    """
    free = chains is not None
    chains = {link.name: (link,) for link in robot.links} if chains is None else chains
    below: dict[str, list[Chain]] = {}
    for chain in chains.values():
        below.setdefault(chain[0].parent, []).append(chain)
    elements = {GROUND: tree}
    pending = [GROUND]
    while pending:
        parent = pending.pop()
        for chain in below.get(parent, ()):
            elements[chain[-1].name] = _body(elements[parent], chain, free)
            pending.append(chain[-1].name)
    return elements


def _body(parent: Element, chain: Chain, free: bool) -> Element:
    link, pose = chain[-1], chain[0].pose
    poses = [matrix(one.pose) for one in chain]
    if len(chain) > 1:
        pose = pose_between(np.linalg.multi_dot(poses))
    attributes = {"name": link.name, "pos": words(pose.xyz), "quat": words(pose.unit_quaternion)}
    body = SubElement(parent, "body", attributes)
    if not link.massless:
        I = link.inertia
        full = (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
        attributes = {
            "pos": words(link.com),
            "mass": words(max(link.mass, LEAST)),
            "fullinertia": words(full),
        }
        SubElement(body, "inertial", attributes)
    if free and link.type == "floating" and link.parent == GROUND:
        SubElement(body, "freejoint", {"name": link.joint})
        return body
    back = np.eye(4)  # the frame of a link of the chain in that of the body
    places = []
    for T in reversed(poses):
        places.append(back)
        back = back @ inverse(T)
    for one, place in zip(chain, reversed(places)):
        _joints(body, one, place)
    return body


def _joints(body: Element, link: ExportedLink, place: Array) -> None:
    """Add the joint of a link whose frame is at a place (4, 4) in the body."""
    used = 0
    names = joint_types[link.type].coordinates(link.joint, joint_types[link.type].names)
    for kind, column in JOINTS[link.type]:
        own = link.coordinates[used : used + _COORDINATES[kind]]
        name = names[used] if len(own) == 1 else link.joint
        used += _COORDINATES[kind]
        joint = SubElement(body, "joint", {"name": name, "type": kind})
        if place[:3, 3].any():
            joint.set("pos", words(place[:3, 3]))
        if kind in ("hinge", "slide"):
            joint.set("axis", words(place[:3, :3] @ link.axes[:, column]))
            _acting(joint, own[0])
        elif kind == "ball" and link.damping:
            joint.set("damping", words(link.damping))
        armature = {one.rotor_inertia * one.gear_ratio**2 for one in own}
        if any(armature):
            joint.set("armature", words(max(armature)))


def _acting(joint: Element, one: Coordinate) -> None:
    """Set what acts along a coordinate."""
    values = {
        "damping": one.damping,
        "frictionloss": one.friction,
        "stiffness": one.stiffness,
        "springref": one.rest,
    }
    for key, x in values.items():
        if x and (key != "springref" or one.stiffness):
            joint.set(key, words(x))
    if {"lower", "upper"} <= one.limits.keys():
        joint.set("limited", "true")
        joint.set("range", words((one.limits["lower"], one.limits["upper"])))
    if "effort" in one.limits:
        joint.set("actuatorfrclimited", "true")
        joint.set("actuatorfrcrange", words((-one.limits["effort"], one.limits["effort"])))


def _site(body: Element, name: str, pose: UrdfPose) -> None:
    attributes = {"name": name, "pos": words(pose.xyz), "quat": words(pose.unit_quaternion)}
    SubElement(body, "site", attributes)


def _closures(robot: ExportedRobot) -> tuple[dict[str, dict[str, UrdfPose]], list[Element]]:
    """Return the sites of each link, and the equalities that tie them."""
    sites: dict[str, dict[str, UrdfPose]] = {}
    ties = []
    for loop in robot.loops:
        turned = np.eye(4)
        turned[:3, :3] = loop.attitude
        rpy = pose_between(turned).rpy if loop.type == "fixed" else (0.0, 0.0, 0.0)
        for k in range(2 if loop.type == "revolute" else 1):
            names = []
            for role, end, turn in zip(("first", "second"), loop.ends, (rpy, (0.0, 0.0, 0.0))):
                p = np.array(end.pose.xyz) + k * ACROSS * np.array(end.axis)
                names.append(f"{loop.name}_{role}" + ("_along" if k else ""))
                sites.setdefault(end.link, {})[names[-1]] = UrdfPose(tuple(float(x) for x in p), turn)
            name = loop.name + ("_along" if k else "")
            kind = "weld" if loop.type == "fixed" else "connect"
            ties.append(Element(kind, {"name": name, "site1": names[0], "site2": names[1]}))
    return sites, ties


def _couplers(root: Element, robot: ExportedRobot) -> Iterator[Element]:
    """Yield couplers as equalities: of two joints, or of a tendon whose length is the sum over more of them."""
    mimics, others = followers(robot.couplers)
    for joint, (leader, multiplier, offset, name) in mimics.items():
        polynomial = words((offset, multiplier, 0.0, 0.0, 0.0))
        yield Element("joint", {"name": name, "joint1": joint, "joint2": leader, "polycoef": polynomial})
    tendons = SubElement(root, "tendon") if others else root
    for coupler in others:
        tendon = SubElement(tendons, "fixed", {"name": coupler.name})
        for joint, x in coupler.terms.items():
            SubElement(tendon, "joint", {"joint": joint, "coef": words(x)})
        polynomial = words((coupler.value, 0.0, 0.0, 0.0, 0.0))
        yield Element("tendon", {"name": coupler.name, "tendon1": coupler.name, "polycoef": polynomial})


def _problems(robot: ExportedRobot) -> Iterator[str]:
    """Yield what MuJoCo does not take: bodies that move without mass, rotors of turns in space."""
    weights: dict[str, bool] = {}
    for link in robot.links:
        name = link.name
        while robot.link(name).type == "fixed" and robot.link(name).parent != GROUND:
            name = robot.link(name).parent
        weights[name] = weights.get(name, False) or not link.massless
    bodies = _chains(robot)
    for name, heavy in weights.items():
        if not heavy and robot.link(name).type != "fixed" and name in bodies:
            yield f"link {name!r} moves and has no mass, which MuJoCo does not take"
    for link in robot.links:
        moments = np.linalg.eigvalsh(link.inertia)
        if not link.massless and moments[0] <= LEAST:
            yield f"link {link.name!r} has no moment of inertia about some axis, which MuJoCo does not take"
        elif moments[2] > (moments[0] + moments[1]) * (1.0 + ROUNDING):
            yield f"link {link.name!r} has moments of inertia that no body can have, which MuJoCo does not take"
        rotors = {one.rotor_inertia * one.gear_ratio**2 for one in link.coordinates}
        if link.type in ("spherical", "floating") and len(rotors) > 1:
            yield f"the rotors of joint {link.joint!r} differ by direction"


MJCF = Format(
    "MJCF",
    tuple(JOINTS),
    ("spherical", "fixed", "revolute"),
    write_mjcf,
    _problems,
    along=("cylindrical", "universal", "planar"),
    springs=True,
    in_space=True,
    limits=("lower", "upper", "effort"),
    reserved=("world",),
)

"""Drake's elements of URDF and SDF: joints of other kinds, closures, rotors. Their values are attributes in URDF.

A ``ball`` is spherical; ``universal`` turns about x of the joint's frame, then about y; ``screw`` has a right-handed
thread in metres per turn; ``planar`` slides along x and y and turns about z of a frame whose z is the joint's axis, by
the least rotation from the joint's frame. Rotors add gear_ratio^2 rotor_inertia; ``effort`` 0 says that a joint has no
motor, so no rotor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from robodyn_cli.errors import unknown_name
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.urdf.xml import XmlElement

DRAKE = "drake:"
# by Drake's kind of joint: ours, and the coordinates that have damping
JOINTS = {
    "ball": ("spherical", ("",)),
    "planar": ("planar", ("x", "y", "theta")),
    "screw": ("helical", ("",)),
    "universal": ("universal", ("theta1", "theta2")),
}
# what is read of Drake, by where it stands
READ = {
    "robot": ("joint", "ball_constraint", "distance_constraint"),
    "model": ("ball_constraint", "distance_constraint", "weld_constraint"),
    "actuator": ("rotor_inertia", "gear_ratio"),
    "joint": ("rotor_inertia", "gear_ratio", "mimic", "screw_thread_pitch"),
    "ball_constraint": ("body_A", "body_B", "p_AP", "p_BQ"),
    "distance_constraint": ("body_A", "body_B", "p_AP", "p_BQ", "distance"),
}
IN_URDF = {**READ, "joint": (), f"{DRAKE}joint": ("screw_thread_pitch",)}
# of Drake's elements those for contact and for pictures
DRAWN = (
    "accepting_renderer", "capsule", "collision_filter_group", "declare_convex", "diffuse_map", "ellipsoid",
    "illustration_properties", "perception_properties", "proximity_properties",
)  # fmt: skip
_INSTEAD = {
    "weld_constraint": "'loops'",
    "distance_constraint_stiffness": "a force of type 'spring'",
    "distance_constraint_damping": "a force of type 'spring'",
    "tendon_constraint": "'couplers'",
    "linear_bushing_rpy": "a force of type 'bushing', whose moments follow the rotation vector",
    "linear_spring_damper": "a force of type 'spring'",
    "gear_ratio": "'drives', or the actuator of a transmission",
    "rotor_inertia": "'drives', or the actuator of a transmission",
}


@record
class Rotor:
    """The rotor of a joint: N and J [kg m^2]."""

    gear_ratio: float = 1.0
    inertia: float = 0.0


def refused(root: XmlElement) -> Iterator[tuple[XmlElement, str]]:
    """Yield Drake's elements that act on the motion and are not read, and what stands for them in a scene."""
    pending = [("", root)]
    read = IN_URDF if root.tag == "robot" else READ
    while pending:
        above, element = pending.pop()
        tag = element.tag.removeprefix(DRAKE)
        if tag == element.tag or _is_in(read, element, above):
            pending += [(element.tag, child) for child in reversed(element.children)]
        elif acts(element):
            yield element, instead(element)


def acts(element: XmlElement) -> bool:
    """Tell whether an element is one of Drake that acts on the motion."""
    return element.tag.startswith(DRAKE) and element.tag.removeprefix(DRAKE) not in DRAWN


def instead(element: XmlElement) -> str:
    """Return what stands in a scene for an element of Drake."""
    return _INSTEAD.get(element.tag.removeprefix(DRAKE), "'loops', 'couplers' or 'forces'")


def _is_in(read: Mapping[str, tuple[str, ...]], element: XmlElement, above: str) -> bool:
    """Tell whether an element of Drake is read in one with the tag ``above``."""
    tag, owner = element.tag.removeprefix(DRAKE), above.removeprefix(DRAKE)
    return bool({tag, tag.removeprefix(f"{owner}_")} & {*read.get(above, read.get(owner, ()))})


def is_read(element: XmlElement, owner: XmlElement) -> bool:
    """Tell whether an element is read as Drake has it; a transmission, if there is a rotor in it."""
    if element.tag == "transmission":
        return any(actuator.all(f"{DRAKE}rotor_inertia") for actuator in element.all("actuator"))
    return element.tag.startswith(DRAKE) and _is_in(READ, element, owner.tag)


def joint_kind(element: XmlElement, owner: str, kind: str, axis: tuple[float, ...]) -> dict[str, Any]:
    """Return what a ``drake:joint`` is: our kind, its axes, damping by coordinate, and the pitch of a screw [m/rad]."""
    if kind not in JOINTS:
        raise element.error(f"{owner}: {unknown_name('type', kind, JOINTS)}")
    ours, coordinates = JOINTS[kind]
    dynamics = element.one("dynamics", owner)
    values = [0.0] * len(coordinates)
    if dynamics is not None and "damping" in dynamics.attributes:
        size = 3 if kind == "planar" else 1
        values = dynamics.numbers("damping", owner, size) * (len(coordinates) // size)
        if min(values) < 0.0:
            raise dynamics.error(f"{owner}: damping is negative; allowed: numbers >= 0")
    if dynamics is not None and dynamics.number("friction", owner, 0.0):
        raise dynamics.error(
            f"{owner}: friction of a {DRAKE}joint is not read; allowed: 'friction' of the joint in the scene"
        )
    own: dict[str, Any] = {
        "type": ours,
        "axis": axis,
        "dampings": {k: x for k, x in zip(coordinates, values) if x},
    }
    if kind == "universal":
        own |= {"axis": (1.0, 0.0, 0.0), "axis2": (0.0, 1.0, 0.0)}
    elif kind == "planar":
        own["axis2"] = x_across(axis)
    elif kind == "screw":
        own["pitch"] = screw_pitch(element, owner)
    return own


def x_across(axis: tuple[float, ...]) -> tuple[float, ...]:
    """Return what the least rotation from z to an axis makes of x."""
    x, y, z = (u / math.hypot(*axis) for u in axis)
    if math.hypot(x, y) < 1e-10:
        return (1.0, 0.0, 0.0)
    # 1 + z as it is near -z too
    rest = 1.0 + z if z > 0.0 else (x * x + y * y) / (1.0 - z)
    return (1.0 - x * x / rest, -x * y / rest, -x)


def screw_pitch(element: XmlElement, owner: str) -> float:
    """Return the advance [m/rad] of a screw."""
    pitch = element.one(f"{DRAKE}screw_thread_pitch", owner)
    value = 0.0 if pitch is None else value_of(pitch, owner, 1)[0]
    if value == 0.0:
        raise (pitch or element).error(
            f"{owner} is a screw and needs <{DRAKE}screw_thread_pitch value=...>; allowed: a number, not 0 [m per turn]"
        )
    return value / math.tau


def rotors_of(root: XmlElement, faults: Faults) -> dict[str, tuple[XmlElement, Rotor]]:
    """Return the rotors in the transmissions of a URDF by joint, with their elements."""
    rotors: dict[str, tuple[XmlElement, Rotor]] = {}
    for transmission in root.all("transmission"):
        with faults:
            for actuator in transmission.all("actuator"):
                rotor = rotor_of(actuator, "a transmission")
                if not rotor.inertia:
                    continue
                kind = transmission.one("type", "a transmission")
                text = transmission.attributes.get("type", "") if kind is None else kind.content
                joint = transmission.one("joint", "a transmission")
                if "SimpleTransmission" not in text or joint is None:
                    raise actuator.error(
                        "a rotor in this transmission; allowed: those of type SimpleTransmission, with <joint>"
                    )
                rotors[joint.text("name", "a transmission")] = (actuator, rotor)
    return rotors


def rotor_of(element: XmlElement, owner: str) -> Rotor:
    """Return the rotor that an actuator of URDF or a joint of SDF states."""
    values = {"gear_ratio": 1.0, "rotor_inertia": 0.0}
    for name in values:
        child = element.one(DRAKE + name, owner)
        if child is not None:
            values[name] = value_of(child, owner, 1)[0]
    if values["rotor_inertia"] < 0.0:
        raise element.error(f"{owner}: rotor_inertia is negative; allowed: a number >= 0")
    return Rotor(*values.values())


def value_of(element: XmlElement, owner: str, size: int) -> list[float]:
    """Return the numbers of an element: its attribute ``value`` in URDF, its text in SDF."""
    return (
        element.numbers("value", owner, size)
        if "value" in element.attributes
        else element.values(owner, size)
    )


def constraint(element: XmlElement) -> tuple[str, list[tuple[str, tuple[float, ...]]], float]:
    """Return kind, links (or frames of SDF) with the points on them, and length of a constraint."""
    tag = element.tag
    kind = tag.removeprefix(DRAKE)

    def part(name: str) -> XmlElement:
        child = element.one(name, kind)
        if child is None:
            raise element.error(f"{kind} needs <{name}>")
        return child

    if kind == "weld_constraint":
        return "fixed", [(part(end).content.strip(), (0.0, 0.0, 0.0)) for end in ("parent", "child")], 0.0
    ends = []
    for body, point in (("body_A", "p_AP"), ("body_B", "p_BQ")):
        own = part(f"{tag}_{body}")
        link = own.attributes.get("name", own.content).strip()
        ends.append((link, tuple(value_of(part(f"{tag}_{point}"), kind, 3))))
    if kind == "ball_constraint":
        return "spherical", ends, 0.0
    length = value_of(part(f"{tag}_distance"), kind, 1)[0]
    if length <= 0.0:
        raise element.error(f"{kind}: the distance is {length:g}; allowed: a number > 0 [m]")
    return "distance", ends, length

"""The links and joints of a URDF file as typed data; everything that dynamics needs, nothing else.

The shapes of a URDF, and where its meshes lie. They are for pictures: no equation depends on them.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from robodyn_cli.errors import SceneError, shown, unknown_name
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.unread import (
    OF_CLOSURES,
    OF_DRAKE_ELEMENTS,
    POSE,
    SHAPES,
    TIES,
    Children,
    left_out,
    refuse_acting,
)
from robodyn_cli.scene.urdf.drake import DRAKE, Rotor, joint_kind
from robodyn_cli.scene.urdf.xml import XmlElement

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
ZERO = (0.0, 0.0, 0.0)
X_AXIS = (1.0, 0.0, 0.0)  # the format's default
UNLIMITED = 1e15  # a limit of this size or more is none
_INERTIA = ("xx", "xy", "xz", "yy", "yz", "zz")
# others are for pictures, contact, or programs of their own; ``loop`` and the like see ``closures.py``
_SPRING = tuple((f"spring_{k}", "'spring' of the joint in the scene") for k in ("stiffness", "reference"))
_LIMITS = ("lower", "upper", "effort", "velocity")
ACCELERATION = f"{DRAKE}acceleration"
_JOINT = Children(
    ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
    open=True,
    attributes=("name", "type", "independent"),
)
_ELEMENTS = {
    "robot": Children(("link", "joint", *TIES), ("transmission",), open=True),
    "link": Children(("inertial", *SHAPES), open=True, attributes=("name",)),
    "inertial": Children(("origin", "mass", "inertia"), open=True, attributes=()),
    "mass": Children((), open=True, attributes=("value",)),
    "inertia": Children((), open=True, attributes=tuple(f"i{k}" for k in _INERTIA)),
    "joint": _JOINT,
    f"{DRAKE}joint": _JOINT,
    "origin": POSE,
    "axis": Children((), open=True, attributes=("xyz",)),
    "limit": Children((), open=True, attributes=(*_LIMITS, ACCELERATION)),
    "dynamics": Children((), acting=_SPRING, open=True, attributes=("damping", "friction")),
    "mimic": Children((), open=True, attributes=("joint", "multiplier", "offset")),
    **OF_CLOSURES,
    **OF_DRAKE_ELEMENTS,
}
_VERSION = re.compile(r"1\.[0-9]+")


@record
class UrdfPose:
    """An ``origin``: position [m], and orientation as ``rpy`` [rad] or as a ``quaternion`` (w, x, y, z)."""

    xyz: tuple[float, ...] = ZERO
    rpy: tuple[float, ...] = ZERO
    quaternion: tuple[float, ...] | None = None

    @property
    def unit_quaternion(self) -> Any:
        """The orientation as a unit quaternion (w, x, y, z)."""
        from robodyn_cli.spatial import quaternion

        given = self.quaternion
        return quaternion.from_rpy(self.rpy) if given is None else quaternion.unit(given)

    @property
    def rotation(self) -> Any:
        """The orientation as a matrix (3, 3), whose columns are the axes."""
        from robodyn_cli.spatial import quaternion
        from robodyn_cli.spatial.algebra import rotation_rpy

        return (
            rotation_rpy(self.rpy) if self.quaternion is None else quaternion.rotation(self.unit_quaternion)
        )


@record
class Inertial:
    """Mass [kg], and the inertia [kg m^2] about the origin of ``pose``, the centre of mass, in its axes."""

    element: XmlElement
    mass: float
    pose: UrdfPose
    inertia: dict[str, float]


@record
class UrdfShape:
    """A shape that a link is drawn or tested with.

    kind : ``box``, ``sphere``, ``cylinder`` (``sizes`` : sides; radius; radius and length [m]) or ``mesh`` (``file``,
    as the URDF names it, whose coordinates are multiplied by ``sizes``); empty for what cannot be understood.
    """

    element: XmlElement
    kind: str
    sizes: tuple[float, ...] = ()
    file: str = ""
    pose: UrdfPose = UrdfPose()


@record
class UrdfLink:
    """A link; ``visual`` and ``collision`` : the shapes that it is drawn and tested with."""

    element: XmlElement
    name: str
    inertial: Inertial | None
    visual: tuple[UrdfShape, ...]
    collision: tuple[UrdfShape, ...]

    @property
    def shapes(self) -> tuple[UrdfShape, ...]:
        """All shapes."""
        return (*self.visual, *self.collision)

    @property
    def massless(self) -> bool:
        return self.inertial is None or (
            self.inertial.mass == 0.0 and not any(self.inertial.inertia.values())
        )


@record
class Mimic:
    """q = multiplier q_joint + offset."""

    element: XmlElement
    joint: str
    multiplier: float
    offset: float


@record
class UrdfJoint:
    """A joint; ``limits`` : lower, upper, effort, velocity and acceleration, as far as they are written.

    dampings : by coordinate of Drake's joints. pitch : of a screw [m/rad]. rotor : of its motor.
    """

    element: XmlElement
    name: str
    type: str
    parent: str
    child: str
    pose: UrdfPose
    axis: tuple[float, ...]
    limits: dict[str, float]
    mimic: Mimic | None
    damping: float = 0.0
    friction: float = 0.0
    axis2: tuple[float, ...] | None = None
    pitch: float = 0.0
    dampings: dict[str, float] = dataclasses.field(default_factory=dict)
    rotor: Rotor = Rotor()


@record
class UrdfRobot:
    """A robot; ``ignored`` : how many elements of each kind say nothing about dynamics."""

    element: XmlElement
    name: str
    links: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]
    ignored: Counter[str]


def read_elements(root: XmlElement, faults: Faults) -> UrdfRobot:
    """Return the links and joints of a robot; those with errors are reported and left out.

    Raises
    ------
    SceneError : xacro, or another version.
    """
    _refuse_xacro(root)
    version = root.attributes.get("version", "1.0").strip()
    if not _VERSION.fullmatch(version):
        raise root.error(f"version {shown(version)} of URDF; allowed: 1.0 and what follows it up to 2")
    refuse_acting(root, faults)
    links: list[UrdfLink] = []
    joints: list[UrdfJoint] = []
    for child in root.children:
        with faults:
            if child.tag == "link":
                links.append(_link(child))
            elif child.tag in ("joint", f"{DRAKE}joint"):
                joints.append(_joint(child))
    ignored = left_out(root, _ELEMENTS, faults)
    return UrdfRobot(root, root.attributes.get("name", "").strip(), tuple(links), tuple(joints), ignored)


def _refuse_xacro(root: XmlElement) -> None:
    pending = [root]
    while pending:
        element = pending.pop()
        if element.tag.startswith("xacro:"):
            name = element.place.source.name
            stem = name.removesuffix(".xacro").removesuffix(".urdf")
            # a shell empties the file behind ">" before xacro reads it
            target = f"{stem}.urdf" if f"{stem}.urdf" != name else f"{stem}_expanded.urdf"
            raise element.error(
                f"<{element.tag}> is a macro of xacro, which is not run here; run it first: "
                f"xacro {name} > {target}"
            )
        pending += reversed(element.children)


def _link(element: XmlElement) -> UrdfLink:
    name = element.text("name", "a link")
    owner = f"link {name!r}"
    visual, collision = (tuple(_shape(shape, owner) for shape in element.all(tag)) for tag in SHAPES)
    return UrdfLink(element, name, _inertial(element, owner), visual, collision)


def _shape(element: XmlElement, owner: str) -> UrdfShape:
    """Return a shape; one that is wrong is left out of pictures, and of nothing else."""
    shape = next((kind for geometry in element.all("geometry") for kind in geometry.children), None)
    if shape is None:
        return UrdfShape(element, "")
    try:
        sizes, file = _sizes(shape, owner), ""
        if shape.tag == "mesh":
            file = shape.text("filename", owner)
        return UrdfShape(shape, shape.tag if sizes else "", sizes, file, pose_of(element, owner))
    except SceneError:
        return UrdfShape(shape, "")


def _sizes(shape: XmlElement, owner: str) -> tuple[float, ...]:
    """Return the numbers of a geometry; none for one of another kind, or without extent."""
    if shape.tag == "mesh":
        return tuple(shape.numbers("scale", owner, 3, (1.0, 1.0, 1.0)))
    names = {"sphere": ("radius",), "cylinder": ("radius", "length")}.get(shape.tag, ())
    sizes = tuple(shape.numbers("size", owner, 3)) if shape.tag == "box" else ()
    sizes = sizes or tuple(shape.number(name, owner) for name in names)
    return sizes if all(size > 0.0 for size in sizes) else ()


def _inertial(link: XmlElement, owner: str) -> Inertial | None:
    inertial = link.one("inertial", owner)
    if inertial is None:
        return None
    mass, inertia = inertial.one("mass", owner), inertial.one("inertia", owner)
    if mass is None or inertia is None:
        raise inertial.error(f"{owner}: <inertial> needs <mass value=...> and <inertia ixx=... ... izz=...>")
    value = mass.number("value", owner)
    if value < 0.0:
        raise mass.error(f"{owner}: mass is negative (value {value:g}); allowed: a number >= 0 [kg]")
    moments = {k: inertia.number(f"i{k}", owner) for k in _INERTIA}
    return Inertial(inertial, value, pose_of(inertial, owner), moments)


def pose_of(element: XmlElement, owner: str, tag: str = "origin") -> UrdfPose:
    """Return the pose that a child of an element states, by default none."""
    origin = element.one(tag, owner)
    if origin is None:
        return UrdfPose()
    xyz = tuple(origin.numbers("xyz", owner, 3, ZERO))
    if "quat_xyzw" in origin.attributes:
        if "rpy" in origin.attributes:
            raise origin.error(f"{owner}: <{tag}> has rpy and quat_xyzw; allowed: one of them")
        return turned_by(origin, f"{owner}: quat_xyzw", xyz, origin.numbers("quat_xyzw", owner, 4))
    return UrdfPose(xyz, tuple(origin.numbers("rpy", owner, 3, ZERO)))


def turned_by(element: XmlElement, label: str, xyz: Iterable[float], xyzw: Sequence[float]) -> UrdfPose:
    """Return a pose whose orientation is a quaternion (x, y, z, w)."""
    x, y, z, w = xyzw
    if abs(math.hypot(x, y, z, w) - 1.0) > 1e-3:
        raise element.error(f"{label} has length {math.hypot(x, y, z, w):.6g}; allowed: 1, to three digits")
    return UrdfPose(tuple(xyz), quaternion=(w, x, y, z))


def _joint(element: XmlElement) -> UrdfJoint:
    name = element.text("name", "a joint")
    owner = f"joint {name!r}"
    kind = element.text("type", owner)
    independent = element.attributes.get("independent", "true")
    if independent.strip().lower() not in ("true", "false", "1", "0"):
        raise element.error(f"{owner}: independent is {shown(independent)}; allowed: true or false")
    own: dict[str, Any]
    if element.tag != "joint":
        own = joint_kind(element, owner, kind, _axis(element, owner, kind))
    elif kind in JOINT_TYPES:
        damping, friction = _dynamics(element, owner)
        axis = _axis(element, owner, kind)
        own = {"type": kind, "axis": axis, "damping": damping, "friction": friction}
    else:
        raise element.error(f"{owner}: {unknown_name('type', kind, JOINT_TYPES)}")
    for tag in ("parent", "child"):
        end = element.one(tag, owner)
        if end is None:
            raise element.error(f"{owner} needs <{tag} link=...>")
        own[tag] = end.text("link", owner)
    return UrdfJoint(
        element,
        name,
        pose=pose_of(element, owner),
        limits=_limits(element, owner),
        mimic=_mimic(element, owner),
        **own,
    )


def _axis(element: XmlElement, owner: str, kind: str) -> tuple[float, ...]:
    axis = element.one("axis", owner)
    if axis is None or kind in ("fixed", "floating"):
        return X_AXIS
    direction = tuple(axis.numbers("xyz", owner, 3, X_AXIS))
    if not any(direction):
        raise axis.error(
            f"{owner}: the axis is zero (value {shown(axis.attributes['xyz'])}); allowed: a direction"
        )
    return direction


def _limits(element: XmlElement, owner: str) -> dict[str, float]:
    limit = element.one("limit", owner)
    names = (*_LIMITS, ACCELERATION)
    return {} if limit is None else {k: limit.number(k, owner) for k in names if k in limit.attributes}


def _dynamics(element: XmlElement, owner: str) -> tuple[float, float]:
    """Return damping and friction, both >= 0."""
    dynamics = element.one("dynamics", owner)
    if dynamics is None:
        return 0.0, 0.0
    values = {k: dynamics.number(k, owner, 0.0) for k in ("damping", "friction")}
    for k, value in values.items():
        if value < 0.0:
            raise dynamics.error(f"{owner}: {k} is negative (value {value:g}); allowed: a number >= 0")
    return values["damping"], values["friction"]


def _mimic(element: XmlElement, owner: str) -> Mimic | None:
    mimic = element.one("mimic", owner)
    if mimic is None:
        return None
    leader = mimic.text("joint", f"{owner}: mimic")
    return Mimic(mimic, leader, mimic.number("multiplier", owner, 1.0), mimic.number("offset", owner, 0.0))

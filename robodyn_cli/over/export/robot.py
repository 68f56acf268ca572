"""What formats of robots have in common: links with frames on their joints, closures and couplers, as numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np

from robodyn_cli.errors import listed
from robodyn_cli.forces.friction import Friction
from robodyn_cli.forces.springs import Damper, Spring
from robodyn_cli.model.model import BASE, Body, FixedFrame, JointForce, Model
from robodyn_cli.record import record
from robodyn_cli.scene.sdf.frames import between, cleaned, matrix, pose_between
from robodyn_cli.scene.ties import LoopEnd
from robodyn_cli.scene.types import Scene
from robodyn_cli.scene.urdf.elements import UrdfPose
from robodyn_cli.spatial.algebra import Array, Transform, rotation_rpy

Element = ElementTree.Element
GROUND = ""  # as the parent of a link, and the link of an end
WITH_TWO_AXES = ("universal", "planar")


@record
class Coordinate:
    """What acts along one coordinate of a joint.

    name : as in the scene. limits : ``lower``, ``upper``, ``speed``, ``effort``, as far as they are single numbers.
    gear_ratio, rotor_inertia : N and J, which add N^2 J.
    """

    name: str
    limits: Mapping[str, float]
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    gear_ratio: float = 1.0
    rotor_inertia: float = 0.0

    @property
    def acts(self) -> bool:
        """Whether there is a force or a rotor."""
        return any((self.damping, self.friction, self.stiffness, self.rotor_inertia))


@record
class ExportedLink:
    """A link and the joint that moves it; the joint's place is the origin of the link's frame.

    parent : name of a link, or ``GROUND``. pose : in the parent's frame, at the robot's reference positions. axes :
    (3, 3) of the joint in the link's frame as columns: the third is the joint's axis, the first the second axis of
    joints with two. damping : of a rotation in space. inertia : (3, 3) about the centre of mass, link axes.
    """

    name: str
    joint: str
    type: str
    parent: str
    pose: UrdfPose
    axes: Array
    pitch: float
    coordinates: tuple[Coordinate, ...]
    mass: float
    com: Array
    inertia: Array
    damping: float = 0.0

    @property
    def axis(self) -> Array:
        return self.axes[:, 2]

    @property
    def massless(self) -> bool:
        return self.mass == 0.0 and not self.inertia.any()


@record
class ExportedLoop:
    """A closure; each end has a point of a link and the closure's axis, in the link's frame.

    attitude : (3, 3) of the second link's frame in that of the first, where the closure holds it.
    """

    name: str
    type: str
    ends: tuple[LoopEnd, LoopEnd]
    attitude: Array


@record
class ExportedCoupler:
    """The sum of coefficient times q is ``value``."""

    name: str
    terms: Mapping[str, float]
    value: float


@record
class ExportedRobot:
    """A robot with all numbers. gravity : in world axes. links : in the order of the joints in the scene.

    actuated : joints with a motor, None where the scene does not say.
    """

    name: str
    gravity: Array
    links: tuple[ExportedLink, ...]
    loops: tuple[ExportedLoop, ...] = ()
    couplers: tuple[ExportedCoupler, ...] = ()
    actuated: tuple[str, ...] | None = None

    def link(self, name: str) -> ExportedLink:
        return next(link for link in self.links if link.name == name)

    def joint(self, name: str) -> ExportedLink:
        """Return the link of a joint."""
        return next(link for link in self.links if link.joint == name)

    def attitude(self, name: str) -> Array:
        """Return the axes (3, 3) of a link's frame in the world, at the reference positions."""
        R = np.eye(3)
        while name != GROUND:
            link = self.link(name)
            R, name = np.array(link.pose.rotation, dtype=float) @ R, link.parent
        return R


class ExportedFrames:
    """The frames that the links of a model have in another format, by body.

    turned : kinds of joint whose links have the axes of the joint: z along its axis, x along the second one. Links of
    joints with D-H parameters have them too; other links keep their axes. reference : positions of all joints, (nq,).
    """

    def __init__(self, model: Model, turned: Collection[str], dh: Collection[str], reference: Array) -> None:
        self.model, self.reference = model, reference
        self.own = {BASE: pose_of(model.base)}
        for k, body in enumerate(model.bodies):
            keeps = body.joint.type not in turned and body.joint_name not in dh and body.name in model.links
            self.own[k] = placed(model.links[body.name].R if keeps else np.eye(3), np.zeros(3))

    def at(self, frame: FixedFrame) -> Array:
        """Return the pose (4, 4) of a frame of the model in its link's frame."""
        inside = placed(frame.R, frame.p)
        return self.own[BASE] @ inside if frame.body == BASE else between(self.own[frame.body], inside)

    def axes(self, body: Body) -> Array:
        """Return the axes (3, 3) of a joint in its body's frame, at the reference: z first of two, x the second."""
        q = self.reference[body.q : body.q + body.joint.nq]
        axes = np.eye(3)
        if body.joint.type == "universal":
            axes[:, 2] = np.array(body.joint.transform(q).E, dtype=float)[:, 2]
        return axes

    def pose(self, body: int) -> Array:
        """Return the pose (4, 4) of a link's frame in that of its parent, at the reference."""
        one = self.model.bodies[body]
        q = self.reference[one.q : one.q + one.joint.nq]
        T = pose_of(one.X_tree) @ pose_of(one.joint.transform(q)) @ self.own[body]
        return self.own[BASE] @ T if one.parent == BASE else between(self.own[one.parent], T)


def placed(R: Any, p: Any) -> Array:
    """Return axes and origin as a matrix (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.array(R, dtype=float), np.array(p, dtype=float)
    return T


def pose_of(X: Transform) -> Array:
    """Return the pose (4, 4) of the frame that a transform leads to."""
    return placed(X.E.T, X.r)


def links_of(
    model: Model, frames: ExportedFrames, limits: Mapping[str, Mapping[str, float]]
) -> tuple[ExportedLink, ...]:
    """Return the links of a model whose bodies are all known, in the order of its bodies.

    limits : by coordinate.
    """
    links = []
    for k, body in enumerate(model.bodies):
        parent = GROUND if body.parent == BASE else model.bodies[body.parent].name
        axes = frames.own[k][:3, :3].T @ frames.axes(body)
        mass, com, inertia = _mass_properties(body, frames.own[k])
        coordinates = tuple(_coordinate(body, j, limits) for j in range(body.joint.nv))
        damping = sum(float(_viscous(f)) for f in body.forces if f.in_space)
        links.append(
            ExportedLink(
                body.name, body.joint_name, body.joint.type, parent, pose_between(frames.pose(k)), axes,
                float(body.joint.pitch), coordinates, mass, com, inertia, damping,
            )
        )  # fmt: skip
    return tuple(links)


def _coordinate(body: Body, j: int, limits: Mapping[str, Mapping[str, float]]) -> Coordinate:
    """Return a coordinate of a body's joint; forces that a format may not have are refused before."""
    name = body.joint.coordinates(body.joint_name, body.joint.v_names)[j]
    N = float(body.gear_ratios[j])
    values = {"damping": 0.0, "friction": 0.0, "stiffness": 0.0, "rest": 0.0}
    for force in body.forces:
        if force.in_space or force.v != body.v + j:
            continue
        values["damping"] += _viscous(force)
        if isinstance(force.element, Friction):
            values["friction"] += float(force.element.scale(N) * force.element.levels()[0])
        elif isinstance(force.element, Spring):
            values |= {"stiffness": float(force.element.stiffness), "rest": float(force.element.rest)}
    return Coordinate(
        name, limits.get(name, {}), **values, gear_ratio=N, rotor_inertia=float(body.rotors[j]) / (N * N)
    )


def _viscous(force: JointForce) -> float:
    if isinstance(force.element, Damper):
        return float(force.element.damping)
    if isinstance(force.element, Friction):
        return float(-force.element.viscous_torque(1.0, force.gear_ratio))
    return 0.0


def _mass_properties(body: Body, own: Array) -> tuple[float, Array, Array]:
    """Return mass, centre of mass and inertia about it, in the link's frame ``own`` (4, 4)."""
    masses, points, tensors = [], [], []
    for part in body.parts:
        T = between(own, pose_of(part.frame))
        masses.append(float(part.m))
        points.append(T[:3, :3] @ np.array(part.c, dtype=float) + T[:3, 3])
        tensors.append(T[:3, :3] @ np.array(part.I_com, dtype=float) @ T[:3, :3].T)
    mass = sum(masses)
    if mass == 0.0:
        return 0.0, np.zeros(3), sum(tensors, np.zeros((3, 3)))
    com = points[0] if len(points) == 1 else sum(m * c for m, c in zip(masses, points)) / mass
    inertia = np.zeros((3, 3))
    for m, c, tensor in zip(masses, points, tensors):
        d = c - com
        inertia = inertia + tensor + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, com, inertia


def loops_of(model: Model, frames: ExportedFrames) -> tuple[ExportedLoop, ...]:
    """Return the closures of a model."""
    loops = []
    for loop in model.loops:
        element, ends = loop.element, []
        axes = (element.axis, element.axis2 or element.axis)
        turned = []
        for frame, axis in zip((loop.first, loop.second), axes):
            T = frames.at(frame)
            direction = np.array(axis or (0.0, 0.0, 1.0), dtype=float)
            u = T[:3, :3] @ (direction / np.linalg.norm(direction))
            link = GROUND if frame.body == BASE else model.bodies[frame.body].name
            ends.append(LoopEnd(link, UrdfPose(floats(T[:3, 3])), tuple(cleaned(x) for x in floats(u))))
            turned.append(T[:3, :3])
        attitude = turned[0] @ np.array(rotation_rpy(element.rpy), dtype=float) @ turned[1].T
        attitude = np.array([[cleaned(float(x)) for x in row] for row in attitude])
        loops.append(ExportedLoop(loop.name, element.type, (ends[0], ends[1]), attitude))
    return tuple(loops)


def floats(x: Any) -> tuple[float, ...]:
    """Return numbers as plain floats, none of them a negative zero."""
    return tuple(float(e) + 0.0 for e in np.ravel(x))


def kept_origins(
    scene: Scene, links: tuple[ExportedLink, ...], turned: Collection[str]
) -> tuple[ExportedLink, ...]:
    """Return the links with the origins of the scene where these are given as the formats give them.

    They differ by rounding from those that were computed, but have the digits that the user wrote.
    """
    joints = {str(joint.link): joint for joint in scene.robot.joints}
    moved = {name for name, joint in joints.items() if joint.has_dh or joint.type in turned}
    based = scene.robot.base.plain and not any((*scene.robot.base.xyz, *(scene.robot.base.rpy or ())))
    kept = []
    for link in links:
        joint = joints[link.name]
        bare = {link.name, link.parent}.isdisjoint(moved) and joint.offset == 0.0 and (link.parent or based)
        origin = joint.origin
        if bare and origin is not None and origin.plain:
            link = dataclasses.replace(
                link, pose=UrdfPose(floats(origin.xyz), floats(origin.rpy or (0.0,) * 3))
            )
        kept.append(link)
    return tuple(kept)


def base_pose(pose: UrdfPose) -> bool:
    """Tell whether a pose is that of the frame itself."""
    return bool(np.array_equal(matrix(pose), np.eye(4)))


# -- what formats share ------------------------------------------------------------------------------------
def followers(
    couplers: Iterable[ExportedCoupler],
) -> tuple[dict[str, tuple[str, float, float, str]], list[ExportedCoupler]]:
    """Return couplers of two joints as q = multiplier q_leader + offset, and the other couplers.

    The first are by joint: leader, multiplier, offset and the name of the coupler; each joint follows at most one.
    """
    mimics: dict[str, tuple[str, float, float, str]] = {}
    others = []
    for coupler in couplers:
        terms = list(coupler.terms.items())
        ways = [terms, terms[::-1]] if len(terms) == 2 else []
        for (name, a), (leader, b) in ways:
            if name not in mimics and not _follows(mimics, leader, name):
                mimics[name] = (leader, -b / a + 0.0, coupler.value / a, coupler.name)
                break
        else:
            others.append(coupler)
    return mimics, others


def _follows(mimics: Mapping[str, tuple[str, float, float, str]], joint: str, other: str) -> bool:
    """Tell whether a joint follows another, directly or by way of others."""
    while joint in mimics:
        joint = mimics[joint][0]
        if joint == other:
            return True
    return joint == other


def rotor_notes(robot: ExportedRobot) -> list[str]:
    """Return what there is to say of rotors that are written as Drake has them."""
    names = [link.joint for link in robot.links if any(one.rotor_inertia for one in link.coordinates)]
    return [f"rotors as Drake has them, which others pass over: {listed(names)}"] if names else []


def held_root(robot: ExportedRobot) -> bool:
    """Tell whether one link alone is on the ground, and fixed there where the world is."""
    roots = [link for link in robot.links if link.parent == GROUND]
    tied = any(end.link == GROUND for loop in robot.loops for end in loop.ends)
    return len(roots) == 1 and roots[0].type == "fixed" and base_pose(roots[0].pose) and not tied


# -- XML ---------------------------------------------------------------------------------------------------
def words(x: Any) -> str:
    """Return numbers as text, from which the same numbers are read."""
    return " ".join(repr(e) for e in floats(x))


def xml_text(root: Element) -> str:
    """Return the text of an XML file."""
    ElementTree.indent(root)
    body = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n<!-- by `robodyn export`; SI units -->\n{body}\n'


def fresh(name: str, taken: Collection[str]) -> str:
    """Return a name that is not taken."""
    k, new = 1, name
    while new in taken:
        k, new = k + 1, f"{name}_{k + 1}"
    return new

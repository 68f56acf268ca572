"""Build the model from the scene: place bodies, merge links on fixed joints, make unknown data symbols."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.formula import formulas_in, points_of
from robodyn_cli.expr.graph import Graph, is_nonzero
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.joints import (
    by_coordinate,
    joint_forces,
    joint_kind,
    joint_placement,
    orientation,
    springs_in_space,
)
from robodyn_cli.model.model import (
    BASE,
    PARAMETER_GROUP,
    UNKNOWN_GROUP,
    Body,
    FixedFrame,
    Force,
    Loop,
    Model,
    RigidPart,
)
from robodyn_cli.model.places import with_places
from robodyn_cli.record import mutable_record, record
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    Vector,
    identity,
    matrix,
    vector,
)
from robodyn_cli.spatial.inertia import RigidInertia


def parent_link(robot: sc.Robot, index: int) -> str:
    """Return the name of the link that joint ``index`` hangs on (``base`` for the ground)."""
    joint = robot.joints[index]
    if joint.parent is not None:
        return joint.parent
    return "base" if index == 0 else moved_link(robot, index - 1)


def moved_link(robot: sc.Robot, index: int) -> str:
    """Return the name of the link that joint ``index`` moves."""
    joint = robot.joints[index]
    return joint.link if joint.link is not None else robot.links[index].name


@record
class _Placed:
    """Where a link is: the body that carries it, its joint frame and its link frame in body coordinates."""

    body: int
    joint_frame: Transform
    link_frame: Transform

    def frame_of_com(self, link: sc.Link) -> Transform:
        """Return the frame in which the link's centre of mass and inertia are given."""
        return self.joint_frame if (link.com_frame or "joint") == "joint" else self.link_frame


@mutable_record
class _Moving:
    """A body that its joint moves; ``parts`` are the links that it carries."""

    name: str
    joint: sc.Joint
    parent: int
    X_tree: Transform
    parts: tuple[RigidPart, ...] = ()


class _Values:
    """Numbers of the scene, replaced by symbols where they are unknown or asked for as parameters."""

    def __init__(self, graph: Graph, symbolic: Sequence[str]) -> None:
        self.graph = graph
        self.symbolic = list(symbolic)
        self.used: set[str] = set()

    def get(self, path: str, value: float | None, unknown: str = "") -> Any:
        if path in self.symbolic:
            self.used.add(path)
            return self.graph.symbol(path, PARAMETER_GROUP, self.symbolic.index(path))
        if value is None:
            return self.graph.symbol(unknown, UNKNOWN_GROUP)
        return value

    def check(self) -> None:
        missing = [p for p in self.symbolic if p not in self.used]
        if missing:
            raise SceneError(
                f"symbolic parameter {missing[0]!r} names no constant of the model; "
                "known are links.NAME.mass, links.NAME.com.0, links.NAME.inertia.xx, joints.NAME.a, gravity.1 ..."
            )


def _rigid_part(link: sc.Link, values: _Values, frame: Transform) -> RigidPart | None:
    """Return what a link adds to its body, None for nothing; ``frame`` takes body coordinates to ``com_frame``."""
    path = f"links.{link.name}"
    m = values.get(f"{path}.mass", link.mass, f"mass of {link.name}")
    if not is_nonzero(m) and link.com is None and link.inertia == sc.Inertia():
        return None
    c = _com(link, values)
    I = {
        k: values.get(f"{path}.inertia.{k}", getattr(link.inertia, k), f"inertia.{k} of {link.name}")
        for k in ("xx", "yy", "zz", "xy", "xz", "yz")
    }
    given = [k for k in I if getattr(link.inertia, k) is not None]
    if given and {"xx", "yy", "zz"} <= set(given):
        # with all three moments given, products of inertia that are not written are zero, as in every handbook
        for k in ("xy", "xz", "yz"):
            if getattr(link.inertia, k) is None and f"{path}.inertia.{k}" not in values.used:
                I[k] = 0.0
    tensor = matrix([[I["xx"], I["xy"], I["xz"]], [I["xy"], I["yy"], I["yz"]], [I["xz"], I["yz"], I["zz"]]])
    return RigidPart(m, c, tensor, frame)


def _com(link: sc.Link, values: _Values) -> Vector:
    """Return a link's centre of mass in the frame in which it is given."""
    com = link.com if link.com is not None else (None, None, None)
    return vector(
        [values.get(f"links.{link.name}.com.{k}", com[k], f"com[{k}] of {link.name}") for k in range(3)]
    )


def build_model(
    scene: sc.Scene,
    symbolic: Sequence[str] = (),
    graph: Graph | None = None,
    merge: bool = True,
    switched: bool = False,
) -> Model:
    """Build the model of a scene.

    Parameters
    ----------
    scene : the checked scene.
    symbolic : constants (``links.link1.mass``, ``joints.theta1.a``, ``gravity.1``) to keep as parameters, in the
        order in which kernels take them.
    graph : where symbols live; a new one by default.
    merge : links on fixed joints become parts of what carries them, instead of bodies of their own.
    switched : whether parameters say which payloads are carried; else it is those that are at t = 0.
    """
    graph = graph or Graph()
    scene = with_places(scene)
    values = _Values(graph, symbolic)
    robot = scene.robot
    placed, moving = _place_links(scene, values, merge)
    gravity = vector([values.get(f"gravity.{k}", g) for k, g in enumerate(scene.gravity)])
    base = Transform.from_pose(orientation(robot.base), vector(robot.base.xyz))
    places = _Places(scene, placed, values)
    payloads = _take_up(places, moving, values, switched) if scene.payloads else ()
    changing = [payload for payload in payloads if payload.place is not None]
    bodies = _number(robot, moving, values)
    # in the order of their places, which is that of the YAML
    joints = [(b.joint_name, b.joint) for b in sorted(bodies, key=lambda b: b.v) if b.joint.nv]
    model = Model(
        name=scene.title or "scene",
        bodies=bodies,
        nq=sum(b.joint.nq for b in bodies),
        nv=sum(b.joint.nv for b in bodies),
        gravity=base.E @ gravity,
        graph=graph,
        base=base,
        points=places.points,
        frames=places.frames,
        links={name: FixedFrame(p.body, p.link_frame.r, p.link_frame.E.T) for name, p in placed.items()},
        outlines=_outlines(robot, placed, places.points, bodies),
        loops=tuple(places.loop(element) for element in scene.loops),
        couplers=tuple(coupler.name for coupler in scene.couplers),
        forces=(*(places.force(element) for element in scene.forces), *springs_in_space(scene, bodies)),
        joint_names=tuple(name for name, _ in joints),
        q_names=tuple(x for name, joint in joints for x in joint.coordinates(name, joint.names)),
        v_names=tuple(x for name, joint in joints for x in joint.coordinates(name, joint.v_names)),
        q_units=tuple(unit for _, joint in joints for unit in joint.units),
        v_units=tuple(unit for _, joint in joints for unit in joint.v_units),
        parameters=(*symbolic, *(f"payloads.{payload.name}" for payload in changing)),
        of_points={name: tuple(map(places.at, points_of(name))) for name in _names_of_points(scene)},
        payloads=payloads,
        switched=tuple(float(payload.spec.start is None) for payload in changing),
    )
    values.check()
    return model


def _place_links(scene: sc.Scene, values: _Values, merge: bool) -> tuple[dict[str, _Placed], list[_Moving]]:
    """Return where each link is, and the bodies that move; a link on a fixed joint is part of its parent's body."""
    robot = scene.robot
    links = {link.name: link for link in robot.links}
    placed: dict[str, _Placed] = {"base": _Placed(BASE, Transform.identity(), Transform.identity())}
    moving: list[_Moving] = []
    for index in _topological(robot):
        joint = robot.joints[index]
        name = moved_link(robot, index)
        parent = placed[parent_link(robot, index)]
        X_joint, joint_frame, link_frame = joint_placement(robot, joint, values.get)
        X_tree = X_joint @ parent.link_frame
        if merge and joint_types[joint.type].nv == 0:
            here = _Placed(parent.body, joint_frame @ X_tree, link_frame @ X_tree)
        else:
            here = _Placed(len(moving), joint_frame, link_frame)
            moving.append(_Moving(name, joint, parent.body, X_tree))
        placed[name] = here
        part = _rigid_part(links[name], values, here.frame_of_com(links[name]))
        if here.body != BASE and part is not None:  # what is fixed to the ground has no effect
            moving[here.body].parts += (part,)
    if scene.drives:
        from robodyn_cli.model.parts import add_drives

        add_drives(scene, placed, moving)
    return placed, moving


def _topological(robot: sc.Robot) -> list[int]:
    """Return joint indices, parents first, otherwise in the order of the YAML."""
    joints = range(len(robot.joints))
    hanging: dict[str, list[int]] = {}
    for k in joints:
        hanging.setdefault(parent_link(robot, k), []).append(k)
    order: list[int] = []
    ready = hanging.get("base", [])
    while ready:
        order += ready
        ready = sorted(k for one in ready for k in hanging.get(moved_link(robot, one), ()))
    if len(order) < len(joints):
        loose = min(set(joints) - set(order))
        raise SceneError(f"joint {robot.joints[loose].name!r} does not hang on the base")
    return order


def _number(robot: sc.Robot, moving: list[_Moving], values: _Values) -> tuple[Body, ...]:
    """Give bodies their places in q and v, which follow the joints' order in the YAML."""
    start: dict[str, tuple[int, int]] = {}
    nq = nv = 0
    for joint in robot.joints:
        kind = joint_types[joint.type]
        start[joint.name] = (nq, nv)
        nq += kind.nq
        nv += kind.nv
    bodies = []
    for body in moving:
        joint = body.joint
        kind = joint_kind(joint)
        ratios = by_coordinate(kind, joint.gear_ratio, 1.0)
        rotor = values.get(f"joints.{joint.name}.rotor_inertia", joint.rotor_inertia)
        armature = tuple(N * N * J for N, J in zip(ratios, by_coordinate(kind, rotor, 0.0)))
        bodies.append(
            Body(
                name=body.name,
                joint_name=joint.name,
                joint=kind,
                parent=body.parent,
                X_tree=body.X_tree,
                inertia=sum((part.inertia for part in body.parts), RigidInertia.zero()),
                parts=body.parts,
                q=start[joint.name][0],
                v=start[joint.name][1],
                armature=armature[0] if kind.nv == 1 else armature,
                gear_ratio=ratios[0] if kind.nv == 1 else ratios,
                forces=tuple(joint_forces(joint, kind, start[joint.name], ratios)),
            )
        )
    return tuple(bodies)


class _Places:
    """Places of the scene (points, frames, ends of loops and forces) as frames fixed to bodies."""

    def __init__(self, scene: sc.Scene, placed: dict[str, _Placed], values: _Values) -> None:
        self.scene, self.placed, self.values = scene, placed, values
        self.links = {link.name: link for link in scene.robot.links}
        self.points = {name: self._moving(point) for name, point in scene.robot.points.items()}
        self.frames = {name: self._fixed(frame) for name, frame in scene.robot.frames.items()}

    def _fixed(self, point: sc.Place) -> FixedFrame:
        where = self.placed[point.link]
        frame = where.joint_frame if point.frame == "joint" else where.link_frame
        R: Matrix = frame.E.T
        at: Vector
        if point.at == "origin":
            at = where.joint_frame.r
        elif point.at == "end":
            at = where.link_frame.r
        elif point.at == "com":
            at = self._com(self.links[point.link])
        else:
            at = frame.point(vector(point.at))
        if isinstance(point, sc.Frame):
            R = R @ orientation(point)
        return FixedFrame(where.body, at, R)

    def _com(self, link: sc.Link) -> Vector:
        return self.placed[link.name].frame_of_com(link).point(_com(link, self.values))

    def _moving(self, point: sc.Point) -> FixedFrame:
        """Return a point; one of the base may have a prescribed motion, as a function of t."""
        frame = self._fixed(point)
        if point.motion is None:
            return frame
        parameters = {f"p.{name}": x for name, x in self.scene.parameters.items()}
        env = {"t": self.values.graph.symbol("t", "t"), **parameters}
        moved = vector([x + formula.evaluate(env) for x, formula in zip(frame.p, point.motion)])
        return FixedFrame(frame.body, moved, frame.R)

    def at(self, text: str) -> FixedFrame:
        """Return the place of a reference such as ``tip`` or ``link2.end``, with the axes of the link's frame."""
        link, _, at = text.partition(".")
        if not at:
            # the axes of a loop are given in the link's frame, whatever frame placed the point
            named, axes = self.points[text], self.placed[self.scene.robot.points[text].link].link_frame.E.T
            return FixedFrame(named.body, named.p, axes)
        if link == "base" and at in self.points:
            return self.points[at]
        own = self._fixed(sc.Point(link=link, at=at))
        return FixedFrame(own.body, own.p, self.placed[link].link_frame.E.T)

    def loop(self, element: Any) -> Loop:
        """Return a loop closure between its two places."""
        first, second = (self.at(text) for text in element.between)
        return Loop(element.name, element, first, second)

    def of(self, text: str) -> FixedFrame:
        """Return a named frame with its own axes, or a point as ``at`` does."""
        return self.frames[text] if text in self.frames else self.at(text)

    def force(self, element: Any) -> Force:
        """Return a force element with its places."""
        return Force(element.name, element, tuple(self.of(text) for text in element.references))


def _take_up(places: _Places, moving: Sequence[_Moving], values: _Values, switched: bool) -> tuple[Any, ...]:
    """Return the scene's payloads, which become parts of the bodies that carry them."""
    from robodyn_cli.model.parts import as_link, carried_part, placed

    payloads = []
    count = itertools.count(len(values.symbolic))
    for spec in places.scene.payloads:
        part = _rigid_part(as_link(spec), values, Transform.identity())
        place = next(count) if switched and spec.changes else None
        payload = placed(spec, places.of(spec.at), part, place)
        payloads.append(payload)
        added = carried_part(payload, values.graph)
        if added is not None:
            moving[payload.body].parts += (added,)
    return tuple(payloads)


def _names_of_points(scene: sc.Scene) -> list[str]:
    """Return the names of what formulas ask of points, in the order of the scene."""
    given = [scene.torques, scene.forces, scene.payloads, scene.control, scene.outputs.signals]
    formulas = formulas_in([*given, scene.deploy.latches])
    names = (name for x in formulas for name in sorted(x.names))
    return list(dict.fromkeys(name for name in names if name.endswith(")")))


def _outlines(
    robot: sc.Robot, placed: dict[str, _Placed], points: dict[str, FixedFrame], bodies: Sequence[Body]
) -> dict[str, tuple[FixedFrame, ...]]:
    """Return, for each moving link, its joint, the joints it carries (at zero), its far end, its named points."""
    outlines: dict[str, tuple[FixedFrame, ...]] = {}
    carried: dict[str, list[int]] = {}
    for k in range(len(robot.joints)):
        carried.setdefault(parent_link(robot, k), []).append(k)
    for k in range(len(robot.joints)):
        name = moved_link(robot, k)
        where = placed[name]
        if where.body == BASE:
            continue
        spots = [where.joint_frame.r]
        for other in carried.get(name, []):
            child = placed[moved_link(robot, other)]
            merged = child.body == where.body  # by a fixed joint
            spots.append(child.joint_frame.r if merged else bodies[child.body].X_tree.r)
        spots.append(where.link_frame.r)
        spots.extend(points[p].p for p, spec in robot.points.items() if spec.link == name)
        unique: list[Vector] = []
        for p in spots:
            if not any(all(a is b or a == b for a, b in zip(p, other)) for other in unique):
                unique.append(p)
        outlines[name] = tuple(FixedFrame(where.body, p, identity()) for p in unique)
    return outlines

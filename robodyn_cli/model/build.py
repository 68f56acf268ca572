"""Build the model from the scene: place bodies, merge what is fixed, name what is unknown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.graph import Graph, is_nonzero
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import (
    BASE,
    PARAMETER_GROUP,
    UNKNOWN_GROUP,
    Body,
    FixedFrame,
    Force,
    JointForce,
    Loop,
    Model,
)
from robodyn_cli.model.placement import joint_kind, joint_placement
from robodyn_cli.record import mutable_record
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    Vector,
    identity,
    matrix,
    rotation_rpy,
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


@mutable_record
class _Placed:
    """Where a link is: the body that carries it, its joint frame and its link frame in body coordinates."""

    body: int
    joint_frame: Transform
    link_frame: Transform


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
        return float(value)

    def check(self) -> None:
        missing = [p for p in self.symbolic if p not in self.used]
        if missing:
            raise SceneError(
                f"symbolic parameter {missing[0]!r} names no constant of the model; "
                "known are links.NAME.mass, links.NAME.com.0, links.NAME.inertia.xx, joints.NAME.a, gravity.1 ..."
            )


def _inertia(link: sc.Link, values: _Values, frame: Transform) -> RigidInertia:
    """Return a link's inertia in body coordinates; ``frame`` takes body coordinates to those of ``com_frame``."""
    path = f"links.{link.name}"
    m = values.get(f"{path}.mass", link.mass, f"mass of {link.name}")
    if not is_nonzero(m) and link.com is None and link.inertia == sc.Inertia():
        return RigidInertia.zero()
    com = link.com if link.com is not None else (None, None, None)
    c = vector([values.get(f"{path}.com.{k}", com[k], f"com[{k}] of {link.name}") for k in range(3)])
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
    return RigidInertia.from_com(m, c, tensor).to_parent(frame)


def build_model(scene: sc.Scene, symbolic: Sequence[str] = (), graph: Graph | None = None) -> Model:
    """Build the model of a scene.

    Parameters
    ----------
    scene : the checked scene.
    symbolic : constants (``links.link1.mass``, ``joints.theta1.a``, ``gravity.1``) to keep as parameters, in the
        order in which kernels take them.
    graph : where symbols live; a new one by default.
    """
    graph = graph or Graph()
    values = _Values(graph, symbolic)
    robot = scene.robot
    links = {link.name: link for link in robot.links}
    placed: dict[str, _Placed] = {"base": _Placed(BASE, Transform.identity(), Transform.identity())}
    bodies: list[dict[str, Any]] = []
    merged: dict[int, RigidInertia] = {}
    for index in _topological(robot):
        joint = robot.joints[index]
        name = moved_link(robot, index)
        parent = placed[parent_link(robot, index)]
        X_joint, joint_frame, link_frame = joint_placement(robot, joint, values.get)
        X_tree = X_joint @ parent.link_frame
        link = links[name]
        if joint_types[joint.type].nv == 0:
            here = _Placed(parent.body, joint_frame @ X_tree, link_frame @ X_tree)
        else:
            here = _Placed(len(bodies), joint_frame, link_frame)
            bodies.append({"joint": joint, "X_tree": X_tree, "parent": parent.body, "name": name})
        placed[name] = here
        if here.body != BASE:
            frame = here.joint_frame if (link.com_frame or "joint") == "joint" else here.link_frame
            own = _inertia(link, values, frame)
            merged[here.body] = merged[here.body] + own if here.body in merged else own
    gravity = vector([values.get(f"gravity.{k}", g) for k, g in enumerate(scene.gravity)])
    base = Transform.from_pose(rotation_rpy(robot.base.rpy), vector(robot.base.xyz))
    finished = _number(robot, bodies, merged, values)
    # in the order of their places, which is that of the YAML
    joints = [(b.joint_name, b.joint) for b in sorted(finished, key=lambda b: b.v)]
    points = {
        name: _moving(scene, graph, point, _fixed_frame(placed, links, point, values))
        for name, point in (robot.points or {}).items()
    }
    frames = {
        name: _fixed_frame(placed, links, frame, values) for name, frame in (robot.frames or {}).items()
    }
    link_frames = {name: FixedFrame(p.body, p.link_frame.r, p.link_frame.E.T) for name, p in placed.items()}
    model = Model(
        name=scene.title or "scene",
        bodies=finished,
        nq=sum(b.joint.nq for b in finished),
        nv=sum(b.joint.nv for b in finished),
        gravity=base.E @ gravity,
        graph=graph,
        base=base,
        points=points,
        frames=frames,
        links=link_frames,
        outlines=_outlines(robot, placed, points, bodies),
        loops=tuple(_loop(scene, placed, links, points, element, values) for element in scene.loops),
        couplers=tuple(coupler.name for coupler in scene.couplers),
        forces=tuple(_force(scene, placed, links, points, frames, e, values) for e in scene.forces),
        joint_names=tuple(name for name, _ in joints),
        q_names=tuple(x for name, joint in joints for x in joint.coordinates(name, joint.names)),
        v_names=tuple(x for name, joint in joints for x in joint.coordinates(name, joint.v_names)),
        q_units=tuple(unit for _, joint in joints for unit in joint.units),
        v_units=tuple(unit for _, joint in joints for unit in joint.v_units),
        parameters=tuple(symbolic),
    )
    values.check()
    return model


def _topological(robot: sc.Robot) -> list[int]:
    """Return joint indices, parents first, otherwise in the order of the YAML."""
    owner = {moved_link(robot, k): k for k in range(len(robot.joints))}
    order: list[int] = []
    done = {"base"}
    pending = list(range(len(robot.joints)))
    while pending:
        ready = [k for k in pending if parent_link(robot, k) in done]
        if not ready:
            raise SceneError(f"joint {robot.joints[pending[0]].name!r} does not hang on the base")
        for k in ready:
            order.append(k)
            done.add(moved_link(robot, k))
        pending = [k for k in pending if k not in ready]
    assert len(owner) == len(order)
    return order


def _number(
    robot: sc.Robot, bodies: list[dict[str, Any]], merged: dict[int, RigidInertia], values: _Values
) -> tuple[Body, ...]:
    """Give bodies their places in q and v, which follow the joints' order in the YAML."""
    start: dict[str, tuple[int, int]] = {}
    nq = nv = 0
    for joint in robot.joints:
        kind = joint_types[joint.type]
        start[joint.name] = (nq, nv)
        nq += kind.nq
        nv += kind.nv
    finished = []
    for k, body in enumerate(bodies):
        joint = body["joint"]
        rotor = values.get(f"joints.{joint.name}.rotor_inertia", joint.rotor_inertia)
        finished.append(
            Body(
                name=body["name"],
                joint_name=joint.name,
                joint=joint_kind(joint),
                parent=body["parent"],
                X_tree=body["X_tree"],
                inertia=merged.get(k, RigidInertia.zero()),
                q=start[joint.name][0],
                v=start[joint.name][1],
                armature=joint.gear_ratio**2 * rotor,
                gear_ratio=joint.gear_ratio,
                forces=tuple(JointForce(name, element) for name, element in joint.forces),
            )
        )
    return tuple(finished)


def _fixed_frame(
    placed: dict[str, _Placed], links: dict[str, sc.Link], point: sc.Place, values: _Values
) -> FixedFrame:
    where = placed[point.link]
    frame = where.joint_frame if point.frame == "joint" else where.link_frame
    R: Matrix = frame.E.T
    at: Vector
    if point.at == "origin":
        at = where.joint_frame.r
    elif point.at == "end":
        at = where.link_frame.r
    elif point.at == "com":
        at = _com(where, links[point.link], values)
    else:
        at = frame.point(vector(point.at))
    if isinstance(point, sc.Frame):
        R = R @ rotation_rpy(point.rpy)
    return FixedFrame(where.body, at, R)


def _moving(scene: sc.Scene, graph: Graph, point: sc.Point, frame: FixedFrame) -> FixedFrame:
    """Return a point of the base with its prescribed motion, as a function of t."""
    if point.motion is None:
        return frame
    env = {"t": graph.symbol("t", "t"), **{f"p.{n}": x for n, x in (scene.parameters or {}).items()}}
    moved = vector([x + formula.evaluate(env) for x, formula in zip(frame.p, point.motion)])
    return FixedFrame(frame.body, moved, frame.R)


def _com(where: _Placed, link: sc.Link, values: _Values) -> Vector:
    frame = where.joint_frame if (link.com_frame or "joint") == "joint" else where.link_frame
    com = link.com if link.com is not None else (None, None, None)
    c = vector(
        [values.get(f"links.{link.name}.com.{k}", com[k], f"com[{k}] of {link.name}") for k in range(3)]
    )
    return frame.point(c)


def _place(
    scene: sc.Scene,
    placed: dict[str, _Placed],
    links: dict[str, sc.Link],
    points: dict[str, FixedFrame],
    text: str,
    values: _Values,
) -> FixedFrame:
    """Return the place of a reference such as ``tip`` or ``link2.end``, with the axes of the link's frame."""
    link, _, at = text.partition(".")
    if not at:
        named = scene.robot.points[text]
        # the axes of a loop are given in the link's frame, whatever frame placed the point
        return FixedFrame(points[text].body, points[text].p, placed[named.link].link_frame.E.T)
    if link == "base" and at in points:
        return points[at]
    own = _fixed_frame(placed, links, sc.Point(link=link, at=at), values)
    return FixedFrame(own.body, own.p, placed[link].link_frame.E.T)


def _loop(
    scene: sc.Scene,
    placed: dict[str, _Placed],
    links: dict[str, sc.Link],
    points: dict[str, FixedFrame],
    element: Any,
    values: _Values,
) -> Loop:
    first, second = (_place(scene, placed, links, points, text, values) for text in element.between)
    return Loop(element.name, element, first, second)


def _force(
    scene: sc.Scene,
    placed: dict[str, _Placed],
    links: dict[str, sc.Link],
    points: dict[str, FixedFrame],
    frames: dict[str, FixedFrame],
    element: Any,
    values: _Values,
) -> Force:
    ends = tuple(
        frames[text] if text in frames else _place(scene, placed, links, points, text, values)
        for text in element.references
    )
    return Force(element.name, element, ends)


def _outlines(
    robot: sc.Robot, placed: dict[str, _Placed], points: dict[str, FixedFrame], bodies: list[dict[str, Any]]
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
            spots.append(child.joint_frame.r if merged else bodies[child.body]["X_tree"].r)
        spots.append(where.link_frame.r)
        spots.extend(points[p].p for p, spec in (robot.points or {}).items() if spec.link == name)
        unique: list[Vector] = []
        for p in spots:
            if not any(all(a is b or a == b for a, b in zip(p, other)) for other in unique):
                unique.append(p)
        outlines[name] = tuple(FixedFrame(where.body, p, identity()) for p in unique)
    return outlines

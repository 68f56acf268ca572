"""Parts of a scene as things to draw: links as bodies with what they take in, payloads, joints, closures, springs, the
latch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.model.build import moved_link, parent_link
from robodyn_cli.model.joints import orientation
from robodyn_cli.model.model import BASE, Body, FixedFrame, Force, Loop, Model
from robodyn_cli.model.parts import CarriedMass
from robodyn_cli.report.drawing.places import DrawnExpressions
from robodyn_cli.report.drawing.record import DrawnLatch, DrawnPart, Pin, Stretches
from robodyn_cli.report.style import dashed_style
from robodyn_cli.results.result import Result
from robodyn_cli.scene.mesh.surfaces import CORNERS, surface_of
from robodyn_cli.scene.points import carrier, point_link
from robodyn_cli.scene.types import Robot, Scene
from robodyn_cli.spatial.algebra import Array, vector, zeros

GROUND = "base"
FREE = 6  # velocities of a body that nothing holds
GREY = "#9a9a9a"
OF_PAYLOADS = "#4d4d4d"
DENSITY = 2700.0  # of a cube for a payload whose inertia is not known [kg/m^3]


def colour_of(body: Body) -> str:
    """Return the colour of a link: that of the first coordinate of the joint that moves it."""
    return str(dashed_style(body.q)["color"])


def carriers(robot: Robot) -> dict[str, str]:
    """Return, for each link, the moving link or the ground that carries it: itself, or what fixed joints hold it to."""
    fixed = {
        moved_link(robot, k): parent_link(robot, k)
        for k, joint in enumerate(robot.joints)
        if joint.type == "fixed"
    }
    holders: dict[str, str] = {}
    for link in [GROUND, *(link.name for link in robot.links)]:
        holder = link
        while holder in fixed:
            holder = fixed[holder]
        holders[link] = holder
    return holders


class Links:
    """The links of a scene with the places that each takes in."""

    def __init__(self, scene: Scene, model: Model, expressions: DrawnExpressions) -> None:
        self.scene, self.model, self.expressions = scene, model, expressions
        self.carrier = carriers(scene.robot)
        moving = [b.name for b in model.bodies]
        self.spots: dict[str, list[int]] = {GROUND: [], **{name: [] for name in moving}}
        for name, outline in model.outlines.items():
            for frame in outline:
                self.add(name, frame)
        for body in model.bodies:
            if body.parent == BASE and body.joint.nv < FREE:
                self.add(GROUND, FixedFrame(BASE, body.X_tree.r, body.X_tree.E.T))
        for link in scene.robot.links:
            frame, held = model.links[link.name], self.carrier[link.name] not in (link.name, GROUND)
            if held and link.mass and link.com is not None:
                self.add(link.name, FixedFrame(frame.body, frame.p + frame.R @ vector(link.com), frame.R))
        for loop in model.loops:
            for reference, frame in zip(loop.element.between, (loop.first, loop.second)):
                self.add(point_link(scene.robot, reference), frame)
        for force in model.forces:
            for reference, frame in zip(force.element.references, force.ends):
                self.add(carrier(scene.robot, reference), frame)
        self.all = self._parts()

    def add(self, link: str, frame: FixedFrame) -> None:
        """Let a link take in a place."""
        number = self.expressions.vertex(frame.body, frame.p)
        spots = self.spots.setdefault(self.carrier.get(link, link), [])
        if number is not None and number not in spots:
            spots.append(number)

    def _parts(self) -> tuple[list[DrawnPart], list[int], list[int]]:
        """Return the links and their boxes, the centres of mass, and those that stand for a body without extent."""
        shapes = self._shapes()
        parts = [DrawnPart("ground", GROUND, tuple(self.spots[GROUND]), GREY), *shapes]
        shaped = {part.name for part in shapes}
        masses: list[int] = []
        bobs: list[int] = []
        carried = {body.parent for body in self.model.bodies}
        barred = any(len(self.spots[body.name]) > 1 for body in self.model.bodies)
        for place, body in enumerate(self.model.bodies):
            spots, colour = self.spots[body.name], colour_of(body)
            centres = self._centres(place, body)
            # nothing but its centre of mass says where the body at the end of a chain is
            alone = len(spots) <= 1 and place not in carried
            boxed = body.name not in shaped and (_turns_freely(body) or (alone and not barred))
            boxes = self._boxes(place, body) if boxed else []
            if alone and body.name not in shaped:
                spots += [centre for centre in centres if centre not in spots]
                bobs += [] if boxes else centres or spots
            parts.append(DrawnPart("link", body.name, tuple(spots), colour))
            parts += [DrawnPart("solid", body.name, box, colour) for box in boxes]
            masses += [centre for centre in centres if centre not in spots]
        return parts, masses, bobs

    def _centres(self, place: int, body: Body) -> list[int]:
        """Return the centres of mass of the links that a body is made of, where they are given."""
        vertices = []
        for part in body.parts:
            if numbers([part.m, *part.c]) and part.m > 0.0:
                number = self.expressions.vertex(place, part.frame.point(part.c))
                vertices += [] if number is None else [number]
        return vertices

    def _shapes(self) -> list[DrawnPart]:
        """Return the shapes that the scene gives to links, where these are known."""
        colours = {body.name: colour_of(body) for body in self.model.bodies}
        shapes = []
        for link in self.scene.robot.links:
            frame, name = self.model.links[link.name], self.carrier[link.name]
            colour = colours.get(name, GREY)
            for shape in link.visual:
                made = surface_of(shape)
                if made is None:
                    continue
                corners, surface = made
                if shape.origin is not None:
                    corners = corners @ orientation(shape.origin).T.astype(float) + shape.origin.xyz
                at = [
                    self.expressions.vertex(frame.body, frame.p + frame.R @ vector(p))
                    for p in corners.tolist()
                ]
                known = tuple(number for number in at if number is not None)
                if len(known) == len(CORNERS):
                    shapes.append(DrawnPart("shape", name, known, colour, surface=surface))
        return shapes

    def _boxes(self, place: int, body: Body) -> list[tuple[int, ...]]:
        """Return the corners of cuboids with the masses and inertias of a body's links, where these are given."""
        boxes = []
        for part in body.parts:
            if not numbers([part.m, *part.c, *part.I_com.flat]) or not part.m > 0.0:
                continue
            corners = cuboid(float(part.m), np.array(part.I_com, dtype=float))
            if corners is None:
                continue
            at = [part.frame.point(part.c + vector(corner)) for corner in corners.tolist()]
            vertices = [self.expressions.vertex(place, p) for p in at]
            boxes.append(tuple(number for number in vertices if number is not None))
        return [box for box in boxes if len(box) == len(CORNERS)]


def cuboid(m: float, inertia: Array) -> Array | None:
    """Return the corners (8, 3) of the cuboid with mass m [kg] and inertia (3, 3) about its centre [kg m^2].

    From I_1 = m (b^2 + c^2) / 12 and its like about the principal axes: a^2 = 6 (I_2 + I_3 - I_1) / m. None for a
    point.
    """
    if not np.isfinite(inertia).all():
        return None
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)  # no mirror
    squares = 6.0 * (moments.sum() - 2.0 * moments) / m
    if not squares.max() > 0.0:
        return None
    sides = np.sqrt(np.maximum(squares, 0.0))
    corners: Array = (np.array(CORNERS) * sides) @ axes.T
    return corners


def _turns_freely(body: Body) -> bool:
    return body.joint.v_units.count("rad") == 3


def numbers(entries: Iterable[object]) -> bool:
    """Tell whether entries are numbers, not expressions."""
    return all(isinstance(x, float) for x in entries)


# -- payloads ----------------------------------------------------------------------------------------------
def payload_parts(model: Model, expressions: DrawnExpressions) -> list[DrawnPart]:
    """Return a box for each payload whose mass is known, where it is carried."""
    boxes = []
    for payload in model.payloads:
        corners = _corners(payload)
        if corners is None or payload.part is None or payload.body == BASE:
            continue
        part = payload.part
        centre = part.c if numbers(part.c) else zeros(3)
        at = [
            expressions.own_vertex(payload.body, part.frame.point(centre + vector(corner)))
            for corner in corners.tolist()
        ]
        known = tuple(number for number in at if number is not None)
        if len(known) == len(CORNERS):
            boxes.append(DrawnPart("payload", payload.name, known, OF_PAYLOADS))
    return boxes


def _corners(payload: CarriedMass) -> Array | None:
    """Return the corners (8, 3) of the cuboid with a payload's mass and inertia about its centre, of a cube where the
    inertia is not given or that of a point; None for nothing."""
    part = payload.part
    if part is None or not numbers([part.m]) or not part.m > 0.0:
        return None
    own = cuboid(float(part.m), np.array(part.I_com, dtype=float)) if numbers(part.I_com.flat) else None
    side = (float(part.m) / DENSITY) ** (1.0 / 3.0)
    return side * np.array(CORNERS) if own is None else own


def carried(payload: Any, events: Mapping[str, float], times: Array) -> Array:
    """Return at which times (T,) a payload is carried, by its events: ``grip`` and ``let_go`` [s].

    payload : its keys in the scene. At the time of an event itself it is as before.
    """
    grip = -np.inf if payload.start is None else events.get("grip", np.inf)
    held: Array = (times > grip) & (times <= events.get("let_go", np.inf))
    return held


def put_payloads(result: Result, model: Model, parts: list[DrawnPart], times: Array, vertices: Array) -> None:
    """Put vertices (T, N, 3) of payloads where these fly after their release, and nowhere before they are gripped."""
    places = {part.name: np.array(part.vertices) for part in parts}
    for payload in model.payloads:
        events = {e["kind"]: float(e["time"]) for e in result.events if e.get("name") == payload.name}
        if payload.name not in places:
            continue
        held = carried(payload.spec, events, times)
        absent, last = np.flatnonzero(~held), np.flatnonzero(held)[-1:]
        corners = vertices[last][:, places[payload.name]]
        vertices[np.ix_(absent, places[payload.name])] = np.nan
        path = f"flights/{payload.name}"
        flying = absent[times[absent] > events.get("let_go", np.inf)]
        if len(last) and len(flying) and f"{path}/time" in result:
            since = times[flying] - times[last]
            places_then = flown(result, payload.name, times[flying])
            turned = _turned(corners[0] - corners[0].mean(axis=0), result, payload.name, since)
            vertices[np.ix_(flying, places[payload.name])] = places_then[:, None, :] + turned


def flown(result: Result, name: str, times: Array) -> Array:
    """Return where the centre of mass of a released payload is (T, 3), at its landing from then on."""
    flight = result.group(f"flights/{name}")
    known, places, rates = (flight[key].data for key in ("time", "position", "velocity"))
    k = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 1)
    bend = (rates[-1] - rates[0]) / (known[-1] - known[0])
    since = (np.minimum(times, known[-1]) - known[k])[:, None]
    return np.asarray(places[k] + (rates[k] + 0.5 * bend * since) * since)


def _turned(corners: Array, result: Result, name: str, since: Array) -> Array:
    """Return corners (N, 3) about a centre as they turn on (T, N, 3): with the angular velocity of the release, as
    bodies do about a principal axis."""
    spin = np.array(list(result.summary["payloads"][name]["release"]["angular_velocity"].values()))
    rate = float(np.linalg.norm(spin))
    axis = spin / rate if rate > 0.0 else np.zeros(3)
    sine, cosine = np.sin(rate * since)[:, None, None], np.cos(rate * since)[:, None, None]
    along = np.outer(corners @ axis, axis)
    return np.asarray(along + cosine * (corners - along) + sine * np.cross(axis, corners))


# by how many rotations and translations a joint allows
JOINTS = {
    (1, 0): "hinge", (0, 1): "slide", (1, 1): "sleeve", (2, 0): "cross", (3, 0): "ball", (1, 2): "table",
    (0, 0): "weld",
}  # fmt: skip
CLOSURES = {
    "revolute": "hinge", "prismatic": "slide", "cylindrical": "sleeve", "universal": "cross", "spherical": "ball",
    "planar": "table", "fixed": "weld", "point_on_line": "slide", "point_on_plane": "table",
}  # fmt: skip
SLIDING = ("slide", "sleeve", "table")
Z = (0.0, 0.0, 1.0)
X = (1.0, 0.0, 0.0)


class Connections:
    """What holds the links of a scene together."""

    def __init__(self, scene: Scene, model: Model, links: Links, expressions: DrawnExpressions) -> None:
        self.scene, self.model, self.links, self.expressions = scene, model, links, expressions
        self.parts: list[DrawnPart] = []
        self.pins: list[Pin] = []
        for k, body in enumerate(model.bodies):
            self._joint(k, body)
        for loop in model.loops:
            self._closure(loop)
        for force in model.forces:
            self._force(force)
            self._anchor(force)

    def _joint(self, k: int, body: Body) -> None:
        kind = JOINTS.get((body.joint.v_units.count("rad"), body.joint.v_units.count("m")))
        start = self.expressions.vertex(body.parent, body.X_tree.r)
        end = self.expressions.vertex(k, zeros(3))
        if kind is None or start is None or end is None:
            return
        springs = {force.kind for force in body.forces} & {"spring", "damper"}
        if kind in SLIDING or _advances(body):
            self.parts.append(DrawnPart("rail", body.joint_name, (start, end), GREY))
        if kind == "slide":
            self._beside(body.joint_name, (start, end), sorted(springs))
        directions = (Z, X) if kind == "cross" else (Z,)
        axes = [self.expressions.axis(k, vector(direction)) for direction in directions]
        about = tuple(sorted(springs)) if kind == "hinge" else ()
        self.pins.append(
            Pin(kind, body.joint_name, end, _given(axes), colour_of(body), body.parent == BASE, about)
        )

    def _closure(self, loop: Loop) -> None:
        first = self.expressions.vertex(loop.first.body, loop.first.p)
        second = self.expressions.vertex(loop.second.body, loop.second.p)
        if first is None or second is None:
            return
        kind = CLOSURES.get(loop.element.type)
        if kind is None:
            self.parts.append(DrawnPart("bar", loop.name, (first, second), GREY))
            return
        if kind in SLIDING:
            self.parts.append(DrawnPart("rail", loop.name, (first, second), GREY))
        direction = loop.element.axis or Z
        axes = _given([self.expressions.axis(loop.first.body, loop.first.R @ vector(direction))])
        ground = BASE in (loop.first.body, loop.second.body)
        colour = colour_of(self.model.bodies[max(loop.second.body, 0)])
        self.pins.append(Pin(kind, loop.name, second if kind in SLIDING else first, axes, colour, ground))

    def _force(self, force: Force) -> None:
        """Draw what acts between two places; what acts from outside is an arrow."""
        ends = [self.expressions.vertex(end.body, end.p) for end in force.ends]
        if len(ends) != 2 or None in ends:
            return
        self._beside(force.name, _given(ends), _kinds(force.element))

    def _anchor(self, force: Force) -> None:
        """Draw the ground where a spring, a damper or a rope hangs on a place of it that does not move."""
        if set(_kinds(force.element)) - {"spring", "damper", "rope"}:
            return
        for end in force.ends:
            vertex = self.expressions.vertex(end.body, end.p)
            taken = any(pin.vertex == vertex and pin.grounded for pin in self.pins)
            if end.body == BASE and vertex is not None and not taken and numbers(end.p):
                self.pins.append(Pin("hinge", force.name, vertex, (), GREY, True))

    def _beside(self, name: str, ends: tuple[int, ...], kinds: list[str]) -> None:
        """Add springs and dampers between two places, side by side where there are two."""
        sides = (0,) if len(kinds) == 1 else (-1, 1)
        self.parts += [DrawnPart(kind, name, ends, GREY, side) for kind, side in zip(kinds, sides)]

    def latch(self, between: Sequence[str], closed: Stretches) -> DrawnLatch | None:
        """Return the latch across the joint or closure that its two links share; None without such."""
        first, second = (self.links.carrier.get(name, name) for name in between)
        joint = self._between(first, second)
        if joint is None:
            return None
        ends = [self._away(link, joint) for link in (first, second)]
        return DrawnLatch((ends[0], joint, ends[1]), closed)

    def _between(self, first: str, second: str) -> int | None:
        """Return the vertex of the joint or closure between two links."""
        robot = self.scene.robot
        for k, joint in enumerate(robot.joints):
            if {moved_link(robot, k), self.links.carrier.get(parent_link(robot, k), GROUND)} == {
                first,
                second,
            }:
                return next((pin.vertex for pin in self.pins if pin.name == joint.name), None)
        for loop in self.scene.loops:
            if {point_link(robot, reference) for reference in loop.between} == {first, second}:
                return next((pin.vertex for pin in self.pins if pin.name == loop.name), None)
        return None

    def _away(self, link: str, joint: int) -> int:
        """Return a vertex of a link other than that of the joint: its own joint's, or the last one."""
        spots = [spot for spot in self.links.spots.get(link, ()) if spot != joint]
        return spots[0] if spots else joint


def _kinds(element: Any) -> list[str]:
    """Return how a force between two places looks."""
    if element.type in ("spring", "torsional_spring"):
        stiff, damped = element.stiffness > 0.0, element.damping > 0.0
        spring, damper = ("spring", "damper") if element.type == "spring" else ("coil", "rotary_damper")
        return [spring] * stiff + [damper] * damped
    return {"constant_force": ["rope"], "bushing": ["bushing"]}.get(element.type, ["bar"])


def _advances(body: Body) -> bool:
    """Tell whether a joint that only turns takes its body along too, as a screw does."""
    S = body.joint.S(vector(body.joint.neutral()))
    return any(is_nonzero(x) for x in S[3:].flat)


def _given(numbers: Sequence[int | None]) -> tuple[int, ...]:
    return tuple(number for number in numbers if number is not None)

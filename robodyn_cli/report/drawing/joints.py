"""Joints, closures, springs and the latch of a scene as things to draw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.model.build import moved_link, parent_link
from robodyn_cli.model.model import BASE, Body, Force, Loop, Model
from robodyn_cli.report.drawing.bodies import GREY, GROUND, Links, colour_of, numbers
from robodyn_cli.report.drawing.places import DrawnExpressions
from robodyn_cli.report.drawing.record import DrawnLatch, DrawnPart, Pin
from robodyn_cli.scene.points import point_link
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import vector, zeros

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
        self.scene, self.links, self.expressions = scene, links, expressions
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
        wound = bool(springs) and kind == "hinge"
        self.pins.append(
            Pin(kind, body.joint_name, end, _given(axes), colour_of(k), body.parent == BASE, wound)
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
        colour = colour_of(max(loop.second.body, 0))
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

    def latch(self, closes: float) -> DrawnLatch | None:
        """Return the latch across the joint or closure that its two links share; None without such."""
        if self.scene.deploy.latch is None:
            return None
        first, second = (self.links.carrier.get(name, name) for name in self.scene.deploy.latch.between)
        joint = self._between(first, second)
        if joint is None:
            return None
        ends = [self._away(link, joint) for link in (first, second)]
        return DrawnLatch((ends[0], joint, ends[1]), closes)

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
    if element.type == "spring":
        stiff, damped = element.stiffness > 0.0, element.damping > 0.0
        return ["spring"] * stiff + ["damper"] * damped
    return {"constant_force": ["rope"], "bushing": ["bushing"], "torsional_spring": ["coil"]}.get(
        element.type, ["bar"]
    )


def _advances(body: Body) -> bool:
    """Tell whether a joint that only turns takes its body along too, as a screw does."""
    S = body.joint.S(vector(body.joint.neutral()))
    return any(is_nonzero(x) for x in S[3:].flat)


def _given(numbers: Sequence[int | None]) -> tuple[int, ...]:
    return tuple(number for number in numbers if number is not None)

"""What a painter paints: strokes in the plane, in their order.

What there is to draw of a mechanism, in numbers: the one description of all pictures.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.scene.mesh.surfaces import Surface
from robodyn_cli.spatial.algebra import Array

INK = "#2f2f2f"
PAPER = "#ffffff"
FAINT = "#dcdcdc"
GRID = "#e6e6e6"


class Stroke(NamedTuple):
    """A line or an area: points (N, 2), rows that are no numbers between its pieces; widths in printer's points.

    layer, depth : strokes of higher layers, and within one those nearer to the eye, are painted later.
    """

    points: Array
    colour: str = INK
    width: float = 1.0
    fill: str | None = None
    closed: bool = False
    layer: int = 0
    depth: float = 0.0
    dashed: bool = False


def mixed(colour: str, other: str, part: float) -> str:
    """Return a colour with a part of another one in it: ``part`` 0 is the first, 1 the other."""
    a, b = ([int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in (colour, other))
    return "#" + "".join(f"{round(x + part * (y - x)):02x}" for x, y in zip(a, b))


def body(points: Array, colour: str, width: float, layer: int, depth: float) -> list[Stroke]:
    """Return a body with the corners (N, 2) of its hull: a bar with round ends, or a plate with round corners."""
    dark, light = mixed(colour, INK, 0.35), mixed(colour, PAPER, 0.62)
    rim = min(1.0, 0.25 * width)
    closed = len(points) > 2
    return [
        Stroke(points, dark, width, dark if closed else None, closed, layer, depth),
        Stroke(points, light, width - 2.0 * rim, light if closed else None, closed, layer, depth),
    ]


@record
class DrawnPart:
    """Something with an outline: vertices by their numbers.

    kind : ``link`` (filled between all its vertices), ``ground`` (the link that stands still), ``solid`` (a box of the
    body's inertia), ``payload`` (a box that is carried, whose places are not finite while it is not), ``shape`` (a link
    as the scene says that it looks: ``surface`` in the box of its vertices), ``bar``, ``rope``, ``rail`` (what a slider
    slides on), ``spring``, ``damper``, ``coil``, ``rotary_damper``, ``bushing``.
    aside : 1 or -1 for two that lie side by side between the same places.
    """

    kind: str
    name: str
    vertices: tuple[int, ...]
    colour: str
    aside: int = 0
    surface: Surface | None = None


@record
class Pin:
    """A joint or a closure at a vertex, with its axes by their numbers.

    kind : ``hinge``, ``slide``, ``sleeve`` (turns and slides), ``cross``, ``ball``, ``table`` (slides in a plane),
    ``weld``. colour : of what slides. grounded : whether it hangs on the ground. about : what acts about its axis,
    ``spring`` and ``damper``. room : how near the nearest other one comes [m], for their symbols.
    """

    kind: str
    name: str
    vertex: int
    axes: tuple[int, ...]
    colour: str
    grounded: bool = False
    about: tuple[str, ...] = ()
    room: float = 0.0


@record
class Arrow:
    """A force at a vertex, (T, 3) in the world [N]."""

    name: str
    vertex: int
    force: Array
    reaction: bool


@record
class Trail:
    """The path of a named point, or of a payload in its ``flight``: times (K,) [s] and places (K, 3) [m]."""

    name: str
    times: Array
    points: Array
    colour: str
    flight: bool = False


Stretches = tuple[tuple[float, float], ...]


@record
class DrawnLatch:
    """A latch across a joint: vertices on its first link, of the joint, on its second link.

    closed : from when to when it is [s], inf: to the end.
    """

    vertices: tuple[int, int, int]
    closed: Stretches

    def is_closed(self, time: float) -> bool:
        """Tell whether it is closed at a time [s]."""
        return any(start * (1.0 - 1e-12) <= time < end for start, end in self.closed)


@record
class Drawing:
    """A mechanism at T instants.

    times : (T,) [s]. vertices : (T, N, 3) in the world [m]. axes : (T, M, 3), unit vectors of joints' axes. masses :
    vertices that are centres of mass. bobs : those that stand for a body without extent. gravity : (3,) [m/s^2].
    flat : index of the world's axis along which nothing moves and little extends; None in space. normal : (3,), that
    direction of a mechanism that is planar across none of the world's axes.
    """

    times: Array
    vertices: Array
    axes: Array
    parts: tuple[DrawnPart, ...]
    pins: tuple[Pin, ...]
    masses: tuple[int, ...]
    bobs: tuple[int, ...]
    arrows: tuple[Arrow, ...]
    trails: tuple[Trail, ...]
    latches: tuple[DrawnLatch, ...]
    gravity: Array
    flat: int | None = None
    normal: Array | None = None

    @property
    def links(self) -> tuple[DrawnPart, ...]:
        """The moving links, in the order of the scene."""
        return tuple(part for part in self.parts if part.kind == "link")

    @cached_property
    def shaped(self) -> frozenset[str]:
        """Names of the links that are drawn by shapes of their own."""
        return frozenset(part.name for part in self.parts if part.kind == "shape")

    @property
    def carried(self) -> set[int]:
        """Vertices of payloads."""
        return {vertex for part in self.parts if part.kind == "payload" for vertex in part.vertices}

    @cached_property
    def everything(self) -> Array:
        """All places that the drawing takes in (..., 3), those of trails included; not finite ones left out."""
        clouds = [self.vertices.reshape(-1, 3), *(trail.points for trail in self.trails)]
        points = np.concatenate(clouds)
        return points[np.isfinite(points).all(axis=1)]

    @cached_property
    def size(self) -> float:
        """Largest extent [m]; 1 where nothing has any."""
        points = self.everything
        extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
        return extent if 0.0 < extent < math.inf else 1.0

    @cached_property
    def strongest(self) -> float:
        """Largest force of all arrows [N]; 0 without any."""
        sizes = [np.linalg.norm(np.nan_to_num(arrow.force), axis=1).max(initial=0.0) for arrow in self.arrows]
        return float(max(sizes, default=0.0))

    @cached_property
    def up(self) -> Array:
        """Direction against gravity (3,); z without gravity."""
        g = float(np.linalg.norm(self.gravity))
        return -self.gravity / g if g > 0.0 else np.array([0.0, 0.0, 1.0])

    def at(self, chosen: list[int]) -> Drawing:
        """Return the drawing at some of its instants."""
        arrows = tuple(dataclasses.replace(arrow, force=arrow.force[chosen]) for arrow in self.arrows)
        return dataclasses.replace(
            self,
            times=self.times[chosen],
            vertices=self.vertices[chosen],
            axes=self.axes[chosen],
            arrows=arrows,
        )

"""Plates with a given outline.

Surfaces of the shapes that links are drawn with.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.scene.mesh.files import read_obj
from robodyn_cli.scene.robot_parts import Shape
from robodyn_cli.spatial.algebra import Array

Corners = Sequence[Sequence[float]]
FLAT = 1e-9  # of the square of its extent: an area that is none


def outline_problem(corners: Corners) -> str:
    """Return why corners (N, 2) are no outline of a plate, "" where they are."""
    p = np.array(corners, dtype=float)
    if abs(_area(p)) <= FLAT * float(np.ptp(p, axis=0).max()) ** 2:
        return "encloses no area; allowed: three corners or more that do not lie on one line"
    sides = [(p[k], p[(k + 1) % len(p)]) for k in range(len(p))]
    for i, j in itertools.combinations(range(len(p)), 2):
        neighbours = j - i in (1, len(p) - 1)
        if not neighbours and _cross(*sides[i], *sides[j]):
            return f"sides {i} and {j} cross; allowed: corners one after another around the plate"
    return ""


def plate(corners: Corners, thickness: float) -> tuple[Array, tuple[tuple[int, ...], ...], bool]:
    """Return points (M, 3) [m] and faces of a plate about the x-y plane, the upper one first; whether it is closed."""
    p = np.array(corners, dtype=float)
    if _area(p) < 0.0:
        p = p[::-1]
    # a face's plane is told by its first three corners, which must turn as the outline does
    turns = np.array([_turn(p[k - 1], p[k], p[(k + 1) % len(p)]) for k in range(len(p))])
    p = np.roll(p, 1 - int(np.argmax(turns)), axis=0)
    n = len(p)
    top = np.column_stack([p, np.full(n, 0.5 * thickness)])
    upper = tuple(range(n))
    if not thickness:
        return top, (upper,), False
    bottom = np.column_stack([p, np.full(n, -0.5 * thickness)])
    lower = (n + 2, n + 1, n, *range(2 * n - 1, n + 2, -1))
    sides = [(k, n + k, n + (k + 1) % n, (k + 1) % n) for k in range(n)]
    return np.concatenate([top, bottom]), (upper, lower, *sides), True


def _area(p: Array) -> float:
    x, y = p.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _turn(a: Array, b: Array, c: Array) -> float:
    """Return twice the area of the triangle a b c, positive where it turns to the left."""
    (x, y), (u, v) = b - a, c - b
    return float(x * v - y * u)


def _cross(a: Array, b: Array, c: Array, d: Array) -> bool:
    """Tell whether the segments a b and c d have a point in common."""
    first, second = _turn(a, b, c) * _turn(a, b, d), _turn(c, d, a) * _turn(c, d, b)
    return first <= 0.0 and second <= 0.0 and (first < 0.0 or second < 0.0)


Faces = tuple[tuple[int, ...], ...]


@record
class Surface:
    """The surface of a rigid body, in units of the box around it.

    points : (N, 3), 0 to 1 along the box's edges. faces : corners by their numbers, counterclockwise from outside.
    closed : whether the faces enclose a volume, so that those turned away are hidden. outline : corners of what flat
    views show; () for the convex outline.
    """

    points: Array
    faces: tuple[tuple[int, ...], ...]
    closed: bool = True
    outline: tuple[int, ...] = ()

    @cached_property
    def first(self) -> Array:
        """The first three corners (F, 3) of each face, which give its plane."""
        return np.array([face[:3] for face in self.faces])

    def places(self, corners: Array) -> Array:
        """Return the points (N, 3) in the world [m], from the corners (8, 3) of the box, z counting fastest."""
        origin = corners[0]
        placed: Array = origin + self.points @ (corners[[4, 2, 1]] - origin)
        return placed


CORNERS = tuple(itertools.product((-0.5, 0.5), repeat=3))
FACES: Faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
CUBE = Surface(np.array(CORNERS) + 0.5, FACES)
SIDES = 20  # of a cylinder, and of a sphere around its axis
RINGS = 11  # of a sphere from pole to pole
POLE = 0.12  # angle of the flat end around a pole [rad]


def surface_of(shape: Shape) -> tuple[Array, Surface] | None:
    """Return the corners (8, 3) of the box around a shape, in its frame [m], and the surface in it; None if empty."""
    outline: tuple[int, ...] = ()
    if shape.outline is not None:
        points, faces, closed = plate(shape.outline, shape.thickness)
        outline = faces[0]
    else:
        points, faces, closed = _mesh(shape) if shape.obj is not None else (*_body(shape), True)
    if not faces:
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.where(high > low, high - low, 1.0)
    box = low + (np.array(CORNERS) + 0.5) * (high - low)
    return box, Surface((points - low) / size, faces, closed, outline)


def _body(shape: Shape) -> tuple[Array, Faces]:
    """Return points (N, 3) [m] and faces of a cuboid, a sphere or a cylinder."""
    if shape.box is not None:
        return np.array(CORNERS) * shape.box, FACES
    if shape.sphere is not None:
        angles = np.linspace(POLE, math.pi - POLE, RINGS)
        return _turned(shape.sphere * np.sin(angles), -shape.sphere * np.cos(angles))
    if shape.cylinder is not None:
        radius, length = shape.cylinder
        return _turned(np.array([radius, radius]), 0.5 * np.array([-length, length]))
    return np.empty((0, 3)), ()


def _turned(radii: Array, heights: Array) -> tuple[Array, Faces]:
    """Return the solid between rings of radii and heights (K,) from the lowest upwards, with flat ends."""
    angles = 2.0 * math.pi * np.arange(SIDES) / SIDES
    rings = [
        np.stack([r * np.cos(angles), r * np.sin(angles), np.full(SIDES, z)], axis=1)
        for r, z in zip(radii, heights)
    ]
    sides = [
        (a, b, b + SIDES, a + SIDES)
        for ring in range(len(rings) - 1)
        for k in range(SIDES)
        for a, b in [(ring * SIDES + k, ring * SIDES + (k + 1) % SIDES)]
    ]
    ends = (tuple(reversed(range(SIDES))), tuple(range((len(rings) - 1) * SIDES, len(rings) * SIDES)))
    return np.concatenate(rings), (*sides, *ends)


def _mesh(shape: Shape) -> tuple[Array, Faces, bool]:
    """Return points (N, 3) [m] and faces of a mesh, turned outwards where it is closed, and whether it is."""
    mesh = read_obj(shape.obj or "")
    points, faces = mesh.points * shape.scale, mesh.faces
    closed = _is_closed(faces)
    a, b, c = points[faces].transpose(1, 0, 2)
    if closed and float(np.sum(a * np.cross(b, c))) < 0.0:  # six times the volume
        faces = faces[:, ::-1]
    return points, tuple(map(tuple, faces.tolist())), closed


def _is_closed(faces: Array) -> bool:
    """Tell whether every edge is passed as often in one direction as in the other."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, edge = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    return not np.bincount(edge.reshape(-1), np.sign(ends[:, 1] - ends[:, 0])).any()

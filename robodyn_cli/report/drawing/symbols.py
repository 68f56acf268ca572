"""Outlines of joints, springs, dampers, arrows and the ground, in the plane of the drawing.

Lengths are in its units [m]; ``pt`` is the length that a printer's point has there. NaN rows separate strokes.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.spatial.algebra import Array

GAP = np.full((1, 2), np.nan)
TURN = np.linspace(0.0, 2.0 * np.pi, 25)
CIRCLE = np.column_stack([np.cos(TURN), np.sin(TURN)])[:-1]


def area(corners: Array) -> float:
    """Return the area of a polygon (N, 2)."""
    x, y = corners.T
    return abs(0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def hull(points: Array) -> Array:
    """Return the corners of the convex hull of points (N, 2), anticlockwise (Andrew's monotone chain, 1979)."""
    rows = sorted({(float(x), float(y)) for x, y in points})
    if len(rows) <= 2:
        return np.array(rows)
    chains = []
    for order in (rows, rows[::-1]):
        chain: list[tuple[float, float]] = []
        for p in order:
            while len(chain) >= 2 and _turn(chain[-2], chain[-1], p) <= 0.0:
                chain.pop()
            chain.append(p)
        chains.append(chain[:-1])
    return np.array(chains[0] + chains[1])


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def circle(centre: Array, radius: float) -> Array:
    """Return a circle."""
    return np.asarray(centre + radius * CIRCLE)


def block(centre: Array, along: Array, length: float, width: float) -> Array:
    """Return a rectangle with its length along a unit vector."""
    across = np.array([-along[1], along[0]])
    a, b = 0.5 * length * along, 0.5 * width * across
    return np.array([centre - a - b, centre + a - b, centre + a + b, centre - a + b])


def direction(d: Array) -> Array | None:
    """Return a vector (2,) at unit length, None where it has none."""
    length = float(np.hypot(*d))
    return d / length if length > 1e-12 else None


def zigzag(a: Array, b: Array, width: float, turns: int = 7) -> Array:
    """Return a spring from a to b: straight ends and ``turns`` teeth, as wide as ``width``, however long it is."""
    along = direction(b - a)
    if along is None:
        return np.array([a, b])
    across = np.array([-along[1], along[0]])
    length = float(np.hypot(*(b - a)))
    u = np.concatenate([[0.0, 0.12], 0.12 + 0.76 * (np.arange(2 * turns) + 0.5) / (2 * turns), [0.88, 1.0]])
    side = np.concatenate([[0.0, 0.0], 0.5 * width * (-1.0) ** np.arange(2 * turns), [0.0, 0.0]])
    return np.asarray(a + np.outer(u * length, along) + np.outer(side, across))


def dashpot(a: Array, b: Array, width: float) -> Array:
    """Return a damper from a to b: a cup, a piston and their rods."""
    along = direction(b - a)
    if along is None:
        return np.array([a, b])
    across = 0.5 * width * np.array([-along[1], along[0]])
    d = b - a
    cup, end, piston = a + 0.35 * d, a + 0.65 * d, a + 0.5 * d
    strokes = [
        np.array([a, cup]), np.array([end + across, cup + across, cup - across, end - across]),
        np.array([piston + 0.7 * across, piston - 0.7 * across]), np.array([piston, b]),
    ]  # fmt: skip
    return joined(strokes)


def coil(centre: Array, radius: float) -> Array:
    """Return a spiral of two and a half turns: a spring that acts about an axis."""
    angle = np.linspace(0.0, 5.0 * np.pi, 60)
    r = radius * (0.35 + 0.65 * angle / angle[-1])
    return np.asarray(centre + np.column_stack([r * np.cos(angle), r * np.sin(angle)]))


def arrow(tail: Array, vector: Array, head: float) -> tuple[Array, Array]:
    """Return shaft and head of an arrow; the head is at most half as long as the arrow."""
    along = direction(vector)
    if along is None:
        return np.array([tail, tail]), np.array([tail, tail, tail])
    length = float(np.hypot(*vector))
    head = min(head, 0.5 * length)
    across = np.array([-along[1], along[0]])
    tip, neck = tail + vector, tail + vector - head * along
    return np.array([tail, neck]), np.array([tip, neck + 0.4 * head * across, neck - 0.4 * head * across])


def support(at: Array, down: Array, size: float) -> tuple[Array, Array]:
    """Return the triangle and the hatched line of a joint on the ground; ``down`` is a unit vector."""
    across = np.array([-down[1], down[0]])
    left, right = at + size * down - 0.62 * size * across, at + size * down + 0.62 * size * across
    return np.array([at, left, right]), hatching(
        left - 0.3 * size * across, right + 0.3 * size * across, down, size
    )


def hatching(a: Array, b: Array, down: Array, size: float, most: int = 60) -> Array:
    """Return a line with strokes on one side: the ground."""
    along = direction(b - a)
    if along is None:
        return np.array([a, b])
    count = int(np.clip(np.hypot(*(b - a)) / (0.34 * size), 1, most))
    slant = 0.32 * size * (down - along) / np.sqrt(2.0)
    feet = [a + (k + 0.7) / count * (b - a) for k in range(count)]
    return joined([np.array([a, b]), *(np.array([foot, foot + slant]) for foot in feet)])


def quartered(centre: Array, radius: float) -> Array:
    """Return the dark quarters of the mark of a centre of mass."""
    angle = np.linspace(0.0, 0.5 * np.pi, 7)
    arc = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    upper = np.concatenate([np.zeros((1, 2)), arc, np.zeros((1, 2))])
    return np.asarray(centre + joined([upper, -upper]))


def ring(at: Array, axis: Array, radius: float, half: float) -> Array:
    """Return the rims of a cylinder in space, (48, 3): centre ``at``, unit vector along it, half its length."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    rim = radius * (CIRCLE[:, :1] * u + CIRCLE[:, 1:] * np.cross(axis, u))
    return np.concatenate([at + half * axis + rim, at - half * axis + rim])


def joined(strokes: list[Array]) -> Array:
    """Return strokes as one array, with rows that are no numbers between them."""
    rows = [row for stroke in strokes for row in (stroke, GAP)]
    return np.concatenate(rows[:-1]) if rows else np.zeros((0, 2))

"""Outlines of joints, springs, dampers, arrows and the ground, in the plane of the drawing, and joints as strokes by
their kind: what turns is round, what slides is a block on its line.

Lengths are in its units [m]; ``pt`` is the length that a printer's point has there. NaN rows separate strokes.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.report.drawing.camera import View
from robodyn_cli.report.drawing.record import INK, PAPER, Pin, Stroke, mixed
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


def rotary_dashpot(centre: Array, radius: float) -> Array:
    """Return a damper that acts about an axis: a cup and a piston, bent about it."""

    def arc(part: float, *angles: float) -> Array:
        angle = np.radians(np.linspace(angles[0], angles[-1], 9))
        return np.asarray(centre + part * radius * np.column_stack([np.cos(angle), np.sin(angle)]))

    cup = np.concatenate([arc(1.0, 68.0, 110.0), arc(0.6, 110.0, 68.0)])
    rods = np.concatenate([[centre], arc(0.8, 175.0, 110.0)]), np.concatenate([arc(0.8, 88.0, 5.0), [centre]])
    piston = np.concatenate([arc(0.94, 88.0)[:1], arc(0.66, 88.0)[:1]])
    return joined([rods[0], cup, piston, rods[1]])


def about(kind: str, centre: Array, radius: float, beside: bool) -> Array:
    """Return a spring or a damper that acts about an axis; the spring inside, the damper around it where both do."""
    if kind == "spring":
        return coil(centre, (0.62 if beside else 1.0) * radius)
    return rotary_dashpot(centre, (1.25 if beside else 1.0) * radius)


LARGE, LEAST = (
    3.2,
    2.5,
)  # symbols about an axis, and the smallest ones that are drawn, over the radius of a joint
LEAST_REACH = 4.2  # of such a symbol [pt]
PART = 0.3  # of the distance to the nearest other joint, which a symbol may take


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


GREY = "#8a8a8a"
SUPPORT = 11.0  # height of the triangle below a joint on the ground [pt]


SLIDING = ("slide", "sleeve", "table")


def blocks(view: View, k: int, without: set[int]) -> list[Array]:
    """Return the outlines (4, 2) of what slides at an instant, but for those at some vertices."""
    pins = [pin for pin in view.drawing.pins if pin.kind in SLIDING and pin.vertex not in without]
    places = [(pin, view.corners[k, pin.vertex, :2]) for pin in pins]
    radius = view.radius * view.pt
    return [_mark(view, k, pin, at, radius)[0].points for pin, at in places if np.isfinite(at).all()]


def pin_strokes(view: View, k: int, layer: int) -> list[Stroke]:
    """Return the strokes of all joints and closures at an instant, with lines as fine as the marks are small."""
    radius = view.radius * view.pt
    drawn: list[Stroke] = []
    for pin in view.drawing.pins:
        at = view.corners[k, pin.vertex]
        if not np.isfinite(at).all():
            continue
        depth = float(at[2]) + view.nearer
        if pin.grounded and view.flat:
            drawn += _on_ground(view, pin, at[:2], radius)
        reach = min(LARGE * radius, PART * pin.room)
        for kind in pin.about if reach >= max(LEAST * radius, LEAST_REACH * view.pt) else ():
            points = about(kind, at[:2], reach, beside=len(pin.about) > 1)
            drawn.append(Stroke(points, INK, 1.0, layer=layer, depth=depth))
        drawn += [
            stroke._replace(layer=layer, depth=depth, width=stroke.width * view.finer)
            for stroke in _mark(view, k, pin, at[:2], radius)
        ]
    return drawn


def _mark(view: View, k: int, pin: Pin, at: Array, r: float) -> list[Stroke]:
    """Return the mark of a joint of radius ``r``."""
    if pin.kind == "weld":
        return [Stroke(block(at, np.array([1.0, 0.0]), 2.0 * r, 2.0 * r), INK, 0.8, INK, True)]
    if pin.kind == "table":
        return [Stroke(block(at, np.array([1.0, 0.0]), 4.0 * r, 4.0 * r), INK, 1.0, PAPER, True)]
    if pin.kind in ("slide", "sleeve"):
        along = _seen(view, k, pin, 0)
        ahead, length = (np.array([1.0, 0.0]), 3.0 * r) if along is None else (along, 4.8 * r)
        marks = [Stroke(block(at, ahead, length, 3.0 * r), INK, 1.0, mixed(pin.colour, PAPER, 0.6), True)]
        return marks + ([Stroke(circle(at, 0.7 * r), INK, 0.8, PAPER, True)] if pin.kind == "sleeve" else [])
    if pin.kind == "hinge" and not view.flat and pin.axes:
        return _cylinder(view, k, pin, r)
    fill = "#cfcfcf" if pin.kind == "ball" else PAPER
    marks = [Stroke(circle(at, r * (1.15 if pin.kind == "ball" else 1.0)), INK, 1.1, fill, True)]
    if pin.kind == "cross":
        for axis in range(len(pin.axes)):
            along = _seen(view, k, pin, axis)
            if along is not None:
                marks.append(Stroke(np.array([at - 1.5 * r * along, at + 1.5 * r * along]), INK, 1.2))
    return marks


def _cylinder(view: View, k: int, pin: Pin, r: float) -> list[Stroke]:
    """Return a short cylinder along the axis of a hinge, with the rim that looks to the eye."""
    place, axis = view.drawing.vertices[k, pin.vertex], view.drawing.axes[k, pin.axes[0]]
    if not np.isfinite(axis).all():
        return []
    rims = view.project(ring(place, axis, 1.15 * r, 1.9 * r), k)
    half = len(rims) // 2
    near = rims[:half] if rims[:half, 2].mean() > rims[half:, 2].mean() else rims[half:]
    return [
        Stroke(hull(rims[:, :2]), INK, 1.0, "#d5d5d5", True),
        Stroke(near[:, :2], INK, 0.7, PAPER, True),
    ]


def _seen(view: View, k: int, pin: Pin, number: int) -> Array | None:
    """Return the direction of an axis in the drawing; None where it points to the eye."""
    if number >= len(pin.axes):
        return None
    place, axis = view.drawing.vertices[k, pin.vertex], view.drawing.axes[k, pin.axes[number]]
    reach = 1e-3 * view.drawing.size
    a, b = view.project(np.stack([place, place + reach * axis]), k)[:, :2]
    return direction(b - a) if np.hypot(*(b - a)) > 0.2 * reach else None


def _on_ground(view: View, pin: Pin, at: Array, r: float) -> list[Stroke]:
    """Return what a joint on the ground stands on: a triangle, or below a slide the line that it slides along."""
    size = SUPPORT * view.pt * min(1.0, r / (3.0 * view.pt))
    if pin.kind in ("slide", "sleeve"):
        along = _seen(view, 0, pin, 0)
        if along is None:
            return []
        down = np.array([along[1], -along[0]])
        down = down if down[1] <= 1e-9 else -down
        reach = view.corners[:, pin.vertex, :2] @ along
        reach = reach[np.isfinite(reach)] - at @ along
        a, b = (
            at + (s + e) * along + 1.6 * r * down
            for s, e in ((reach.min(), -4.0 * r), (reach.max(), 4.0 * r))
        )
        return [Stroke(hatching(a, b, down, size), GREY, 0.9 * view.finer, layer=2)]
    if pin.kind not in ("hinge", "ball", "cross"):
        return []
    triangle, line = support(at, _down(view), size)
    return [
        Stroke(triangle, INK, view.finer, "#e2e2e2", True, 2),
        Stroke(line, GREY, 0.9 * view.finer, layer=2),
    ]


def _down(view: View) -> Array:
    """Return the direction of gravity in the drawing; downwards where it has none there."""
    g = np.array([view.drawing.gravity @ view.camera.right, view.drawing.gravity @ view.camera.up])
    strong = np.hypot(*g) > 0.5 * float(np.linalg.norm(view.drawing.gravity))
    down = direction(g) if strong else None
    return np.array([0.0, -1.0]) if down is None else down

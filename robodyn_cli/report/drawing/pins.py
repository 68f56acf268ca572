"""Joints as strokes, by their kind: what turns is round, what slides is a block on its line."""

from __future__ import annotations

import numpy as np

from robodyn_cli.report.drawing import symbols
from robodyn_cli.report.drawing.camera import View
from robodyn_cli.report.drawing.record import INK, PAPER, Pin, Stroke, mixed
from robodyn_cli.spatial.algebra import Array

GREY = "#8a8a8a"
SUPPORT = 11.0  # height of the triangle below a joint on the ground [pt]


def pin_strokes(view: View, k: int, width: float, layer: int) -> list[Stroke]:
    """Return the strokes of all joints and closures at an instant; ``width`` of the links [pt]."""
    radius = float(np.clip(0.36 * width + 0.9, 1.7, 4.0)) * view.pt
    found: list[Stroke] = []
    for pin in view.drawing.pins:
        at = view.corners[k, pin.vertex]
        if not np.isfinite(at).all():
            continue
        depth = float(at[2]) + view.nearer
        if pin.grounded and view.flat:
            found += _on_ground(view, pin, at[:2], radius)
        if pin.wound:
            found.append(Stroke(symbols.coil(at[:2], 3.2 * radius), INK, 1.0, layer=layer, depth=depth))
        found += [stroke._replace(layer=layer, depth=depth) for stroke in _mark(view, k, pin, at[:2], radius)]
    return found


def _mark(view: View, k: int, pin: Pin, at: Array, r: float) -> list[Stroke]:
    """Return the mark of a joint of radius ``r``."""
    if pin.kind == "weld":
        return [Stroke(symbols.block(at, np.array([1.0, 0.0]), 2.0 * r, 2.0 * r), INK, 0.8, INK, True)]
    if pin.kind == "table":
        return [Stroke(symbols.block(at, np.array([1.0, 0.0]), 4.0 * r, 4.0 * r), INK, 1.0, PAPER, True)]
    if pin.kind in ("slide", "sleeve"):
        along = _seen(view, k, pin, 0)
        ahead, length = (np.array([1.0, 0.0]), 3.0 * r) if along is None else (along, 4.8 * r)
        marks = [
            Stroke(symbols.block(at, ahead, length, 3.0 * r), INK, 1.0, mixed(pin.colour, PAPER, 0.6), True)
        ]
        return marks + (
            [Stroke(symbols.circle(at, 0.7 * r), INK, 0.8, PAPER, True)] if pin.kind == "sleeve" else []
        )
    if pin.kind == "hinge" and not view.flat and pin.axes:
        return _cylinder(view, k, pin, r)
    fill = "#cfcfcf" if pin.kind == "ball" else PAPER
    marks = [Stroke(symbols.circle(at, r * (1.15 if pin.kind == "ball" else 1.0)), INK, 1.1, fill, True)]
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
    rims = view.project(symbols.ring(place, axis, 1.15 * r, 1.9 * r), k)
    half = len(rims) // 2
    near = rims[:half] if rims[:half, 2].mean() > rims[half:, 2].mean() else rims[half:]
    return [
        Stroke(symbols.hull(rims[:, :2]), INK, 1.0, "#d5d5d5", True),
        Stroke(near[:, :2], INK, 0.7, PAPER, True),
    ]


def _seen(view: View, k: int, pin: Pin, number: int) -> Array | None:
    """Return the direction of an axis in the drawing; None where it points to the eye."""
    if number >= len(pin.axes):
        return None
    place, axis = view.drawing.vertices[k, pin.vertex], view.drawing.axes[k, pin.axes[number]]
    reach = 1e-3 * view.drawing.size
    a, b = view.project(np.stack([place, place + reach * axis]), k)[:, :2]
    return symbols.direction(b - a) if np.hypot(*(b - a)) > 0.2 * reach else None


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
        return [Stroke(symbols.hatching(a, b, down, size), GREY, 0.9, layer=2)]
    if pin.kind not in ("hinge", "ball", "cross"):
        return []
    triangle, line = symbols.support(at, _down(view), size)
    return [Stroke(triangle, INK, 1.0, "#e2e2e2", True, 2), Stroke(line, GREY, 0.9, layer=2)]


def _down(view: View) -> Array:
    """Return the direction of gravity in the drawing; downwards where it has none there."""
    g = np.array([view.drawing.gravity @ view.camera.right, view.drawing.gravity @ view.camera.up])
    strong = np.hypot(*g) > 0.5 * float(np.linalg.norm(view.drawing.gravity))
    found = symbols.direction(g) if strong else None
    return np.array([0.0, -1.0]) if found is None else found

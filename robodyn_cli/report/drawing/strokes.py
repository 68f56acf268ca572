"""The strokes of a drawing at an instant: ground, paths, bodies, joints, loads, each on its layer."""

from __future__ import annotations

import functools
import math

import numpy as np

from robodyn_cli.report.curves import alone
from robodyn_cli.report.drawing import symbols
from robodyn_cli.report.drawing.camera import View
from robodyn_cli.report.drawing.record import FAINT, INK, PAPER, DrawnLatch, DrawnPart, Stroke, body, mixed
from robodyn_cli.report.drawing.record import GRID as LINES
from robodyn_cli.report.drawing.symbols import pin_strokes
from robodyn_cli.report.style import ALARM
from robodyn_cli.scene.mesh.surfaces import CUBE
from robodyn_cli.spatial.algebra import Array

GRID, SHADOW, GROUND, TRAIL, BODY, ON_TOP, LATCH, LOAD = range(8)
FULL = 4.0  # width of links [pt] below which springs and dampers are smaller too
LAMP = np.array([-0.36, 0.64, 0.68])  # where light comes from: right, up, towards the eye
EDGEWISE = 1e-3  # area of an outline over the square of its extent, below which a plate is seen from its side
SHADES = 24
DOT = 1.0  # radius of a sample of a path without a line to its neighbours [pt]
PALER = {
    "solid": 0.75,
    "shape": 0.62,
    "payload": 0.45,
}  # than the part's colour, bodies with a surface in flat views
PUSH, REACTION = ALARM, "#CC79A7"


ABOUT = {"coil": "spring", "rotary_damper": "damper"}  # an axis


def strokes(view: View, k: int, grid: bool = True) -> list[Stroke]:
    """Return the strokes of the k-th instant in the order in which they are painted."""
    drawn: list[Stroke] = []
    if grid and (lines := view.grid(k)):
        drawn.append(Stroke(symbols.joined(lines), LINES, 0.7, layer=GRID))
    if not view.flat:
        drawn += _shadows(view, k)
    drawn += _trails(view, k)
    width = view.link_width
    for place, part in enumerate(view.drawing.parts):
        drawn += _part(view, k, part, width, place)
    drawn += _masses(view, k, width)
    drawn += pin_strokes(view, k, BODY if not view.flat else ON_TOP)
    for latch in view.drawing.latches:
        drawn += _latch(view, latch, k, width)
    drawn += _arrows(view, k)
    return sorted(drawn, key=lambda stroke: (stroke.layer, stroke.depth))


def silhouette(view: View, k: int) -> list[Array]:
    """Return the outline (n, 2) of each link, bar and payload at an instant: what a faint pose consists of.

    A link without extent has the outline of what stands for it: its box, the block of its slide, or a disc.
    """
    links = [part for part in view.drawing.parts if part.kind == "link"]
    extended = {vertex for part in links if len(part.vertices) > 1 for vertex in part.vertices}
    small = {part.name for part in links if len(part.vertices) <= 1}
    lines = []
    for part in view.drawing.parts:
        boxed = part.kind in ("solid", "shape") and part.name in small
        if boxed or (part.kind in ("link", "bar", "payload") and len(part.vertices) > 1):
            points = view.corners[k, list(part.vertices), :2]
            if np.isfinite(points).all():
                lines.append(_outline(points, view.pt))
    lines += symbols.blocks(view, k, without=extended)
    for vertex in _discs(view) - extended:
        at = view.corners[k, vertex, :2]
        if np.isfinite(at).all():
            lines.append(_disc(view, at, view.link_width))
    return [np.concatenate([line, line[:1]]) if len(line) > 2 else line for line in lines]


def _discs(view: View) -> set[int]:
    """Return where discs stand for bodies without extent; that of a slide is its block."""
    return set(view.drawing.bobs) - {pin.vertex for pin in view.drawing.pins if pin.kind in symbols.SLIDING}


def _disc(view: View, at: Array, width: float) -> Array:
    return symbols.circle(at, (0.55 * width + 2.5 * view.finer) * view.pt)


def _outline(points: Array, pt: float) -> Array:
    """Return the corners of a link: of its hull, or both ends where that is thinner than a printer's point."""
    corners = symbols.hull(points)
    if len(corners) <= 2:
        return corners
    centre = corners - corners.mean(axis=0)
    _, _, axes = np.linalg.svd(centre, full_matrices=False)
    if np.ptp(centre @ axes[1]) > pt:
        return corners
    along = centre @ axes[0]
    return corners[[int(np.argmin(along)), int(np.argmax(along))]]


def _part(view: View, k: int, part: DrawnPart, width: float, place: int) -> list[Stroke]:
    if part.kind in ("link", "ground") and part.name in view.drawing.shaped:
        return []
    corners = view.corners[k, list(part.vertices)]
    if not len(corners) or not np.isfinite(corners).all():
        return []
    points, depth = corners[:, :2], float(corners[:, 2].mean())
    if view.flat:
        depth = 1e-3 * place
    if part.kind == "link":
        if len(points) == 1:
            return []
        return body(_outline(points, view.pt), part.colour, width, BODY, depth)
    if part.kind in PALER:
        return _solid(view, k, part, depth)
    if part.kind == "ground":
        return _ground(points, view) if len(points) > 1 else []
    pt = view.pt * min(1.0, width / FULL)
    if part.kind in ABOUT:
        curl = symbols.about(ABOUT[part.kind], points[1], 8.0 * pt, beside=part.aside != 0)
        return [Stroke(curl, INK, 1.0, layer=ON_TOP, depth=depth)]
    if part.aside and (along := symbols.direction(points[1] - points[0])) is not None:
        points = points + 6.0 * part.aside * pt * np.array([-along[1], along[0]])
    return _connector(part.kind, points[0], points[1], pt, depth)


def _connector(kind: str, a: Array, b: Array, pt: float, depth: float) -> list[Stroke]:
    """Return what joins two places: a bar, a rail, a rope, a spring, a damper."""
    line = np.array([a, b])
    if kind == "bar":
        return body(line, "#7F7F7F", 3.6, BODY, depth)
    if kind == "rail":
        return [Stroke(line, "#a9a9a9", 1.1, layer=BODY, depth=depth - 1e-6, dashed=True)]
    if kind == "rope":
        return [Stroke(line, INK, 1.0, layer=BODY, depth=depth, dashed=True)]
    if kind == "damper":
        return [Stroke(symbols.dashpot(a, b, 8.0 * pt), INK, 1.1, layer=ON_TOP, depth=depth)]
    if kind == "bushing":
        square = symbols.block(0.5 * (a + b), np.array([1.0, 0.0]), 9.0 * pt, 9.0 * pt)
        return [Stroke(square, INK, 1.0, "#c9c9c9", True, ON_TOP, depth)]
    return [Stroke(symbols.zigzag(a, b, 9.0 * pt), INK, 1.1, layer=ON_TOP, depth=depth)]


def _solid(view: View, k: int, part: DrawnPart, depth: float) -> list[Stroke]:
    """Return a body with a surface: its outline where the view is flat, else the faces that look to the eye."""
    edge = mixed(part.colour, INK, 0.35)
    seen = view.project(_places(view, k, part), k)
    if not np.isfinite(seen).all():
        return []
    if view.flat:
        fill = mixed(part.colour, PAPER, PALER[part.kind])
        return [Stroke(_flat_outline(part, seen[:, :2]), edge, 0.8, fill, True, BODY, depth - 1e-4)]
    surface = part.surface or CUBE
    a, b, c = (seen[surface.first[:, n]] for n in range(3))
    normals = np.cross(b - a, c - a)
    sizes = np.linalg.norm(normals, axis=1)
    shown = (sizes > 0.0) & (normals[:, 2] > 0.0 if surface.closed else True)
    drawn = []
    for n in np.flatnonzero(shown):
        rows = seen[list(surface.faces[n])]
        light = float(normals[n] @ LAMP) / math.copysign(sizes[n], normals[n, 2])
        shade = _lit(part.colour, round(SHADES * max(0.0, light)))
        nearness = float(rows[:, 2].mean())
        look = (edge, 0.8) if part.surface is None else (shade, 0.5)
        drawn.append(Stroke(rows[:, :2], *look, shade, True, BODY, nearness))
    return drawn


def _flat_outline(part: DrawnPart, seen: Array) -> Array:
    """Return what is seen of a body (N, 2) in a flat view: its own outline where that is not seen edgewise."""
    own = seen[list(part.surface.outline)] if part.surface is not None else seen[:0]
    if len(own) and symbols.area(own) > EDGEWISE * float(np.ptp(own, axis=0).max()) ** 2:
        return own
    return symbols.hull(seen)


@functools.lru_cache(maxsize=1000)
def _lit(colour: str, step: int) -> str:
    """Return the colour of a face in the light: ``step`` 0 is dark, ``SHADES`` the brightest."""
    return mixed(colour, PAPER, 0.2 + 0.6 * step / SHADES)


def _places(view: View, k: int, part: DrawnPart) -> Array:
    """Return the places (N, 3) in the world that a part consists of."""
    corners = view.drawing.vertices[k, list(part.vertices)]
    return corners if part.surface is None else part.surface.places(corners)


def _ground(points: Array, view: View) -> list[Stroke]:
    """Return the link that stands still: faint, for it is there wherever the paper is."""
    corners = _outline(points, view.pt)
    closed = len(corners) > 2 and not view.flat
    return [Stroke(corners, "#c4c4c4", 1.6, "#efefef" if closed else None, closed, GROUND, dashed=view.flat)]


def _shadows(view: View, k: int) -> list[Stroke]:
    """Return the shadows of links on the ground, straight below them."""
    drawn = []
    for part in view.drawing.parts:
        if part.kind in ("link", "bar", *PALER):
            below = view.on_ground(_places(view, k, part))
            points = view.project(below, k)[:, :2]
            if len(points) > 1 and np.isfinite(points).all():
                corners = _outline(points, view.pt)
                closed = len(corners) > 2
                drawn.append(Stroke(corners, FAINT, 3.0, FAINT if closed else None, closed, SHADOW))
    return drawn


def _trails(view: View, k: int) -> list[Stroke]:
    """Return the paths of points: faint as a whole, and in colour as far as they have come; dots where samples are too
    far apart to show more."""
    drawn = []
    now = view.drawing.times[k]
    for trail in view.drawing.trails:
        path = view.project(trail.points, k)[:, :2]
        faint = mixed(trail.colour, PAPER, 0.65)
        drawn.append(Stroke(path, faint, 0.9, layer=TRAIL, depth=0.0))
        dots = (symbols.circle(place, DOT * view.pt) for place in path[alone(~np.isnan(path[:, 0]))])
        drawn += [Stroke(dot, faint, 0.5, faint, True, TRAIL) for dot in dots]
        passed = path[trail.times <= now]
        if len(passed) > 1:
            drawn.append(Stroke(passed, trail.colour, 1.3, layer=TRAIL, depth=1.0))
    return drawn


def _masses(view: View, k: int, width: float) -> list[Stroke]:
    """Return marks of centres of mass, and discs for bodies without extent."""
    drawn = []
    layer, bias = (ON_TOP, 0.0) if view.flat else (BODY, view.nearer)
    colours = {vertex: part.colour for part in view.drawing.links for vertex in part.vertices}
    discs = _discs(view)
    for vertex in (vertex for vertex in view.drawing.bobs if vertex in discs):
        x, y, depth = view.corners[k, vertex]
        if np.isfinite(x + y):
            colour = colours.get(vertex, INK)
            disc = _disc(view, np.array([x, y]), width)
            edge, fill = mixed(colour, INK, 0.35), mixed(colour, PAPER, 0.5)
            drawn.append(Stroke(disc, edge, 0.9, fill, True, layer, depth + bias))
    radius = float(np.clip(0.36 * width, 1.6, 3.2)) * view.finer * view.pt
    for vertex in view.drawing.masses:
        x, y, depth = view.corners[k, vertex]
        if np.isfinite(x + y):
            centre = np.array([x, y])
            drawn.append(
                Stroke(
                    symbols.circle(centre, radius), INK, 0.6 * view.finer, PAPER, True, layer, depth + bias
                )
            )
            drawn.append(Stroke(symbols.quartered(centre, radius), INK, 0.0, INK, True, layer, depth + bias))
    return drawn


def _latch(view: View, latch: DrawnLatch, k: int, width: float) -> list[Stroke]:
    """Return a latch: a hook on its first link, and while it is closed a plate across the joint."""
    a, joint, b = view.corners[k, list(latch.vertices), :2]
    if not np.isfinite([a, joint, b]).all():
        return []
    reach = (2.0 * width + 4.0 * view.finer) * view.pt
    arms = [
        joint + reach * d
        for d in (symbols.direction(a - joint), symbols.direction(b - joint))
        if d is not None
    ]
    closed = latch.is_closed(view.drawing.times[k])
    colour = ALARM if closed else mixed(INK, PAPER, 0.3)
    plate = symbols.joined([np.array([joint, arm]) for arm in (arms if closed else arms[:1])])
    drawn = [Stroke(plate, colour, max(0.45 * width, 2.0 * view.finer), layer=LATCH)]
    for arm in arms if closed else arms[:1]:
        drawn.append(Stroke(symbols.circle(arm, 0.3 * width * view.pt), colour, 0.8, PAPER, True, LATCH, 1.0))
    if closed:
        drawn.append(
            Stroke(
                symbols.circle(joint, 1.3 * width * view.pt), ALARM, 1.4 * view.finer, None, True, LATCH, 2.0
            )
        )
    return drawn


def _arrows(view: View, k: int) -> list[Stroke]:
    drawn = []
    for arrow, (tail, vector) in zip(view.drawing.arrows, view.tips(k)):
        if not np.isfinite([tail, vector]).all() or not np.hypot(*vector) > 2.0 * view.pt:
            continue
        colour = REACTION if arrow.reaction else PUSH
        shaft, head = symbols.arrow(tail, vector, 7.0 * view.pt)
        drawn.append(Stroke(shaft, colour, 1.5, layer=LOAD))
        drawn.append(Stroke(head, colour, 0.6, colour, True, LOAD))
    return drawn

"""Strokes on paper, by any of matplotlib's renderers (pixels, SVG and PDF alike): a view of a drawing as an artist on
axes, and names beside lines, where they hide least."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet, panel_width
from robodyn_cli.report.drawing import symbols
from robodyn_cli.report.drawing.camera import View
from robodyn_cli.report.drawing.record import GRID, INK, Stroke
from robodyn_cli.report.drawing.strokes import strokes
from robodyn_cli.report.numbers import number
from robodyn_cli.report.style import PlainFormatter
from robodyn_cli.spatial.algebra import Array

DASHES = (0.0, [4.0, 3.0])


class Painted(Artist):
    """Strokes in the coordinates of the axes that it is added to."""

    def __init__(self, strokes: list[Stroke]) -> None:
        super().__init__()
        self.strokes = strokes
        self.set_zorder(3)

    def draw(self, renderer: Any) -> None:
        """Paint the strokes in their order."""
        if self.axes is not None and self.get_visible():
            paint(renderer, self.strokes, self.axes.transData, self.axes.bbox)


def paint(renderer: Any, strokes: list[Stroke], transform: Any, clip: Any = None) -> None:
    """Paint strokes with a transform from their coordinates to those of the renderer."""
    for stroke in strokes:
        gc = renderer.new_gc()
        gc.set_linewidth(stroke.width)
        gc.set_foreground(to_rgba(stroke.colour), isRGBA=True)
        gc.set_capstyle("round")
        gc.set_joinstyle("round")
        if stroke.dashed:
            gc.set_dashes(*DASHES)
        if clip is not None:
            gc.set_clip_rectangle(clip)
        renderer.draw_path(
            gc, _path(stroke), transform, None if stroke.fill is None else to_rgba(stroke.fill)
        )
        gc.restore()


def _path(stroke: Stroke) -> Path:
    """Return a stroke as a path: pieces begin behind rows that are no numbers, and a closed one ends at its start."""
    points = stroke.points
    if not stroke.closed or not len(points):
        return Path(points)
    if np.isfinite(points).all():
        codes = np.full(len(points) + 1, Path.LINETO, dtype=Path.code_type)
        codes[0], codes[-1] = Path.MOVETO, Path.CLOSEPOLY
        return Path(np.concatenate([points, points[:1]]), codes)
    return Path(points)


BELOW, APART = 0.45, 0.62  # room above and between the views along the axes [inch]
CORNER = 24.0  # of the cross of axes, from the edges [pt]
ROOMY = 200.0  # side of a drawing below which they are smaller [pt]
REACH = 15.0  # of its arms [pt]


def height_of(view: View, width: float, least: float = 2.0, most: float = 5.2) -> float:
    """Return the height that suits a view on axes of a width, in inches."""
    low, high = view.extent
    extent = high - low
    return float(np.clip(width * extent[1] / extent[0], least, most))


def set_up(ax: Axes, view: View, scale: bool = True) -> None:
    """Fit a view into axes: with numbered axes where it is along one of the world's and ``scale``, else with none."""
    box = ax.get_position()
    width, height = np.asarray(ax.figure.bbox.size) / float(ax.figure.dpi) * 72.0
    view.fit(box.width * width, box.height * height)
    ax.set_xlim(view.low[0], view.high[0])
    ax.set_ylim(view.low[1], view.high[1])
    ax.set_aspect("auto")
    labels = view.camera.labels
    if scale and labels is not None:
        ax.set_xlabel(labels[0])
        ax.set_ylabel(labels[1])
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(PlainFormatter())
        return
    ax.set_xticks([])
    ax.set_yticks([])
    ax.grid(False)
    for spine in ax.spines.values():
        spine.set_visible(False)


def room_below(views: list[View]) -> float:
    """Return the height that views side by side take below a drawing [inch]; 0 without any."""
    return BELOW + _height_below(views) if views else 0.0


def _height_below(views: list[View]) -> float:
    return max(height_of(view, _width_below(views), 0.9, 1.9) for view in views)


def _width_below(views: list[View]) -> float:
    return (panel_width() - (len(views) - 1) * APART) / len(views)


def axes_below(sheet: Sheet, views: list[View]) -> list[Axes]:
    """Return axes for views side by side, set up; the first axes of the sheet, tall enough for both, make room."""
    if not views:
        return []
    width, total = sheet.figure.get_size_inches()
    high, wide, box = _height_below(views), _width_below(views), sheet.ax.get_position()
    more = room_below(views) / total
    sheet.ax.set_position((box.x0, box.y0 + more, box.width, box.height - more))
    axes = []
    for place, view in enumerate(views):
        left = box.x0 + place * (wide + APART) / width
        ax = sheet.figure.add_axes((left, box.y0, wide / width, high / total))
        set_up(ax, view)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MaxNLocator(4))
        axes.append(ax)
    return axes


def put(ax: Axes, view: View, k: int, before: list[Stroke] | None = None, grid: bool = True) -> Any:
    """Add the drawing at its k-th instant to axes that are set up; ``before`` lies below it."""
    artist = ax.add_artist(Painted([*(before or []), *strokes(view, k, grid)]))
    if not view.numbered:
        cross_of_axes(ax, view)
    return artist


def ground(ax: Axes, view: View) -> None:
    """Draw the ground grid of a view in space, and the directions of the world's axes."""
    ax.add_artist(Painted([Stroke(symbols.joined(view.grid(0)), GRID, 0.7)])).set_zorder(0)
    cross_of_axes(ax, view)


def cross_of_axes(ax: Axes, view: View) -> None:
    """Show the directions of the world's axes in the lower left corner."""
    # small drawings have a small one, out of the way
    pt = view.pt * float(np.clip((view.high - view.low).min() / view.pt / ROOMY, 0.5, 1.0))
    centre = view.low + CORNER * pt
    for name, axis in zip("xyz", np.eye(3)):
        arm = REACH * pt * np.array([axis @ view.camera.right, axis @ view.camera.up])
        if np.hypot(*arm) < 3.0 * pt:
            continue
        shaft, head = symbols.arrow(centre, arm, 5.0 * pt)
        ax.add_artist(Painted([Stroke(shaft, INK, 1.0), Stroke(head, INK, 0.5, INK, True)]))
        place = centre + 1.45 * arm
        ax.text(
            place[0],
            place[1],
            name,
            ha="center",
            va="center",
            fontsize=8 if pt == view.pt else 6,
            color=INK,
            clip_on=False,
        )


def where(view: View) -> str:
    """Return from where a view is seen, in words."""
    labels = view.camera.labels
    if labels is None:
        return "face on to its plane" if view.flat else "in perspective"
    return f"in the {labels[0][0]}-{labels[1][0]} plane"


def caption(view: View, grid: bool = True) -> str:
    """Return what the marks of a view mean: its grid and its arrows."""
    words = [f"grid {number(view.pitch)} m"] if grid else []
    if view.drawing.strongest > 0.0:
        words.append(f"longest arrow {number(view.drawing.strongest)} N")
    return ", ".join(words)


def outlines(view: View, k: int) -> dict[str, Array]:
    """Return the line (n, 2) of each link at an instant, closed where it has an area, for names beside it."""
    lines = {}
    for part in view.drawing.links:
        points = view.corners[k, list(part.vertices), :2]
        if len(points) and np.isfinite(points).all():
            corners = symbols.hull(points)
            lines[part.name] = np.concatenate([corners, corners[:1]]) if len(corners) > 2 else corners
    return lines


ALONG = (0.5, 0.35, 0.65, 0.22, 0.78)  # places along a line that are tried
GAPS = (8.0, 13.0, 20.0, 30.0)  # points between the middle of a line and its name
LEADS = 13.0  # gap from which on a thin line leads from a name to its line
LETTER_WIDTH, LETTER_HEIGHT = 0.62, 1.25  # of a character, over the font size
OVERLAP = 1000.0  # cost of covering another name
FOREIGN = 50.0  # of touching a place of another link or a joint
FAR = 0.4  # of each point away
STEP = 2.0  # between places by which a line is represented [pt]


def points_per_unit(ax: Any) -> float:
    """Return the scale [pt per unit] of axes with equal scales, as they will be drawn."""
    box, figure = ax.get_position(), ax.figure.get_size_inches() * 72.0
    spans = np.ptp([ax.get_xlim(), ax.get_ylim()], axis=1)
    return float(np.min(np.array([box.width, box.height]) * figure / np.maximum(spans, 1e-300)))


def name_lines(ax: Any, view: View, k: int, faint: list[Array]) -> None:
    """Write the name of each link of a view's k-th instant beside it; ``faint`` are further lines to keep off.

    Of some places along each link, on either side and at some distances, the one is taken whose box covers the least of
    other names, of other links and joints, of faint lines and of the edge of the drawing.
    """
    lines = outlines(view, k)
    scale = points_per_unit(ax)
    taken: list[Array] = []
    drawn = {name: _sampled(line * scale) for name, line in lines.items()}
    pins = view.corners[k, [pin.vertex for pin in view.drawing.pins], :2].reshape(-1, 2) * scale
    pale = np.concatenate([_sampled(line * scale) for line in faint]) if faint else np.zeros((0, 2))
    edges = np.array([ax.get_xlim(), ax.get_ylim()]) * scale
    for name, line in lines.items():
        size = style.FONT_SIZE * np.array([LETTER_WIDTH * len(name), LETTER_HEIGHT])
        others = [points for other, points in drawn.items() if other != name]
        solid = [(points, 0.5 * view.link_width) for points in others] + [(pins, view.radius + 0.6)]
        places = _places(line * scale, size)
        costs = [
            _cost(centre, size, taken, edges)
            + FOREIGN * sum(_covered(centre, size, points, reach) for points, reach in solid)
            + _covered(centre, size, np.concatenate([pale, drawn[name]]), 0.0)
            + FAR * gap
            for centre, _, gap in places
        ]
        if not places or min(costs) >= OVERLAP:  # no name is better than two that nobody can read
            continue
        centre, foot, gap = places[int(np.argmin(costs))]
        taken.append(np.concatenate([centre - 0.5 * size, centre + 0.5 * size]))
        if gap > LEADS:
            ax.plot(*(np.array([centre, foot]) / scale).T, color=style.GREY, linewidth=0.6, zorder=5.5)
        ax.annotate(
            name,
            centre / scale,
            color=style.GREY,
            ha="center",
            va="center",
            zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6},
        )


def _sampled(line: Array) -> Array:
    """Return points along a line [pt]."""
    lengths = np.hypot(*np.diff(line, axis=0).T) if len(line) > 1 else np.zeros(0)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    if not np.isfinite(at).all():
        return line[np.isfinite(line).all(axis=1)]
    u = np.linspace(0.0, at[-1], int(min(at[-1] / STEP, 1000.0)) + 1)
    return np.column_stack([np.interp(u, at, line[:, 0]), np.interp(u, at, line[:, 1])])


def _places(line: Array, size: Array) -> list[tuple[Array, Array, float]]:
    """Return centres of boxes beside the stretches of a line [pt], the place on it that each is beside, and how far
    away it is; the box touches its stretch nowhere."""
    found = []
    for first, last in zip(line, line[1:] if len(line) > 1 else line):
        if not np.isfinite([first, last]).all():
            continue
        d = last - first
        length = float(np.hypot(*d))
        normal = np.array([-d[1], d[0]]) / length if length > 1e-6 else np.array([0.6, 0.8])
        reach = 0.5 * float(np.abs(normal) @ size)
        # above the line first
        side = normal if normal[1] >= 0.0 else -normal
        found += [
            (first + u * d + sign * (reach + gap) * side, first + u * d, gap)
            for gap in GAPS
            for u in ALONG
            for sign in (1.0, -1.0)
        ]
    return found


def _covered(centre: Array, size: Array, points: Array, reach: float) -> int:
    """Return how many points come nearer than ``reach`` to a box."""
    off = np.maximum(np.abs(points - centre) - 0.5 * size, 0.0)
    return int(np.sum(np.hypot(*off.T) <= reach))


def _cost(centre: Array, size: Array, taken: list[Array], edges: Array) -> float:
    """Return what a box costs by the names that it would cover, and by how far it leaves the drawing."""
    low, high = centre - 0.5 * size, centre + 0.5 * size
    overlaps = [np.minimum(high, other[2:]) - np.maximum(low, other[:2]) for other in taken]
    outside = np.maximum(edges[:, 0] - low, 0.0) + np.maximum(high - edges[:, 1], 0.0)
    return OVERLAP * sum(bool(np.all(x > -1.0)) for x in overlaps) + 10.0 * float(outside.sum())

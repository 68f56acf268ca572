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
from robodyn_cli.report.style import PlainFormatter, number
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
    if not view.flat:
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
    return "in perspective" if labels is None else f"in the {labels[0][0]}-{labels[1][0]} plane"


def caption(view: View, grid: bool = True) -> str:
    """Return what the marks of a view mean: its grid and its arrows."""
    words = [f"grid {number(view.pitch)} m"] if grid else []
    if view.drawing.strongest > 0.0:
        words.append(f"longest arrow {number(view.drawing.strongest)} N")
    return ", ".join(words)


def outlines(view: View, k: int) -> dict[str, Array]:
    """Return the line (n, 2) of each link at an instant, for names beside it."""
    lines = {}
    for part in view.drawing.links:
        points = view.corners[k, list(part.vertices), :2]
        if len(points) and np.isfinite(points).all():
            lines[part.name] = symbols.hull(points) if len(points) > 2 else points
    return lines


ALONG = (0.5, 0.35, 0.65, 0.22, 0.78)  # places along a line that are tried
GAP = 8.0  # points between the middle of a line and its name
LETTER_WIDTH, LETTER_HEIGHT = 0.62, 1.25  # of a character, over the font size
OVERLAP = 1000.0  # cost of covering another name
PER_LINE = 40  # points by which a line is represented


def points_per_unit(ax: Any) -> float:
    """Return the scale [pt per unit] of axes with equal scales, as they will be drawn."""
    box, figure = ax.get_position(), ax.figure.get_size_inches() * 72.0
    spans = np.ptp([ax.get_xlim(), ax.get_ylim()], axis=1)
    return float(np.min(np.array([box.width, box.height]) * figure / np.maximum(spans, 1e-300)))


def name_lines(ax: Any, lines: dict[str, Array], obstacles: list[Array]) -> None:
    """Write each name beside its line, (n, 2) in data units; ``obstacles`` are further lines to keep off.

    Of some places along each line, on either side, the one is taken whose box covers the least of other names, of
    lines and of the edge of the drawing.
    """
    if not lines:
        return
    scale = points_per_unit(ax)
    taken: list[Array] = []
    drawn = np.concatenate([_sampled(line * scale) for line in [*lines.values(), *obstacles]])
    edges = np.array([ax.get_xlim(), ax.get_ylim()]) * scale
    for name, line in lines.items():
        size = style.FONT_SIZE * np.array([LETTER_WIDTH * len(name), LETTER_HEIGHT])
        places = _places(line * scale, size)
        if not len(places):
            continue
        costs = [_cost(centre, size, taken, drawn, edges) + 0.1 * k for k, centre in enumerate(places)]
        if min(costs) >= OVERLAP:  # no name is better than two that nobody can read
            continue
        centre = places[int(np.argmin(costs))]
        taken.append(np.concatenate([centre - 0.5 * size, centre + 0.5 * size]))
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
    u = np.linspace(0.0, len(line) - 1.0, PER_LINE)
    k = np.arange(len(line))
    return np.column_stack([np.interp(u, k, line[:, 0]), np.interp(u, k, line[:, 1])])


def _places(line: Array, size: Array) -> list[Array]:
    """Return centres of boxes beside the first stretch of a line [pt]; the box touches the line nowhere."""
    first, last = line[0], line[min(1, len(line) - 1)]
    if not np.isfinite([first, last]).all():
        return []
    d = last - first
    length = float(np.hypot(*d))
    normal = np.array([-d[1], d[0]]) / length if length > 1e-6 else np.array([0.6, 0.8])
    reach = 0.5 * float(np.abs(normal) @ size) + GAP
    # above the line first
    side = normal if normal[1] >= 0.0 else -normal
    return [first + u * d + sign * reach * side for u in ALONG for sign in (1.0, -1.0)]


def _cost(centre: Array, size: Array, taken: list[Array], drawn: Array, edges: Array) -> float:
    low, high = centre - 0.5 * size, centre + 0.5 * size
    cost = 0.0
    for other in taken:
        overlap = np.minimum(high, other[2:]) - np.maximum(low, other[:2])
        if np.all(overlap > -1.0):
            cost += OVERLAP
    inside = np.all((drawn > low) & (drawn < high), axis=1)
    outside = np.maximum(edges[:, 0] - low, 0.0) + np.maximum(high - edges[:, 1], 0.0)
    return cost + float(inside.sum()) + 10.0 * float(outside.sum())

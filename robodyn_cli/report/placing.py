"""Names beside lines, where they hide least and can be told apart."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.spatial.algebra import Array

ALONG = (0.5, 0.35, 0.65, 0.22, 0.78)  # places along a line that are tried
GAP = 8.0  # points between the middle of a line and its name
WIDTH, HEIGHT = 0.62, 1.25  # of a character, over the font size
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
        size = style.FONT_SIZE * np.array([WIDTH * len(name), HEIGHT])
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

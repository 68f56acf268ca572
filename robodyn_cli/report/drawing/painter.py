"""Strokes on paper, by any of matplotlib's renderers: pixels, SVG and PDF alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.colors import to_rgba
from matplotlib.path import Path

from robodyn_cli.report.drawing.stroke import Stroke

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

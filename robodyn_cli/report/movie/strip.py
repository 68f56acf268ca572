"""A strip of stills, for papers: some instants side by side, at one scale."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import make_drawing
from robodyn_cli.report.drawing.camera import default_camera
from robodyn_cli.report.drawing.instants import along_motion, evenly
from robodyn_cli.report.drawing.view import View
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result

STILLS = 6
ACROSS, ACROSS_WIDE = 3, 2  # stills side by side, and of drawings that are wide
WIDE = 1.6  # width over height from which on a drawing is wide
WIDTH, BETWEEN = 5.9, 0.15  # of all stills side by side, and between them [inch]
RIM = 0.3  # above and below a still, for the marks of joints [inch]


def draw_strip(result: Result, follow: str | None = None) -> Any:
    """Return a figure of some instants equally far apart along the motion."""
    samples = evenly(len(result.time), 400)
    drawing = make_drawing(result, samples)
    chosen = along_motion(drawing, STILLS)
    poses = drawing.at(chosen)
    places = None if follow is None else result[f"points/{follow}"][samples[np.array(chosen)]]
    view = View(poses, default_camera(drawing), places)
    width, height = view.extent[1] - view.extent[0]
    across = min(ACROSS_WIDE if width > WIDE * height else ACROSS, len(chosen))
    wide = (WIDTH - (across - 1) * BETWEEN) / across
    high = paper.height_of(view, wide, 0.8, 2.0 * wide) + RIM
    sheet = Sheet(
        result,
        paper.caption(view),
        panels=len(chosen),
        across=across,
        height=high,
        gap=0.3,
        between=BETWEEN,
        numbered=False,
    )
    for k, ax in enumerate(sheet.axes):
        paper.set_up(ax, view, scale=False)
        paper.put(ax, view, k)
        ax.set_title(f"t = {number(float(poses.times[k]), 4)} s", fontsize=style.FONT_SIZE, loc="left", pad=3)
    return sheet.figure

"""The mechanism at several instants, light to dark, the last pose in full; in space with views along the axes."""

from __future__ import annotations

from typing import Any

from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D

from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import can_draw, make_drawing
from robodyn_cli.report.drawing.camera import View, along_axis, default_camera
from robodyn_cli.report.drawing.paper import name_lines
from robodyn_cli.report.drawing.places import along_motion, evenly
from robodyn_cli.report.drawing.record import Stroke
from robodyn_cli.report.drawing.strokes import silhouette
from robodyn_cli.report.ticks import number
from robodyn_cli.results.moments import lock_time
from robodyn_cli.results.result import Result

POSES = 8
MOST_NAMES = 8


def applies(result: Result) -> bool:
    """Tell whether there are poses."""
    return can_draw(result)


def draw(result: Result) -> Any:
    """Return the figure."""
    drawing = make_drawing(result, evenly(len(result.time), 400))
    chosen = along_motion(drawing, POSES)
    poses = drawing.at(chosen)
    view = View(poses, default_camera(drawing))
    locked = lock_time(result)
    times = [f"{number(float(t), 4)} s" for t in poses.times]
    end = "locked" if locked is not None and abs(poses.times[-1] - locked) < 1e-6 else "last"
    labels = [] if len(chosen) == 1 else [*times[:-1], f"{times[-1]} ({end})"]
    height = paper.height_of(view, paper.WIDTH)
    views = [] if view.flat else [View(poses, along_axis(axis)) for axis in (1, 0, 2)]
    more = paper.room_below(views)
    sheet = Sheet(result, _subtitle(view, len(chosen)), labels=labels, height=height + more)
    for one, below in zip(views, paper.axes_below(sheet, views)):
        paper.put(below, one, len(chosen) - 1, _ghosts(one, 0.7), grid=False)
    ax = sheet.ax
    paper.set_up(ax, view)
    last = len(chosen) - 1
    paper.put(ax, view, last, _ghosts(view, 1.3), grid=not view.flat)
    if len(drawing.links) <= MOST_NAMES:
        lines = paper.outlines(view, last)
        name_lines(ax, lines, [line for k in range(last) for line in silhouette(view, k)])
    handles = [
        Line2D([], [], color=_shade(k, last), linewidth=2.6 if k == last else 1.3) for k in range(last + 1)
    ]
    sheet.legend(handles, labels)
    return sheet.figure


def _subtitle(view: View, count: int) -> str:
    instants = f"{count} instants, light to dark" if count > 1 else "1 instant"
    where = paper.where(view) + ("" if view.flat else " and along the axes")
    told = paper.caption(view, grid=not view.flat)
    return f"The mechanism {where} at {instants}{'; ' if told else ''}{told}"


def _shade(k: int, last: int) -> str:
    """Return the colour of a pose: black for the last."""
    return "#000000" if k == last else to_hex(colormaps["Blues"](0.25 + 0.6 * k / max(1, last)))


def _ghosts(view: View, width: float) -> list[Stroke]:
    """Return the outlines of all poses but the last."""
    last = len(view.drawing.times) - 1
    return [Stroke(line, _shade(k, last), width) for k in range(last) for line in silhouette(view, k)]

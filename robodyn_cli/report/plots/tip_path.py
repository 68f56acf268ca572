"""Paths of the named points that move, and of their targets: flat in a plane, in space with views along the axes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import finite, largest, thin_path
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import can_draw, gravity_of
from robodyn_cli.report.drawing.camera import View, along_axis, default_camera
from robodyn_cli.report.drawing.places import drawing_of_paths, moving_paths
from robodyn_cli.report.style import FEW, GREY, TARGET, line_styles
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

START: dict[str, Any] = {"marker": "o", "color": "white", "markeredgewidth": 1.8, "markersize": 8}


def applies(result: Result) -> bool:
    """Tell whether there are points that move."""
    return bool(moving_paths(result))


def draw(result: Result) -> Any:
    """Return the figure."""
    points = moving_paths(result)
    targets = {name: item.data for name, item in result.group("targets").items() if name in points}
    drawn = list(points)[:FEW]
    shown = {name: points[name] for name in drawn}
    gravity = gravity_of(result) if can_draw(result) else np.zeros(3)
    paths = drawing_of_paths([*shown.values(), *targets.values()], gravity)
    view = View(paths, default_camera(paths))
    views = [] if view.flat else [View(paths, along_axis(axis)) for axis in (1, 0, 2)]
    labels = [*drawn, *(["target"] if targets else []), "start"]
    height = paper.height_of(view, paper.WIDTH) + paper.room_below(views)
    sheet = Sheet(result, _subtitle(view, points, targets, drawn), labels=labels, height=height)
    for one, ax in zip(views, paper.axes_below(sheet, views)):
        _paths(ax, one, shown, targets, 0.6)
    paper.set_up(sheet.ax, view)
    if not view.flat:
        paper.ground(sheet.ax, view)
    handles = _paths(sheet.ax, view, shown, targets, 1.0)
    sheet.legend([*handles, Line2D([], [], markeredgecolor=GREY, **START)], labels)
    return sheet.figure


def _paths(
    ax: Axes, view: View, points: dict[str, Array], targets: dict[str, Array], scale: float
) -> list[Any]:
    """Draw the paths; return handles of those of points, and of a target where there is one."""
    handles: list[Any] = []
    # A path lies below its target: one that is tracked then shows as a dashed line on a broad one.
    for (name, data), look in zip(points.items(), line_styles(len(points))):
        path = thin_path(view.camera.project(data)[:, :2])
        width, dash = (3.0, "-") if name in targets else (1.5, look["linestyle"])
        handles += ax.plot(*path.T, color=look["color"], linestyle=dash, linewidth=scale * width)
    dashed: list[Any] = []
    for data in targets.values():
        path = thin_path(view.camera.project(data)[:, :2])
        dashed = ax.plot(*path.T, color=TARGET, linestyle=(0, (4, 3)), linewidth=scale * 1.0)
    for data, handle in zip(points.values(), handles):
        start = view.camera.project(data[:1])[:, :2]
        look = {**START, "markersize": scale * START["markersize"]}
        ax.plot(*start.T, markeredgecolor=handle.get_color(), zorder=4, **look)
    return [*handles, *dashed[:1]]


def _subtitle(view: View, points: dict[str, Array], targets: dict[str, Array], drawn: list[str]) -> str:
    text = "Path of " + (f"point {drawn[0]}" if len(drawn) == 1 else "the points")
    if len(drawn) < len(points):
        text += f" ({len(drawn)} of {len(points)})"
    if not view.flat:
        text += f", in perspective and along the axes; {paper.caption(view)}"
    if targets:
        gap = max(
            largest(np.linalg.norm(points[name] - finite(target), axis=1)) for name, target in targets.items()
        )
        text += f"; largest distance from the target {number(gap)} m"
    return text

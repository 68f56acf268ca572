"""The mechanism at one state with its frames, for ``info``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.report.drawing.build import can_draw, make_drawing
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robodyn_cli.report.drawing.camera import View
    from robodyn_cli.report.drawing.record import Stroke

# Okabe and Ito's vermilion, green and blue
AXIS_COLOURS = ("#D55E00", "#009E73", "#0072B2")
LENGTH = 26.0  # of an axis of a frame [pt]


def applies(result: Result) -> bool:
    """Tell whether the frames of the links are known."""
    return "frames" in result.summary and can_draw(result)


def draw(result: Result) -> Figure:
    """Return the figure; the frames are origins (3,) and axes (3, 3; columns) in world coordinates."""
    from matplotlib.lines import Line2D

    from robodyn_cli.report.canvas import Sheet
    from robodyn_cli.report.drawing import paper
    from robodyn_cli.report.drawing.camera import View, default_camera
    from robodyn_cli.report.drawing.paper import Painted

    drawing = make_drawing(result)
    view = View(drawing, default_camera(drawing))
    labels = [f"{axis} of a frame" for axis in "xyz"]
    told = paper.caption(view, grid=not view.flat)
    subtitle = f"The mechanism {paper.where(view)} with its frames{'; ' if told else ''}{told}"
    sheet = Sheet(result, subtitle, labels=labels, height=paper.height_of(view, 5.9))
    ax = sheet.ax
    paper.set_up(ax, view)
    ax.add_artist(Painted(_axes(result, view))).set_zorder(4)
    paper.put(ax, view, 0, grid=not view.flat)
    _names(ax, result, view)
    sheet.legend([Line2D([], [], color=colour) for colour in AXIS_COLOURS], labels)
    return sheet.figure


def _axes(result: Result, view: View) -> list[Stroke]:
    """Return the axes of the links' frames."""
    from robodyn_cli.report.drawing.record import Stroke

    strokes = []
    for frame in result.summary["frames"].values():
        p, R = (np.array(frame[key]) for key in ("position", "rotation"))
        ends = np.stack([p, *(p + LENGTH * view.pt * R[:, k] for k in range(3))])
        places = view.project(ends, 0)[:, :2]
        strokes += [Stroke(places[[0, k + 1]], AXIS_COLOURS[k], 1.6) for k in range(3)]
    return strokes


def _names(ax: Any, result: Result, view: View) -> None:
    """Write the names of frames and of points, once for those that nearly coincide."""
    from robodyn_cli.report import style

    def seen(p: Array) -> Array:
        return np.asarray(view.project(p, 0)[:2])

    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    look: dict[str, Any] = {"textcoords": "offset points", "bbox": box, "zorder": 6}
    near = 6.0 * view.pt
    frames = {name: seen(frame["position"]) for name, frame in result.summary["frames"].items()}
    middle = 0.5 * (view.low[0] + view.high[0])

    def write(place: Array, text: str, above: float, **more: Any) -> None:
        # towards the middle, where there is room
        left = bool(place[0] <= middle)
        side = {"xytext": (6.0 if left else -6.0, above), "ha": "left" if left else "right"}
        ax.annotate(text, (place[0], place[1]), **side, **look, **more)

    for place, text in _together(frames, near):
        write(place, text, -15.0, color=style.GREY)
    points = {name: seen(item.data[0]) for name, item in result.group("points").items()}
    for place, text in _together(points, near):
        ax.plot(*place[:, None], marker="x", color="black", linestyle="none", zorder=7)
        write(place, text, 9.0)


def _together(places: dict[str, Array], near: float) -> list[tuple[Array, str]]:
    """Return places with their names; those that nearly coincide share one label."""
    found: list[tuple[Array, list[str]]] = []
    for name, place in places.items():
        same = next((names for other, names in found if np.abs(other - place).max() < near), None)
        if same is None:
            found.append((place, [name]))
        else:
            same.append(name)
    return [(place, ", ".join(names)) for place, names in found]

"""The mechanism at one state with its frames, for ``info``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.report.plane import AXES, box_height, main_plane
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's vermilion, green and blue
AXIS_COLOURS = ("#D55E00", "#009E73", "#0072B2")


def applies(result: Result) -> bool:
    """Tell whether the frames of the links are known."""
    return "frames" in result.summary


def draw(result: Result) -> Figure:
    """Return the figure; the frames are origins (3,) and axes (3, 3; columns) in world coordinates."""
    from matplotlib.lines import Line2D

    from robodyn_cli.report import style
    from robodyn_cli.report.canvas import Sheet

    shapes = {name: item.data[0] for name, item in result.group("skeleton").items()}
    clouds = [shape[None] for shape in shapes.values()] or [np.zeros((1, 1, 3))]
    plane = list(main_plane(clouds))
    flat = np.concatenate([cloud.reshape(-1, 3)[:, plane] for cloud in clouds])
    length = 0.08 * max(float(np.ptp(flat, axis=0).max()), 1e-3)
    name = f"{AXES[plane[0]]}-{AXES[plane[1]]} plane"
    labels = ["link", *(f"{axis} of a frame" for axis in AXES)]
    sheet = Sheet(
        result, f"The mechanism in the {name} with its frames", labels=labels, height=box_height(flat)
    )
    ax = sheet.ax
    for shape in shapes.values():
        ax.plot(
            *shape[:, plane].T,
            color="black",
            linewidth=2.2,
            marker="o",
            markerfacecolor="white",
            markersize=6,
        )
    frames: dict[str, tuple[Array, Array]] = {
        name: (frame["position"], frame["rotation"]) for name, frame in result.summary["frames"].items()
    }
    for p, R in frames.values():
        for k in range(3):
            tip = p + length * R[:, k]
            ax.plot(
                [p[plane[0]], tip[plane[0]]], [p[plane[1]], tip[plane[1]]], color=AXIS_COLOURS[k], zorder=5
            )
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    look: dict[str, Any] = {"textcoords": "offset points", "bbox": box, "zorder": 6}
    near = 0.2 * length
    for place, text in _together({name: p[plane] for name, (p, _) in frames.items()}, near):
        ax.annotate(text, (place[0], place[1]), xytext=(5, -11), color=style.GREY, **look)
    for place, text in _together(
        {name: item.data[0][plane] for name, item in result.group("points").items()}, near
    ):
        ax.plot(*place[:, None], marker="x", color="black", linestyle="none", zorder=7)
        ax.annotate(text, (place[0], place[1]), xytext=(6, 6), **look)
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.12)
    ax.set_xlabel(f"{AXES[plane[0]]} [m]")
    ax.set_ylabel(f"{AXES[plane[1]]} [m]")
    handles: list[Any] = [Line2D([], [], color="black", linewidth=2.2)]
    handles += [Line2D([], [], color=colour) for colour in AXIS_COLOURS]
    sheet.legend(handles, labels)
    return sheet.figure


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

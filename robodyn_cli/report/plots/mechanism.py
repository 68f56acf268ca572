"""The mechanism at several instants, light to dark, the last pose emphasised."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import extremes, finite
from robodyn_cli.report.marks import lock_time
from robodyn_cli.report.placing import name_lines
from robodyn_cli.report.plane import AXES, box_height, main_plane
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

POSES = 8
MOST_NAMES = 8


def applies(result: Result) -> bool:
    """Tell whether there are outlines of links."""
    return bool(result.group("skeleton"))


def draw(result: Result) -> Any:
    """Return the figure."""
    links = {name: finite(item.data) for name, item in result.group("skeleton").items()}
    plane = list(main_plane(list(links.values())))
    flat = {name: data[:, :, plane] for name, data in links.items()}
    chosen = _instants(flat)
    locked = lock_time(result)
    times = [f"{number(float(result.time[index]), 4)} s" for index in chosen]
    end = "locked" if locked is not None and abs(result.time[chosen[-1]] - locked) < 1e-6 else "last"
    labels = [*times[:-1], f"{times[-1]} ({end})"]
    everything = np.concatenate([data[chosen].reshape(-1, 2) for data in flat.values()])
    name = f"{AXES[plane[0]]}-{AXES[plane[1]]} plane"
    subtitle = (
        f"The mechanism in the {name} at {len(chosen)} instant{'s, light to dark' if len(chosen) > 1 else ''}"
    )
    sheet = Sheet(result, subtitle, labels=labels, height=box_height(everything))
    ax = sheet.ax
    handles = _poses(ax, flat, chosen)
    _pivots(ax, flat, chosen[-1])
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.08)
    if len(flat) <= MOST_NAMES:
        last = {name: data[chosen[-1]] for name, data in flat.items()}
        name_lines(ax, last, [data[k] for data in flat.values() for k in chosen[:-1]])
    ax.set_xlabel(f"{AXES[plane[0]]} [m]")
    ax.set_ylabel(f"{AXES[plane[1]]} [m]")
    sheet.legend(handles, labels)
    return sheet.figure


def _instants(flat: dict[str, Array]) -> list[int]:
    """Return samples equally far apart along the motion, first and last included."""
    count = len(next(iter(flat.values())))
    stride = max(1, count // 5000)
    index = np.union1d(np.arange(0, count, stride), [count - 1])
    moved = np.zeros(len(index) - 1)
    for data in flat.values():
        step = np.linalg.norm(np.diff(data[index], axis=0), axis=2).max(axis=1)
        moved = np.maximum(moved, np.nan_to_num(step))
    length = np.concatenate([[0.0], np.cumsum(moved)])
    if not length[-1] > 0.0:
        return [0] if count == 1 else [0, count - 1]
    wanted = np.linspace(0.0, length[-1], POSES)
    return sorted({int(index[np.argmin(np.abs(length - mark))]) for mark in wanted} | {0, count - 1})


def _poses(ax: Any, flat: dict[str, Array], chosen: list[int]) -> list[Any]:
    """Draw every pose; return a legend handle for each."""
    palette = colormaps["Blues"]
    handles = []
    for order, sample in enumerate(chosen):
        last = order == len(chosen) - 1
        look: dict[str, Any] = {
            "color": "#000000" if last else palette(0.25 + 0.6 * order / max(1, len(chosen) - 1)),
            "linewidth": 2.6 if last else 1.3,
        }
        shapes = [data[sample] for data in flat.values()]
        ax.add_collection(
            LineCollection(
                shapes,
                colors=look["color"],
                linewidths=look["linewidth"],
                capstyle="round",
                zorder=2 + 0.1 * order,
            )
        )
        handles.append(Line2D([], [], **look))
    ax.autoscale_view()
    return handles


def _pivots(ax: Any, flat: dict[str, Array], sample: int) -> None:
    """Draw the pivots of the last pose: triangles where they never move, circles where they do."""
    low, high = extremes(np.concatenate([data.reshape(-1, 2) for data in flat.values()]))
    size = float((high - low).max())
    still: list[Array] = []
    moving: list[Array] = []
    for data in flat.values():
        for corner in range(data.shape[1]):
            track = data[:, corner]
            first, last = extremes(track)
            # Without any motion nothing tells the pivots on the ground from the others.
            fixed = bool(size > 0.0 and len(track) > 1 and float((last - first).max()) <= 1e-6 * size)
            (still if fixed else moving).append(track[sample])
    marks = {
        "color": "white",
        "markeredgecolor": "black",
        "markeredgewidth": 1.4,
        "linestyle": "none",
        "zorder": 5,
    }
    if moving:
        ax.plot(*np.array(moving).T, marker="o", markersize=6, **marks)
    if still:
        ax.plot(*np.array(still).T, marker="^", markersize=11, **marks)

"""Paths of the named points in the plane where they move most, beside what was asked of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import finite, largest, thin_path
from robodyn_cli.report.plane import AXES, box_height, main_plane
from robodyn_cli.report.style import FEW, GREY, TARGET, line_styles
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array


def applies(result: Result) -> bool:
    """Tell whether there are points."""
    return bool(result.group("points"))


def draw(result: Result) -> Any:
    """Return the figure."""
    points = {name: finite(item.data) for name, item in result.group("points").items()}
    targets = {name: item.data for name, item in result.group("targets").items() if name in points}
    first, second = main_plane([*points.values(), *targets.values()])
    flat = {name: data[:, [first, second]] for name, data in points.items()}
    drawn = list(flat)[:FEW]
    labels = [*drawn, *(["target"] if targets else []), "start"]
    everything = np.concatenate([flat[name] for name in drawn])
    sheet = Sheet(result, _subtitle(points, targets, drawn), labels=labels, height=box_height(everything))
    ax = sheet.ax
    handles: list[Any] = []
    # The path lies below its target: a tracked path then shows as a dashed line on a broad one.
    for name, look in zip(drawn, line_styles(len(drawn))):
        path = thin_path(flat[name])
        width = 3.0 if name in targets else 1.5
        handles += ax.plot(
            path[:, 0],
            path[:, 1],
            color=look["color"],
            linestyle=look["linestyle"] if name not in targets else "-",
            linewidth=width,
        )
    dashed: list[Any] = []
    for name in drawn:
        if name in targets:
            path = thin_path(targets[name][:, [first, second]])
            dashed = ax.plot(path[:, 0], path[:, 1], color=TARGET, linestyle=(0, (4, 3)), linewidth=1.0)
    for name, handle in zip(drawn, handles):
        ax.plot(
            flat[name][0, 0],
            flat[name][0, 1],
            "o",
            color="white",
            markeredgecolor=handle.get_color(),
            markeredgewidth=1.8,
            markersize=8,
            zorder=4,
        )
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.08)
    ax.set_xlabel(f"{AXES[first]} [m]")
    ax.set_ylabel(f"{AXES[second]} [m]")
    start = [
        Line2D([], [], marker="o", color="white", markeredgecolor=GREY, markeredgewidth=1.8, markersize=8)
    ]
    sheet.legend([*handles, *dashed, *start], labels)
    return sheet.figure


def _subtitle(points: dict[str, Array], targets: dict[str, Array], drawn: list[str]) -> str:
    text = "Path of " + (f"point {drawn[0]}" if len(drawn) == 1 else "the points")
    if len(drawn) < len(points):
        text += f" ({len(drawn)} of {len(points)})"
    if targets:
        gap = max(largest(np.linalg.norm(points[name] - target, axis=1)) for name, target in targets.items())
        text += f"; largest distance from the target {number(gap)} m"
    return text

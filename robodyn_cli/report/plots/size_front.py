"""All combinations of motors and gears of each joint: cost or mass over the margin, and what none of them beats."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.ticks import log_axis, number
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

MOST = 8  # joints that are drawn
WORST = -1.0  # margins below are drawn at the edge
TICKS = (WORST, -0.5, 0.0, 0.5, 1.0)
DOTS = {"linestyle": "none", "marker": "."}
RING = {"linestyle": "none", "marker": "o", "markerfacecolor": "none", "markersize": 9}
# what there is to draw, in the order of the legend
LOOKS: dict[str, Mapping[str, Any]] = {
    "bears it": {**DOTS, "color": "#000000", "markersize": 4},
    "too small": {**DOTS, "color": "#b5b5b5", "markersize": 3},
    "none is better in both": {
        "drawstyle": "steps-post", "color": style.COLOURS[0], "linewidth": 1.4, "marker": "D", "markersize": 3,
    },
    "chosen": {**RING, "color": style.ALARM},
}  # fmt: skip


def applies(result: Result) -> bool:
    """Tell whether the drives were chosen from a catalogue."""
    return bool(result.group("candidates"))


def draw(result: Result) -> Any:
    """Return the figure."""
    tables = dict(list(result.group("candidates").items())[:MOST])
    by = result.summary["size"]["by"]
    left = len(result.group("candidates")) - len(tables)
    note = f"; {left} further joints left out" if left else ""
    found = [_points(result, name, table.data, by) for name, table in tables.items()]
    labels = [label for label in LOOKS if any(len(points[label][0]) for points in found)]
    sheet = Sheet(
        result,
        f"Combinations of motor and gear: {by} over the margin of the limit that decides{note}",
        panels=len(tables),
        across=1 if len(tables) == 1 else 2,
        height=2.4,
        gap=0.9,
        titled=True,
        labels=labels,
    )
    for ax, name, points in zip(sheet.axes, tables, found):
        handles = [ax.plot(*points[label], **LOOKS[label])[0] for label in labels]
        _finish(ax, result, name, by, np.concatenate([prices for _, prices in points.values()]))
    sheet.legend(handles, labels)
    return sheet.figure


def _points(result: Result, name: str, data: Array, by: str) -> dict[str, tuple[Array, Array]]:
    """Return margins [%] and prices of one joint's combinations by their look."""
    sized, drive = result.summary["size"]["joints"][name], result.summary["drives"][name]
    rows = data[np.isfinite(data[:, 4])]
    passing = rows[:, 4] >= drive["least_margin"]
    margins, prices = rows[:, 4], rows[:, {"cost": 2, "mass": 3}[by]]
    front = np.array([(one["margin"], one[by]) for one in sized["front"]]).reshape(-1, 2)
    found = {
        "bears it": (margins[passing], prices[passing]),
        "too small": (margins[~passing], prices[~passing]),
        "none is better in both": (front[:, 0], front[:, 1]),
        "chosen": (np.array([drive["margin"]]), np.array([drive[by]])),
    }
    return {label: (100.0 * np.maximum(x, WORST), y) for label, (x, y) in found.items()}


def _finish(ax: Any, result: Result, name: str, by: str, prices: Array) -> None:
    """Give one joint's panel its axes and its title."""
    sized, drive = result.summary["size"]["joints"][name], result.summary["drives"][name]
    ax.axvline(100.0 * drive["least_margin"], color=style.GREY, linewidth=0.8, linestyle=style.DASHES[1])
    if np.all(prices > 0.0):
        log_axis(ax, 0.8 * float(prices.min()), 1.25 * float(prices.max()))
    ax.set_xlim(100.0 * WORST - 5.0, 105.0)
    ax.set_xticks(
        [100.0 * x for x in TICKS], [f"{'≤ ' if x == WORST else ''}{number(100.0 * x)}" for x in TICKS]
    )
    ax.set_xlabel("margin [%]")
    ax.set_ylabel("cost" if by == "cost" else "mass [kg]")
    count = f"{sized['passing']} of {sized['combinations']} bear it"
    ax.set_title(f"{name}: {drive['motor']}{' + ' + drive['gear'] if drive['gear'] else ''}\n{count}",
                 fontsize=style.FONT_SIZE, loc="left", pad=4)  # fmt: skip

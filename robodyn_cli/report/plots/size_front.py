"""All combinations of motors and gears of each joint: cost or mass over the margin, and what none of them beats."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.ticks import log_axis, number
from robodyn_cli.results.result import Result

MOST = 8  # joints that are drawn
LABELS = ("bears it", "too small", "none is better in both", "chosen")
WORST = -1.0  # margins below are drawn at the edge


def applies(result: Result) -> bool:
    """Tell whether the drives were chosen from a catalogue."""
    return bool(result.group("candidates"))


def draw(result: Result) -> Any:
    """Return the figure."""
    tables = dict(list(result.group("candidates").items())[:MOST])
    by = result.summary["size"]["by"]
    left = len(result.group("candidates")) - len(tables)
    note = f"; {left} further joints left out" if left else ""
    sheet = Sheet(
        result,
        f"Combinations of motor and gear: {by} over the margin of the limit that decides{note}",
        panels=len(tables),
        across=1 if len(tables) == 1 else 2,
        height=2.4,
        gap=0.9,
        titled=True,
        labels=LABELS,
    )
    handles: list[Any] = []
    for ax, (name, variable) in zip(sheet.axes, tables.items()):
        handles = _panel(ax, result, name, variable.data, by)
    sheet.legend(handles, LABELS)
    return sheet.figure


def _panel(ax: Any, result: Result, name: str, data: Any, by: str) -> list[Any]:
    """Draw one joint; return what the legend shows."""
    sized, drive = result.summary["size"]["joints"][name], result.summary["drives"][name]
    price = data[:, {"cost": 2, "mass": 3}[by]]
    margin = np.maximum(data[:, 4], WORST)
    passing = data[:, 4] >= drive["least_margin"]
    known = np.isfinite(margin)
    dots = {"linestyle": "none", "marker": "."}
    good, bad = known & passing, known & ~passing
    handles = ax.plot(100.0 * margin[good], price[good], **dots, color="#000000", markersize=4)
    handles += ax.plot(100.0 * margin[bad], price[bad], **dots, color="#b5b5b5", markersize=3)
    front = [(100.0 * one["margin"], one[by]) for one in sized["front"]]
    handles += ax.plot(
        *(np.array(front).T if front else ([], [])),
        drawstyle="steps-post",
        color=style.COLOURS[0],
        linewidth=1.4,
    )
    mark = {"linestyle": "none", "marker": "o", "markerfacecolor": "none", "markersize": 9}
    handles += ax.plot([100.0 * max(drive["margin"], WORST)], [drive[by]], **mark, color=style.ALARM)
    ax.axvline(100.0 * drive["least_margin"], color=style.GREY, linewidth=0.8, linestyle=style.DASHES[1])
    if np.any(known) and np.all(price[known] > 0.0):
        log_axis(ax, 0.8 * float(price[known].min()), 1.25 * float(price[known].max()))
    ax.set_xlim(100.0 * WORST - 5.0, 105.0)
    ax.set_xlabel("margin [%]")
    ax.set_ylabel("cost" if by == "cost" else "mass [kg]")
    count = f"{number(sized['passing'])} of {number(sized['combinations'])} bear it"
    ax.set_title(f"{name}: {drive['motor']}{' + ' + drive['gear'] if drive['gear'] else ''}\n{count}",
                 fontsize=style.FONT_SIZE, loc="left", pad=4)  # fmt: skip
    return handles

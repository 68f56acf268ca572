"""A search: how its outputs went from each start, and where the values that were found lie between their bounds."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from robodyn_cli.report import numbers, style
from robodyn_cli.report.analysis import axis_label, fit_label, outputs, panels, runs_text
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.registry import plot
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
MOST_STARTS = 24  # whose ways are drawn
BEST: dict[str, Any] = {
    "marker": "o", "markersize": 11.0, "markerfacecolor": "none", "markeredgecolor": style.ALARM,
    "markeredgewidth": 1.8, "linestyle": "none",
}  # fmt: skip


@plot(lambda result: bool(outputs(result)))
def search_path(result: Result) -> Any:
    """The outputs of a search, run by run along the way of each start, with limits, targets and the result."""
    found = outputs(result)
    failed = result["runs/exit_code"] != 0
    best = int(np.flatnonzero(result["runs/best"])[0])
    bounds = {name: _bounds(result, name) for name in found}
    labels = (
        ["start", "result"] + ["limit or target"] * any(bounds.values()) + ["failed run"] * bool(failed.any())
    )
    sheet = panels(
        result, f"Search for {result.summary['goal']}: {runs_text(result)}", list(found), labels=labels
    )
    handles: list[Any] = []
    for ax, (name, y) in zip(sheet.axes, found.items()):
        handles = [_ways(ax, result, y), *ax.plot([best], [y[best]], **BEST)]
        handles += [
            ax.axhline(x, color="#4d4d4d", linestyle=style.DASHES[1], linewidth=1.1) for x in bounds[name]
        ][:1]
        if failed.any():
            handles += ax.plot(np.flatnonzero(failed), np.zeros(int(failed.sum())), linestyle="none", marker="X",
                               clip_on=False, color=style.ALARM, transform=ax.get_xaxis_transform())  # fmt: skip
        ax.set_xlabel("run")
        ax.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        fit_label(ax, "y", axis_label(result, name, "outputs"))
        ax.margins(x=0.03)
    sheet.legend(handles[: len(labels)], labels)
    return sheet.figure


def _ways(ax: Any, result: Result, y: Array) -> Any:
    """Draw an output along the way of each start; return one of the lines."""
    starts = result["runs/start"].astype(int)
    handle = None
    for number in range(min(int(starts.max()) + 1, MOST_STARTS)):
        runs = np.flatnonzero((starts == number) & np.isfinite(y))
        colour = style.COLOURS[number % style.FEW]
        (handle,) = ax.plot(runs, y[runs], color=colour, marker="o", markersize=3.0, linewidth=1.0)
    return handle


def _bounds(result: Result, name: str) -> list[float]:
    """Return the numbers that an output is held to, as they were asked for."""
    summary = result.summary
    target, limit = summary["figures"][name].get("target"), summary["limits"].get(name, {}).get("limit")
    if target is not None:
        return [float(x) for x in NUMBER.findall(target)[:1]]
    return [float(x) for x in NUMBER.findall(limit or "")[:2]]


@plot(lambda result: any("low" in key for key in result.summary["keys"].values()))
def search_keys(result: Result) -> Any:
    """Where the values that a search found lie between their bounds, with their uncertainty, and where it has been."""
    keys = {name: key for name, key in result.summary["keys"].items() if "low" in key}
    labels = ["run that holds", "other run", "result", "how far it may be off"]
    sheet = Sheet(
        result, f"Values found for {result.summary['goal']}, between their bounds", panels=1,
        height=0.5 + 0.34 * len(keys), labels=labels,
    )  # fmt: skip
    ax, holds = sheet.ax, result["runs/holds"] != 0
    handles: list[Any] = []
    for row, (name, key) in enumerate(reversed(keys.items())):
        width = key["high"] - key["low"]
        x = (result[f"inputs/{name}"] - key["low"]) / width
        here, off = (key["value"] - key["low"]) / width, (key["uncertainty"] or 0.0) / width
        looks = ((holds, style.COLOURS[0]), (~holds, style.GREY))
        handles = [ax.plot(x[own], np.full(int(own.sum()), row), linestyle="none", marker="|", markersize=7, color=c)[0]
                   for own, c in looks]  # fmt: skip
        handles += ax.plot([here], [row], **BEST)
        handles += ax.plot(
            np.clip([here - off, here + off], 0.0, 1.0), [row, row], color=style.ALARM, linewidth=2.4
        )
        text = f"{name} = {numbers.number(key['value'], 6)}" + (
            f" {key['unit']}" if key["unit"] not in ("", "1") else ""
        )
        ends = key.get("bounds", f"{numbers.number(key['low'], 4)} .. {numbers.number(key['high'], 4)}")
        ax.text(0.0, row + 0.2, text, fontsize=7.5, va="bottom")
        ax.text(1.0, row + 0.2, ends, fontsize=7.5, va="bottom", ha="right", color=style.GREY)
    ax.set_yticks([])
    ax.set_ylim(-0.5, len(keys) - 0.2)
    ax.set_xlim(-0.03, 1.03)
    ax.set_xlabel("place between lower and upper bound")
    sheet.legend(handles, labels)
    return sheet.figure

"""The stability suite as one picture: cases by methods, status as colour and mark, error in figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from robodyn_cli.report.analysis import STATUS
from robodyn_cli.report.style import GREY
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LIGHT = {
    "stable": "#CDEBE0",
    "inaccurate": "#F8E0AE",
    "diverged": "#F2C3A5",
    "too_slow": "#D3EBF8",
    "unsupported": "#EDEDED",
}


def applies(result: Result) -> bool:
    """Tell whether the suite was run, not a scene."""
    return "cases" in result.summary


def words(trial: Mapping[str, Any]) -> str:
    """Return what a cell says: the error, or what kept the method from one."""
    if trial["relative"] == 0.0:
        return "0"
    if trial["relative"] is not None:
        return (
            f"{trial['relative']:.0e}".replace("e-0", "e-")
            .replace("e+0", "e")
            .replace("e+", "e")
            .replace("-", "−")
        )
    if trial["status"] == "stable":
        return "stops" if trial["failure"] else "ran"
    return {"diverged": "diverges", "too_slow": "too slow", "unsupported": "cannot"}.get(
        trial["status"], trial["status"]
    )


def draw(result: Result) -> Figure:
    """Return the figure."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    cases, methods = result.summary["cases"], result.summary["methods"]
    left, high = 2.05, 0.27
    wide = 0.82 if len(methods) <= 12 else 0.6
    slanted = len(methods) > 8
    right = 0.055 * len(methods[-1]) - 0.5 * wide if slanted else 0.0  # what of the last name stands out
    width, height = (
        left + wide * len(methods) + max(0.45, right),
        1.15 + (0.55 if slanted else 0.0) + high * len(cases) + 0.5,
    )
    figure = Figure(figsize=(width, height), dpi=120)
    kept = len(cases) - result.summary["missed"]
    figure.text(
        0.1 / width, 1 - 0.24 / height, result.summary["title"], fontsize=11, fontweight="bold", va="center"
    )
    figure.text(
        0.1 / width,
        1 - 0.47 / height,
        f"{kept} of {len(cases)} cases as expected; figures: largest error over the range of its quantity",
        color=GREY,
        va="center",
    )
    box = (left / width, 0.5 / height, wide * len(methods) / width, high * len(cases) / height)
    ax = figure.add_axes(box)
    ax.set_xlim(0, len(methods))
    ax.set_ylim(len(cases), 0)
    for row, case in enumerate(cases):
        for column, name in enumerate(methods):
            if name in case["methods"]:
                _cell(ax, row, column, case["methods"][name], 8 if wide > 0.7 else 7)
    ax.set_xticks(
        [k + 0.5 for k in range(len(methods))],
        methods,
        rotation=40 if slanted else 0,
        fontsize=8,
        ha="left" if slanted else "center",
    )
    ax.xaxis.tick_top()
    marks = ["" if case["holds"] else "  MISSED" for case in cases]
    ax.set_yticks(
        [k + 0.5 for k in range(len(cases))], [c["name"] + m for c, m in zip(cases, marks)], fontsize=8
    )
    ax.tick_params(length=0)
    ax.grid(False)
    for side in ax.spines.values():
        side.set_visible(False)
    handles = [Patch(facecolor=LIGHT[s], label=s.replace("_", " ")) for s in STATUS]
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.02, 0.0), ncols=5)
    return figure


def _cell(ax: Axes, row: int, column: int, trial: Mapping[str, Any], size: int) -> None:
    """Draw what a method made of a case."""
    from matplotlib.patches import Rectangle

    status = trial["status"]
    ax.add_patch(Rectangle((column, row), 1, 1, facecolor=LIGHT[status], edgecolor="white", linewidth=1.5))
    dark = "black" if status != "unsupported" else GREY
    mark = "" if status != "inaccurate" else " !"
    ax.text(
        column + 0.5, row + 0.52, words(trial) + mark, ha="center", va="center", fontsize=size, color=dark
    )

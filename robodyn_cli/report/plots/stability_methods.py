"""Error of each method at its default settings as a bar, with its status in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robodyn_cli.report.analysis import LEAST, STATUS, powers, titled
from robodyn_cli.report.canvas import CHARACTER
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def applies(result: Result) -> bool:
    """Tell whether methods were tried on a scene."""
    return bool(result.summary["methods"]) and "cases" not in result.summary


def draw(result: Result) -> Figure:
    """Return the figure."""
    rows = result.summary["methods"]
    height = 1.3 + 0.32 * len(rows)
    ref = result.summary["reference"]
    told = (
        f"against {ref['methods'][0]} and {ref['methods'][1]}, which agree to {ref['digits']:.1f} digits up to t = "
        f"{ref['until']:.4g} s"
        if ref
        else "no reference: no two methods get through at tight tolerance"
    )
    left, wide = 0.25 + CHARACTER * max(len(row["method"]) for row in rows), 3.95
    width = left + wide + 2.75  # the last for the words
    figure = titled(width, height, result, told)
    ax = figure.add_axes((left / width, 0.52 / height, wide / width, 0.32 * len(rows) / height))
    for k, row in enumerate(rows):
        colour, hatch = STATUS[row["status"]]
        value = row["relative"]
        if value is not None:
            ax.barh(k, max(value, LEAST), left=0, color=colour, hatch=hatch, edgecolor="white", height=0.68)
        note = row["status"].replace("_", " ")
        if row["method"] == "auto" and row["chosen"]:
            note += f" ({row['chosen']})"
        elif value is None and row["until"] > 0.0:
            note += f", to t = {row['until']:.3g} s"
        elif row["honest"] is False:
            note += ", and its estimate hides it"
        ax.text(1.02, k, note, transform=ax.get_yaxis_transform(), va="center", color="black", fontsize=8.5)
    ax.axvline(1e-3, color="#D55E00", linewidth=1.0, linestyle="--")
    largest = max((r["relative"] for r in rows if r["relative"] is not None), default=1.0)
    ax.set_xscale("log")
    ax.set_xlim(LEAST, max(10.0, 3 * largest))
    powers(ax, "x")
    ax.set_yticks(range(len(rows)), [r["method"] for r in rows])
    ax.set_ylim(len(rows) - 0.45, -0.55)
    ax.grid(False, axis="y")
    ax.set_xlabel("largest error over the range of its quantity; beyond the dashed line: inaccurate")
    return figure

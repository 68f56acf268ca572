"""All the ways in which a mechanism closes, or an arm reaches a pose, one over the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import drawing_of
from robodyn_cli.report.drawing.camera import View, default_camera
from robodyn_cli.report.drawing.record import Stroke
from robodyn_cli.report.drawing.strokes import silhouette
from robodyn_cli.results.result import Result

WIDTHS = {1: 5.9, 2: 2.6}  # of a panel [inch]
OTHERS = "#cccccc"


def applies(result: Result) -> bool:
    """Tell whether branches were found."""
    return "branches/q" in result and len(result["branches/q"]) > 0


def draw(result: Result) -> Any:
    """Return the figure: a panel a branch, with the others faintly behind it."""
    q = result["branches/q"]
    count, shown = len(q), min(len(q), style.FEW)
    drawing = drawing_of(result, np.zeros(shown), q[:shown])
    view = View(drawing, default_camera(drawing))
    across = min(shown, 2)
    height = paper.height_of(view, WIDTHS[across], 1.6)
    sheet = Sheet(
        result,
        _subtitle(view, "frame" in result.summary, count, shown),
        panels=shown,
        across=across,
        height=height,
        gap=0.45,
    )
    others = [Stroke(line, OTHERS, 1.0) for k in range(shown) for line in silhouette(view, k)]
    for k, ax in enumerate(sheet.axes):
        paper.set_up(ax, view)
        paper.put(ax, view, k, others, grid=not view.flat)
        ax.set_title(_name(result, k), fontsize=style.FONT_SIZE, loc="left", pad=3)
        if k % across:
            ax.set_ylabel("")
        if k + across < shown:
            ax.set_xlabel("")
    return sheet.figure


def _subtitle(view: View, posed: bool, count: int, shown: int) -> str:
    more = f", {shown} of them drawn" if shown < count else ""
    plural = "es" if count != 1 else ""
    of = "that reach the pose" if posed else "of the closed loops"
    return f"{count} branch{plural} {of} {paper.where(view)}{more}"


def _name(result: Result, k: int) -> str:
    """Return what stands above a panel: number, orientation, whether the assembly chose it."""
    listed = [x for x in result.summary.get("branches") or [] if x.get("reached", True)]
    facts: dict[str, Any] = listed[k] if k < len(listed) else {}
    sign = {1: ", orientation +", -1: ", orientation \u2212"}.get(facts.get("orientation", 0), "")
    name = facts.get("name", "")
    label = f"branch {k + 1}" if not name or name.isdigit() else name.replace("_", " ").replace("-", ", ")
    return f"{label}{sign}" + (", chosen" if facts.get("chosen") else "")

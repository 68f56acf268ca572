"""The modes of a mechanism: the pose, and how far each mode swings to both sides."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import can_draw, drawing_of
from robodyn_cli.report.drawing.camera import View, default_camera
from robodyn_cli.report.drawing.paper import Painted
from robodyn_cli.report.drawing.record import Stroke
from robodyn_cli.report.drawing.strokes import silhouette
from robodyn_cli.results.result import Result

WIDTHS = {1: 5.9, 2: 2.6}  # of a panel [inch]
SIDES = ("#E69F00", "#56B4E9")


def applies(result: Result) -> bool:
    """Tell whether there are modes of a mechanism that can be drawn."""
    return "modes/q" in result and can_draw(result)


def draw(result: Result) -> Any:
    """Return the figure: a panel a mode."""
    swung = result["modes/q"]
    count, shown = len(swung), min(len(swung), style.FEW)
    q = np.concatenate([result["q"][:1], swung[:shown].reshape(-1, swung.shape[2])])
    drawing = drawing_of(result, np.zeros(len(q)), q)
    view = View(drawing, default_camera(drawing))
    across = min(shown, 2)
    more = f", {shown} of them drawn" if shown < count else ""
    text = f"{count} mode{'s' if count != 1 else ''} {paper.where(view)}{more}; swings are drawn large"
    height = paper.height_of(view, WIDTHS[across], 1.6)
    sheet = Sheet(result, text, panels=shown, across=across, height=height, gap=0.45, titled=True)
    for k, ax in enumerate(sheet.axes):
        paper.set_up(ax, view)
        lines = [(SIDES[j], silhouette(view, 1 + 2 * k + j)) for j in range(2)]
        swings = [Stroke(line, colour, 1.6) for colour, of_side in lines for line in of_side]
        paper.put(ax, view, 0, grid=not view.flat)
        ax.add_artist(Painted(swings)).set_zorder(5)  # in front of what would hide them
        ax.set_title(_name(result.summary["modes"][k]), fontsize=style.FONT_SIZE, loc="left", pad=3)
        if k % across:
            ax.set_ylabel("")
        if k + across < shown:
            ax.set_xlabel("")
    return sheet.figure


def _name(mode: dict[str, Any]) -> str:
    """Return what stands above a panel."""
    if mode["imaginary"]:
        return f"{mode['frequency']:.4g} Hz, damping {mode['damping']:.3g}"
    if not mode["real"]:
        return "free, without restoring force"
    return f"{'grows' if mode['real'] > 0 else 'decays'} e times in {mode['time']:.3g} s"

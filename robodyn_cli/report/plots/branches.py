"""All the ways in which a mechanism closes, one over the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.decimate import finite
from robodyn_cli.report.plane import AXES, box_height, main_plane
from robodyn_cli.results.result import Result


def applies(result: Result) -> bool:
    """Tell whether branches were found."""
    return bool(result.group("branch_skeleton"))


def draw(result: Result) -> Any:
    """Return the figure: a panel a branch, with the others faintly behind it."""
    links = {name: finite(item.data) for name, item in result.group("branch_skeleton").items()}
    plane = list(main_plane([data.reshape(1, -1, 3) for data in links.values()]))
    flat = {name: data[:, :, plane] for name, data in links.items()}
    count = len(next(iter(flat.values())))
    shown = min(count, style.FEW)
    everything = np.concatenate([data[:shown].reshape(-1, 2) for data in flat.values()])
    more = f", {shown} of them drawn" if shown < count else ""
    plural = "es" if count != 1 else ""
    subtitle = (
        f"{count} branch{plural} of the closed loops in the {AXES[plane[0]]}-{AXES[plane[1]]} plane{more}"
    )
    across = min(shown, 2)
    height = box_height(everything) * (0.62 if across == 2 else 1.0)
    sheet = Sheet(result, subtitle, panels=shown, across=across, height=height, gap=0.45)
    for k, ax in enumerate(sheet.axes):
        for other in range(shown):
            for data in flat.values():
                if other != k:
                    ax.plot(*data[other].T, color="#d0d0d0", linewidth=1.0, zorder=1)
        for data in flat.values():
            ax.plot(*data[k].T, color=style.COLOURS[0], linewidth=2.0, zorder=2, solid_capstyle="round")
            ax.plot(*data[k].T, "o", color="white", markeredgecolor="black", markersize=3.5, zorder=3)
        ax.set_title(_name(result, k), fontsize=style.FONT_SIZE, loc="left", pad=3)
        ax.set_aspect("equal", adjustable="datalim")
        ax.margins(0.08)
        if k % across == 0:
            ax.set_ylabel(f"{AXES[plane[1]]} [m]")
        if k + across >= shown:
            ax.set_xlabel(f"{AXES[plane[0]]} [m]")
    return sheet.figure


def _name(result: Result, k: int) -> str:
    """Return what stands above a panel: number, orientation, whether the assembly chose it."""
    listed = result.summary.get("branches") or []
    facts: dict[str, Any] = listed[k] if k < len(listed) else {}
    sign = {1: ", orientation +", -1: ", orientation \u2212"}.get(facts.get("orientation", 0), "")
    return f"branch {k + 1}{sign}" + (", chosen" if facts.get("chosen") else "")

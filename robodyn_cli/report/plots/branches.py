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
    """Return the figure: the branch that was chosen heavy, the others told apart by colour and dash."""
    links = {name: finite(item.data) for name, item in result.group("branch_skeleton").items()}
    plane = list(main_plane([data.reshape(1, -1, 3) for data in links.values()]))
    flat = {name: data[:, :, plane] for name, data in links.items()}
    count = len(next(iter(flat.values())))
    shown = min(count, style.FEW)
    labels = [f"branch {k + 1}" + (" (chosen)" if k == 0 else "") for k in range(shown)]
    everything = np.concatenate([data[:shown].reshape(-1, 2) for data in flat.values()])
    more = f", {shown} of them drawn" if shown < count else ""
    subtitle = f"{count} branch{'es' if count != 1 else ''} of the closed loops{more}"
    sheet = Sheet(result, subtitle, labels=labels, height=box_height(everything))
    ax = sheet.ax
    handles = []
    for k, look in enumerate(style.line_styles(shown)):
        width = 2.8 if k == 0 else 1.6
        line: Any = None
        for data in flat.values():
            (line,) = ax.plot(*data[k].T, **{**look, "linewidth": width})
        handles.append(line)
    still = [
        data[0, corner]
        for data in flat.values()
        for corner in range(data.shape[1])
        if np.allclose(data[:, corner], data[0, corner], atol=1e-9)
    ]
    if still and count > 1:
        look = {"color": "white", "markeredgecolor": "black", "markeredgewidth": 1.4, "linestyle": "none"}
        ax.plot(*np.array(still).T, marker="^", markersize=10, zorder=5, **look)
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.08)
    ax.set_xlabel(f"{AXES[plane[0]]} [m]")
    ax.set_ylabel(f"{AXES[plane[1]]} [m]")
    sheet.legend(handles, labels)
    return sheet.figure

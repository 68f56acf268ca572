"""How well the loops stay closed: position and velocity residuals on a logarithmic axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite, largest
from robodyn_cli.report.lines import draw_columns, draw_magnitudes, panel_height, quiet_axis
from robodyn_cli.report.ticks import labelled, log_axis, number, positive_floor, unit
from robodyn_cli.results.result import Result

KINDS = {"position_residual": "position", "velocity_residual": "velocity"}


def applies(result: Result) -> bool:
    """Tell whether there are residuals."""
    return any(_has(result, kind) for kind in KINDS)


def draw(result: Result) -> Any:
    """Return the figure: a panel for positions and one for velocities, which have different units."""
    kinds = {kind: word for kind, word in KINDS.items() if _has(result, kind)}
    sheet = TimeSheet(
        result,
        f"Residuals of the loop closures, the largest of all closures; {_worst(result, kinds)}",
        panels=len(kinds),
        height=panel_height(len(kinds)),
    )
    for ax, (kind, word) in zip(sheet.axes, kinds.items()):
        size = np.max(np.abs(finite(result[f"constraints/{kind}"])), axis=1)
        ax.set_ylabel(labelled(word, result.variables[f"constraints/{kind}"].units))
        if not np.any(size):
            draw_columns(ax, result.time, size[:, None])
            quiet_axis(ax, size, magnitudes=True)
            continue
        low, high = positive_floor(size)
        # Roundings that happen to cancel reach down without end.
        low = max(low, high * 1e-6)
        draw_magnitudes(ax, result.time, size[:, None], low)
        log_axis(ax, low, high)
    sheet.label_time()
    sheet.legend([], [])
    return sheet.figure


def _has(result: Result, kind: str) -> bool:
    path = f"constraints/{kind}"
    return path in result and result[path].size > 0


def _worst(result: Result, kinds: dict[str, str]) -> str:
    """Return the largest residuals in words."""
    found = []
    for kind, word in kinds.items():
        variable = result.variables[f"constraints/{kind}"]
        found.append(f"{word} {number(largest(np.abs(finite(variable.data))))} {unit(variable.units)}")
    return ", ".join(found)

"""Limits of joints as lines in drawings over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.report.decimate import finite
from robodyn_cli.results.catalogue import JOINT_LIMITS
from robodyn_cli.results.columns import column_names
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NEAR = 0.3  # of the largest value of a joint: a limit further away would only make the curve small
NOTE = "; dotted: limits of the joints"


def limits_near(result: Result, path: str) -> dict[str, list[float]]:
    """Return the limits that the columns of a dataset come near or pass, by the names of the columns."""
    variable = result.variables[path]
    names = column_names(variable)
    found: dict[str, list[float]] = {}
    for limit, sides in JOINT_LIMITS.get(path, {}).items():
        stored = result.variables.get(f"joint_limits/{limit}")
        for name, size in zip(column_names(stored), stored.data) if stored is not None else ():
            values = finite(variable.data[:, names.index(name)])
            bottom, top = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
            room = NEAR * max(abs(bottom), abs(top))
            levels = [side * size for side in sides if bottom - room <= side * size <= top + room]
            if levels:
                found.setdefault(name, []).extend(levels)
    return found


def draw_limits(ax: Axes, near: dict[str, list[float]], names: Sequence[str], handles: Sequence[Any]) -> None:
    """Draw the limits of joints in the colours of their curves."""
    for name, handle in zip(names, handles):
        for level in near.get(name, ()):
            ax.axhline(level, color=handle.get_color(), linewidth=1.3, linestyle=(0, (1, 1.5)), zorder=1.5)

"""Many columns over time as a map: one row a column, lightness for the value."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite
from robodyn_cli.report.ticks import labelled
from robodyn_cli.results.columns import by_unit, column_names
from robodyn_cli.results.result import Result, Variable
from robodyn_cli.spatial.algebra import Array

# More instants than pixels add nothing.
INSTANTS = 800
ROWS = 400


def draw_map(result: Result, variable: Variable, quantity: str, subtitle: str) -> Any:
    """Return a figure of a variable (T, n) with columns upwards and time to the right, a map for each unit."""
    names, groups = column_names(variable), by_unit(variable)
    sheet = TimeSheet(
        result,
        f"{subtitle}; {len(names)} columns, one row each",
        panels=len(groups),
        height=3.3 if len(groups) == 1 else 2.2,
        bars=True,
    )
    for ax, bar, (units, columns) in zip(sheet.axes, sheet.bars, groups.items()):
        drawn = _map(ax, result.time, variable.data[:, columns], [names[k] for k in columns])
        sheet.figure.colorbar(drawn, cax=bar).set_label(labelled(quantity, units))
    sheet.label_time()
    sheet.legend([], [])
    return sheet.figure


def _map(ax: Axes, time: Array, data: Array, names: list[str]) -> AxesImage:
    """Draw one map."""
    rows = _spread(len(names), ROWS)
    image = finite(data)[np.ix_(_spread(len(time), INSTANTS), rows)].T
    half = 0.5 if len(time) == 1 else 0.0
    extent = (time[0] - half, time[-1] + half, 0.5, len(names) + 0.5)
    # Lightness grows with the value, so a grey print keeps the order.
    drawn = ax.imshow(
        image, aspect="auto", origin="lower", extent=extent, cmap="cividis", interpolation="nearest"
    )
    ax.grid(False)
    marks = sorted({round(1 + index * (len(names) - 1) / 8) for index in range(9)})
    ax.set_yticks(marks, [_short(names[mark - 1]) for mark in marks])
    return drawn


def _spread(count: int, most: int) -> Any:
    """Return at most ``most`` indices evenly over ``count``."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _short(name: str) -> str:
    return name if len(name) <= 9 else name[:4] + "…" + name[-4:]

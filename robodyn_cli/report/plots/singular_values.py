"""Singular values of the constraint Jacobian and of its passive block: dead points and bifurcations."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite, largest
from robodyn_cli.report.lines import draw_columns
from robodyn_cli.report.ticks import log_axis, number, positive_floor
from robodyn_cli.results.result import Result

KINDS = {"psi": ("Ψ", style.COLOURS[0], "-"), "passive": ("passive block", style.ALARM, style.DASHES[1])}
# Between the largest and the smallest of many singular values there is little to see.
MOST = 6


def applies(result: Result) -> bool:
    """Tell whether there are singular values."""
    return any(f"singularity/{kind}" in result and result[f"singularity/{kind}"].size for kind in KINDS)


def draw(result: Result) -> Any:
    """Return the figure."""
    columns: list[Any] = []
    styles: list[dict[str, Any]] = []
    labels: list[str] = []
    smallest = []
    for kind, (word, colour, dash) in KINDS.items():
        path = f"singularity/{kind}"
        if path not in result or not result[path].size:
            continue
        data = np.sort(finite(result[path]), axis=1)[:, :MOST]
        columns += [data[:, column] for column in range(data.shape[1])]
        # The smallest one decides; the others fade.
        styles += [
            {"color": colour, "linestyle": dash, "linewidth": 1.8 if column == 0 else 0.9}
            for column in range(data.shape[1])
        ]
        labels.append(f"{word}: smallest {number(-largest(-data))}")
        smallest.append(len(columns) - data.shape[1])
    sheet = TimeSheet(
        result,
        "Singular values of the constraint Jacobian; the smallest of each drawn heavier",
        labels=labels,
    )
    ax = sheet.ax
    values = np.column_stack(columns)
    low, high = positive_floor(values)
    # Where one vanishes, how deep a sample happens to fall says nothing.
    low = max(low, high * 1e-6)
    handles = draw_columns(ax, result.time, np.maximum(values, low), styles)
    log_axis(ax, low, high)
    sheet.label_time()
    ax.set_ylabel("singular value [1]")
    sheet.legend([handles[index] for index in smallest], labels)
    return sheet.figure

"""The outputs of a study over a grid of two keys, as maps."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.analysis import axis_label, inputs, outputs, panels, runs_text
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array


def applies(result: Result) -> bool:
    """Tell whether two keys vary over a grid, each with three values or more."""
    keys = inputs(result)
    return "sampler" not in result.summary and len(keys) == 2 and bool(outputs(result)) and all(
        len(np.unique(x)) > 2 for x in keys.values()
    )  # fmt: skip


def draw(result: Result) -> Any:
    """Return the figure."""
    (first, x), (second, y) = inputs(result).items()
    found = outputs(result)
    failed = "; white: failed" if np.any(result["runs/exit_code"] != 0) else ""
    subtitle = f"Outputs over {first} and {second}: {runs_text(result)}{failed}"
    sheet = panels(result, subtitle, list(found), across=1)
    for ax, (name, z) in zip(sheet.axes, found.items()):
        columns, rows = np.unique(x), np.unique(y)
        grid = np.full((len(rows), len(columns)), np.nan)
        grid[np.searchsorted(rows, y), np.searchsorted(columns, x)] = z
        # lightness grows with the value, so a grey print keeps the order
        drawn = ax.pcolormesh(_edges(columns), _edges(rows), grid, cmap="cividis")
        ax.grid(False)
        ax.set_xlabel(axis_label(result, first))
        ax.set_ylabel(axis_label(result, second))
        sheet.figure.colorbar(drawn, ax=ax).set_label(axis_label(result, name, "outputs"))
    return sheet.figure


def _edges(centres: Array) -> Array:
    """Return the borders of cells around values: half way between them."""
    middle = (centres[1:] + centres[:-1]) / 2.0
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])

"""Which keys of a study move an output most (tornado), with Sobol's indices where they are known."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.analysis import axis_label, outputs, runs_text, tornado
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.results.result import Result

MOST_KEYS = 12


def applies(result: Result) -> bool:
    """Tell whether several keys vary."""
    return any(len(found) > 1 for found in result.summary.get("influence", {}).values())


def draw(result: Result) -> Any:
    """Return the figure."""
    influence = {name: found for name, found in result.summary["influence"].items()
                 if found and name in outputs(result)}  # fmt: skip
    indices = result.summary.get("sobol_indices") or {}
    across = 2 if indices else 1
    rows = max(min(len(found), MOST_KEYS) for found in influence.values())
    labels = ["alone", "with interactions"] if indices else []
    sheet = Sheet(
        result,
        f"Change of an output from the 5 % to the 95 % quantile of a key (linear fit), {runs_text(result)}",
        panels=across * len(influence), across=across, height=0.5 + 0.24 * rows, gap=0.66, labels=labels,
    )  # fmt: skip
    handles: list[Any] = []
    for place, (name, found) in enumerate(influence.items()):
        keys = list(found)[:MOST_KEYS]
        label = f"change of {axis_label(result, name, 'outputs')}"
        tornado(sheet.axes[across * place], label, {key: found[key]["swing"] for key in keys})
        if indices.get(name):
            handles = _bars(sheet.axes[across * place + 1], indices[name], keys)
    if handles:
        sheet.legend(handles, labels)
    return sheet.figure


def _bars(ax: Any, indices: dict[str, Any], keys: list[str]) -> list[Any]:
    """Draw first and total indices with their confidence intervals."""
    y = np.arange(len(keys))[::-1]
    handles = []
    for order, shift, colour in (("first", 0.2, style.COLOURS[0]), ("total", -0.2, style.COLOURS[1])):
        values = np.array([indices[key][order] for key in keys])
        sides = [[values[k] - indices[key][f"{order}_low"], indices[key][f"{order}_high"] - values[k]]
                 for k, key in enumerate(keys)]  # fmt: skip
        spans = np.clip(np.array(sides).T, 0.0, None)
        handles.append(ax.barh(y + shift, values, height=0.34, color=colour, xerr=spans, ecolor="#4d4d4d"))
    ax.set_yticks([])  # the rows are those of the panel beside
    ax.set_ylim(-0.5, len(keys) - 0.3)
    ax.set_xlim(left=0.0)
    ax.set_xlabel("share of the variance (Sobol index)")
    return handles

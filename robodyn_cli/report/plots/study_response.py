"""The outputs of a study over one key: a curve for a grid, points for samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.analysis import axis_label, inputs, outputs, panels, runs_text
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array


def applies(result: Result) -> bool:
    """Tell whether one key varies."""
    return len(inputs(result)) == 1 and bool(outputs(result))


def draw(result: Result) -> Any:
    """Return the figure."""
    ((key, x),) = inputs(result).items()
    found = outputs(result)
    failed = result["runs/exit_code"] != 0
    labels = ["run", "failed run"] if np.any(failed) else []
    sheet = panels(result, f"Outputs over {key}: {runs_text(result)}", list(found), labels=labels)
    handles: list[Any] = []
    for ax, (name, y) in zip(sheet.axes, found.items()):
        handles = _curve(ax, x, y, failed, is_curve="sampler" not in result.summary)
        ax.set_xlabel(axis_label(result, key))
        ax.set_ylabel(axis_label(result, name, "outputs"))
        ax.ticklabel_format(axis="y", useOffset=False)
        if _is_logarithmic(x):
            ax.set_xscale("log")
        ax.margins(x=0.03)
    sheet.legend(handles, labels)
    return sheet.figure


def _curve(ax: Any, x: Array, y: Array, failed: Array, is_curve: bool) -> list[Any]:
    """Draw one output; return the handles of runs and of failed runs."""
    order = np.argsort(x)
    look: dict[str, Any] = {
        "color": style.COLOURS[0],
        "marker": "o",
        "markersize": 3.0 if len(x) > 60 else 4.5,
    }
    handles = ax.plot(x[order], y[order], linestyle="-" if is_curve else "none", **look)
    if np.any(failed):
        # at the foot of the panel, for a run that failed may have no value
        (marks,) = ax.plot(x[failed], np.zeros(int(failed.sum())), linestyle="none", marker="X", clip_on=False,
                           color=style.ALARM, transform=ax.get_xaxis_transform())  # fmt: skip
        handles.append(marks)
    return list(handles)


def _is_logarithmic(x: Array) -> bool:
    """Tell whether the values are spread over their ratios rather than over their differences."""
    steps = np.unique(x)
    if len(steps) < 3 or steps[0] <= 0.0 or steps[-1] / steps[0] < 20.0:
        return False
    ratios = np.diff(np.log(steps))
    return bool(np.ptp(ratios) < 1e-6 * ratios.max())

"""How the outputs of a study of samples spread, with their quantiles and the scene as it stands."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.analysis import axis_label, outputs, panels, runs_text
from robodyn_cli.results.result import Result

FEWEST = 20  # values below which a histogram says nothing


def applies(result: Result) -> bool:
    """Tell whether there are samples of an output that varies."""
    found = outputs(result)
    return "sampler" in result.summary and any(np.isfinite(x).sum() >= FEWEST for x in found.values())


def draw(result: Result) -> Any:
    """Return the figure."""
    found = outputs(result)
    labels = ["5 %, 50 %, 95 %", "the scene as it stands"]
    sheet = panels(result, f"Spread of the outputs over {runs_text(result)}", list(found), labels=labels)
    handles: list[Any] = []
    for ax, (name, data) in zip(sheet.axes, found.items()):
        there = data[np.isfinite(data)]
        if np.ptp(there) > 0.0:
            ax.hist(there, bins=_bins(len(there)), color=style.COLOURS[5], edgecolor="white", linewidth=0.4)
        else:
            ax.hist(there, bins=1, color=style.COLOURS[5])
        lines = [ax.axvline(x, color=style.COLOURS[2], linestyle=style.DASHES[2], linewidth=1.2)
                 for x in np.quantile(there, (0.05, 0.5, 0.95))]  # fmt: skip
        nominal = (result.summary["results"].get(name) or {}).get("nominal")
        handles = [lines[0]]
        if nominal is not None:
            handles.append(ax.axvline(nominal, color=style.ALARM, linestyle=style.DASHES[1], linewidth=1.4))
        ax.set_xlabel(axis_label(result, name, "outputs"))
        ax.set_ylabel("runs")
        ax.ticklabel_format(axis="x", useOffset=False)
        ax.locator_params(axis="x", nbins=5)
    sheet.legend(handles, labels[: len(handles)])
    return sheet.figure


def _bins(count: int) -> int:
    return int(np.clip(round(2.0 * count ** (1.0 / 3.0)), 8, 80))

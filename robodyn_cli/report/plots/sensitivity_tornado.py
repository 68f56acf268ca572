"""Which keys move an output most: normalised derivatives as bars, the longest on top."""

from __future__ import annotations

from typing import Any

from robodyn_cli.report.analysis import MOST_PANELS, tornado
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.results.result import Result

MOST_KEYS = 16


def applies(result: Result) -> bool:
    """Tell whether any output has a normalised derivative."""
    return bool(_bars(result))


def draw(result: Result) -> Any:
    """Return the figure."""
    bars = _bars(result)
    across = 1 if len(bars) == 1 else 2
    rows = max(len(found) for found in bars.values())
    starred = any(key.endswith(" *") for found in bars.values() for key in found)
    sheet = Sheet(
        result,
        f"Part by which an output of {result.summary['of']} changes, over the part by which a key does"
        + ("; * by differences" if starred else ""),
        panels=len(bars), across=across, height=0.5 + 0.24 * rows, gap=0.66,
    )  # fmt: skip
    for ax, (name, found) in zip(sheet.axes, bars.items()):
        tornado(ax, f"(key / y) dy/dkey, y = {name}", found, figures=True)
    return sheet.figure


def _bars(result: Result) -> dict[str, dict[str, float]]:
    """Return the normalised derivatives of each output, by key."""
    found: dict[str, dict[str, float]] = {}
    for name, slopes in list(result.summary["sensitivities"].items())[:MOST_PANELS]:
        own = {
            key if slope["method"] == "exact" else f"{key} *": slope["normalised"]
            for key, slope in slopes.items()
            if slope["normalised"] is not None
        }
        if any(own.values()):
            found[name] = dict(list(own.items())[:MOST_KEYS])
    return found

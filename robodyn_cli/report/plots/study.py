"""Studies and sensitivities: how outputs follow keys, spread, and depend on them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from robodyn_cli.report import style
from robodyn_cli.report.analysis import (
    MOST_PANELS,
    axis_label,
    fit_label,
    inputs,
    outputs,
    panels,
    runs_text,
    tornado,
)
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.registry import plot
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array


@plot(lambda result: len(inputs(result)) == 1 and bool(outputs(result)))
def study_response(result: Result) -> Any:
    """The outputs of a study over one key: a curve for a grid, points for samples."""
    ((key, x),) = inputs(result).items()
    found = outputs(result)
    failed = result["runs/exit_code"] != 0
    labels = ["run", "failed run"] if np.any(failed) else []
    sheet = panels(result, f"Outputs over {key}: {runs_text(result)}", list(found), labels=labels)
    handles: list[Any] = []
    for ax, (name, y) in zip(sheet.axes, found.items()):
        handles = _curve(ax, x, y, failed, is_curve="sampler" not in result.summary)
        _widen(ax, y, result[f"errors/{name}"] if f"errors/{name}" in result else np.zeros(1))
        # the title has the whole key, which panels side by side have no room for
        fit_label(ax, "x", axis_label(result, key, short=len(found) > 1))
        fit_label(ax, "y", axis_label(result, name, "outputs"))
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


def _widen(ax: Any, y: Array, errors: Array) -> None:
    """Give the axis of an output that varies by no more than its errors and rounding the size of its values."""
    values, errors = y[np.isfinite(y)], errors[np.isfinite(errors)]
    size = float(np.abs(values).max(initial=0.0))
    least = max(2.0 * float(errors.max(initial=0.0)), ROUNDING * size)
    if values.size and float(np.ptp(values)) <= least:
        middle = 0.5 * float(values.max() + values.min())
        ax.set_ylim(middle - (0.1 * size or 1.0), middle + (0.1 * size or 1.0))


def _is_logarithmic(x: Array) -> bool:
    """Tell whether the values are spread over their ratios rather than over their differences."""
    steps = np.unique(x)
    if len(steps) < 3 or steps[0] <= 0.0 or steps[-1] / steps[0] < 20.0:
        return False
    ratios = np.diff(np.log(steps))
    return bool(np.ptp(ratios) < 1e-6 * ratios.max())


def _has_study_map(result: Result) -> bool:
    """Tell whether two keys vary over a grid."""
    return "sampler" not in result.summary and len(inputs(result)) == 2 and bool(outputs(result))


@plot(_has_study_map)
def study_map(result: Result) -> Any:
    """The outputs of a study over a grid of two keys, as maps."""
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
        fit_label(ax, "x", axis_label(result, first))
        fit_label(ax, "y", axis_label(result, second))
        sheet.figure.colorbar(drawn, ax=ax).set_label(axis_label(result, name, "outputs"))
    return sheet.figure


def _edges(centres: Array) -> Array:
    """Return the borders of cells around values: half way between them."""
    middle = (centres[1:] + centres[:-1]) / 2.0
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])


FEWEST = 20  # values below which a histogram says nothing
ROUNDING = 1e-12  # of values, by which they differ by rounding alone: they fill one bin


def _has_study_histograms(result: Result) -> bool:
    """Tell whether there are samples of an output that varies."""
    found = outputs(result)
    return "sampler" in result.summary and any(np.isfinite(x).sum() >= FEWEST for x in found.values())


@plot(_has_study_histograms)
def study_histograms(result: Result) -> Any:
    """How the outputs of a study of samples spread, with their quantiles and the scene as it stands."""
    found = outputs(result)
    labels = ["5 %, 50 %, 95 %", "the scene as it stands"]
    sheet = panels(result, f"Spread of the outputs over {runs_text(result)}", list(found), labels=labels)
    handles: list[Any] = []
    for ax, (name, data) in zip(sheet.axes, found.items()):
        there = data[np.isfinite(data)]
        if np.ptp(there) > ROUNDING * np.abs(there).max():
            ax.hist(there, bins=_bins(len(there)), color=style.COLOURS[5], edgecolor="white", linewidth=0.4)
        else:
            ax.hist(there, bins=1, color=style.COLOURS[5])
        lines = [ax.axvline(x, color=style.BLACK, linestyle=style.DASHES[2], linewidth=1.2)
                 for x in np.quantile(there, (0.05, 0.5, 0.95))]  # fmt: skip
        nominal = (result.summary["results"].get(name) or {}).get("nominal")
        handles = [lines[0]]
        if nominal is not None:
            handles.append(ax.axvline(nominal, color=style.ALARM, linestyle=style.DASHES[1], linewidth=1.4))
        # what the numbers are multiplied by stands on the right
        fit_label(ax, "x", axis_label(result, name, "outputs"), loc="left")
        ax.set_ylabel("runs")
        ax.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        ax.locator_params(axis="x", nbins=5)
    sheet.legend(handles, labels[: len(handles)])
    return sheet.figure


def _bins(count: int) -> int:
    return int(np.clip(round(2.0 * count ** (1.0 / 3.0)), 8, 80))


MOST_KEYS = 12


@plot(lambda result: any(len(found) > 1 for found in result.summary.get("influence", {}).values()))
def study_influence(result: Result) -> Any:
    """Which keys of a study move an output most (tornado), with Sobol's indices where they are known."""
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


MOST_SLOPES = 16


@plot(lambda result: bool(_slope_bars(result)))
def sensitivity_tornado(result: Result) -> Any:
    """Which keys move an output most: normalised derivatives as bars, the longest on top."""
    bars = _slope_bars(result)
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
        tornado(ax, name, found, figures=True)
    return sheet.figure


def _slope_bars(result: Result) -> dict[str, dict[str, float]]:
    """Return the normalised derivatives of each output, by key."""
    found: dict[str, dict[str, float]] = {}
    for name, slopes in list(result.summary["sensitivities"].items())[:MOST_PANELS]:
        own = {
            key if slope["method"] == "exact" else f"{key} *": slope["normalised"]
            for key, slope in slopes.items()
            if slope["normalised"] is not None
        }
        if any(own.values()):
            found[name] = dict(list(own.items())[:MOST_SLOPES])
    return found

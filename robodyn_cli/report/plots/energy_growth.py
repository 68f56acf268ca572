"""Error of the energy balance over a thousand periods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.report.analysis import LEAST, legend_below, powers, titled
from robodyn_cli.report.canvas import legend_shape
from robodyn_cli.report.style import dashed_style
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def applies(result: Result) -> bool:
    """Tell whether a method was followed for many periods."""
    return bool(_curves(result))


def _curves(result: Result) -> dict[str, Mapping[str, Any]]:
    """Return the facts of the methods that have a curve, by name."""
    facts = {m["method"]: m for m in result.summary.get("energy_growth", {}).get("methods", ())}
    return {n: m for n, m in facts.items() if f"energy_growth/{n}/error" in result and m["steps"]}


def draw(result: Result) -> Figure:
    """Return the figure."""
    labels = {name: _label(name, m) for name, m in _curves(result).items()}
    _, lines = legend_shape(list(labels.values()))
    height = 4.0 + 0.19 * lines
    period = result.summary["energy_growth"]["period"]
    figure = titled(7.6, height, result, f"a period is {period['seconds']:.4g} s: {period['source']}")
    bottom = (0.6 + 0.19 * lines) / height
    ax = figure.add_axes((0.1, bottom, 0.86, 1 - bottom - 0.68 / height))
    for k, (name, label) in enumerate(labels.items()):
        t, error = result[f"energy_growth/{name}/periods"][1:], result[f"energy_growth/{name}/error"][1:]
        ax.plot(t, np.maximum(np.maximum.accumulate(error), LEAST), label=label, **dashed_style(k))
    ax.set_xscale("log")
    ax.set_yscale("log")
    powers(ax, "x", "y")
    ax.set_xlabel("time [periods]")
    ax.set_ylabel("largest error of the energy balance so far [1]")
    legend_below(figure, ax, (0.08, 0.01))
    return figure


def _label(name: str, facts: Mapping[str, Any]) -> str:
    power = "" if facts["exponent"] is None else f", ~t^{facts['exponent']:.1f}"
    ended = "" if facts["status"] == "ok" else f", {facts['status'].replace('_', ' ')}"
    return f"{name}{power}{ended}"

"""Axes of drawings hold every line on them."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes

from robodyn_cli.report import draw
from robodyn_cli.report.overlay import draw_over
from robodyn_cli.results.result import Result


def _cut(ax: Axes) -> list[str]:
    """Return which lines of an axis are not within it."""
    low, high = sorted(ax.get_ylim())
    data = [(line.get_label(), np.asarray(line.get_ydata(), dtype=float)) for line in ax.lines]
    return [name for name, y in data if not (low <= np.nanmin(y) and np.nanmax(y) <= high)]


def _energies(level: float, swing: float, until: float) -> Result:
    result = Result("simulate", "arm", "ok", "")
    time = np.linspace(0.0, until, 101)
    result.add("time", time)
    total = level + swing * np.sin(time) + 1e-14 * np.cos(7.0 * time)
    result.add("energy/total", total, units="J")
    return result


@pytest.mark.parametrize("swings", [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0)])
@pytest.mark.parametrize("levels", [(-267.0, -216.6), (-216.6, -267.0), (0.0, 40.0), (3.0, 3.0), (0.0, 0.0)])
def test_results_over_one_another_are_all_within_their_axes(
    levels: tuple[float, float], swings: tuple[float, float]
) -> None:
    results = {
        name: _energies(level, swing, until)
        for name, level, swing, until in zip("ab", levels, swings, (10.0, 20.0))
    }
    (ax,) = draw_over(results, "energy").axes
    assert len(ax.lines) == 2 and not _cut(ax)


def test_limits_of_joints_that_rest_are_within_the_axes() -> None:
    result = Result("inverse", "arm", "ok", "")
    result.add("time", np.linspace(0.0, 1.0, 11))
    result.add("tau", np.full((11, 1), 10.0), units="N m", names=("a",))
    result.add("joint_limits/effort", [12.5], units="N m", names=("a",))
    (ax,) = draw(result, "torques").axes
    assert len(ax.lines) >= 2 and not _cut(ax)


def test_curves_of_growth_have_looks_and_words_of_their_own() -> None:
    names = [f"m{k}" for k in range(9)]
    facts = [
        {"method": n, "steps": 9, "exponent": p, "status": "ok"} for n, p in zip(names, [1.3, -0.04] * 5)
    ]
    result = Result("stability", "arm", "ok", "")
    result.summary = {"energy_growth": {"methods": facts, "period": {"seconds": 1.0, "source": "s"}}}
    for k, name in enumerate(names):
        result.add(f"energy_growth/{name}/periods", np.arange(20.0))
        result.add(f"energy_growth/{name}/error", np.arange(20.0) * 10.0 ** -(k + 2))
    figure = draw(result, "energy_growth")
    assert len({line.get_color() for line in figure.axes[0].lines}) == len(names)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[:2] == ["m0, ~t¹·³", "m1, ~t⁰"]


def test_the_label_of_errors_of_methods_is_whole() -> None:
    result = Result("stability", "arm", "ok", "")
    row = {
        "method": "rk4",
        "status": "stable",
        "relative": 1e-6,
        "chosen": None,
        "until": 1.0,
        "honest": True,
    }
    result.summary = {"methods": [row], "reference": None}
    figure = draw(result, "stability_methods")
    assert figure.axes[0].get_xlabel() == "largest relative error [1]"
    assert any(text.get_text().startswith("Bars: ") for text in figure.texts)

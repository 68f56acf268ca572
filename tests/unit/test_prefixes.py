"""Axes and times with prefixes of SI: the numbers beside an axis are those of its data in the unit that it names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from robodyn_cli.report.drawing.places import moving_paths
from robodyn_cli.report.numbers import PREFIXES, prefix, times
from robodyn_cli.report.style import PlainFormatter, prefix_axes, styled
from robodyn_cli.results.result import Result

FACTORS = {word: 10.0**exponent for exponent, word in PREFIXES.items()}


def _axis(label: str, low: float, high: float) -> Any:
    with styled():
        figure = Figure(figsize=(6, 3))
        ax = figure.add_subplot()
        ax.set_xlim(low, high)
        ax.set_xlabel(label)
        ax.xaxis.set_major_formatter(PlainFormatter())
        prefix_axes(figure)
        FigureCanvasAgg(figure).draw()
    return ax.xaxis


@pytest.mark.parametrize("seed", range(40))
def test_numbers_beside_an_axis_are_its_data(seed: int) -> None:
    rng = np.random.default_rng(seed)
    unit = str(rng.choice(["s", "m", "N", "J"]))
    size = 10.0 ** rng.uniform(-13.0, 8.0)
    low, high = np.sort(size * rng.uniform(-1.0, 1.0, 2))
    axis = _axis(f"quantity [{unit}]", low, high)
    word = axis.get_label_text().partition("[")[2].rstrip("]")
    assert word.endswith(unit)
    shift = axis.get_offset_text().get_text()
    if shift:  # a power of ten, or a difference, in place of a prefix
        return
    texts = [tick.label1.get_text().replace("\N{MINUS SIGN}", "-") for tick in axis.get_major_ticks()]
    places = axis.get_majorticklocs()
    shown = [float(text) * FACTORS[word.removesuffix(unit)] for text in texts if text]
    assert np.allclose(shown, places, rtol=1e-9, atol=1e-9 * max(abs(low), abs(high)))
    assert max(len(text) for text in texts) <= 7


def test_axes_of_seconds_stay_seconds_and_angles_have_no_prefix() -> None:
    assert _axis("time [s]", 0.0, 5e4).get_label_text() == "time [s]"
    assert _axis("time [s]", 0.0, 5e-7).get_label_text() == "time [ns]"
    assert _axis("joint angle [rad]", 0.0, 1e-7).get_label_text() == "joint angle [rad]"


def test_prefixes_and_times_in_captions() -> None:
    assert prefix(4.97e-7, "s") == ("ns", 1e9) and prefix(2.5, "s") == ("s", 1.0)
    assert prefix(1e6, "N")[0] == "MN" and prefix(0.0, "m") == ("m", 1.0)
    assert times([4.97e-7]) == ["497 ns"] and times([0.0, 0.0925, 12.0]) == ["0 s", "0.0925 s", "12 s"]
    assert times([0.0]) == ["0 s"] and times([float("inf")]) == ["not finite s"]


def test_a_point_that_rounding_moves_does_not_move() -> None:
    result = Result("simulate", "", "ok", "")
    rng = np.random.default_rng(0)
    result.add("points/still", np.array([0.3, -2.0, 0.0]) + 1e-16 * rng.standard_normal((20, 3)))
    assert moving_paths(result) == {}
    result.add("points/tip", np.array([0.3, -2.0, 0.0]) + 1e-9 * rng.standard_normal((20, 3)))
    assert list(moving_paths(result)) == ["tip"]

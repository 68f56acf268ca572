"""Plots in which all is zero are left out unless they are asked for; axes say what their numbers are."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from robodyn_cli.cli.app import run
from robodyn_cli.report import draw, draw_all
from robodyn_cli.report.canvas import EMPTY, NOTE, print_figure
from robodyn_cli.report.page.charts import Store
from robodyn_cli.report.page.plots import plots_of
from robodyn_cli.report.registry import Drawings, applicable, not_drawn
from robodyn_cli.report.style import round_numbers
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result
from tests.unit.synthetic_results import chain_result, pendulum_result

ZERO = ("joint_rates", "energy_drift")


def resting() -> Result:
    """A run in which the drift of the energy and the rates are zero."""
    result = pendulum_result(51)
    result["qd"][:] = 0.0
    result["energy/total"][:], result["energy/work"][:] = 3.0, 0.0
    return result


def test_plots_of_zeros_are_left_out_and_told_in_one_line(tmp_path: Path) -> None:
    result = resting()
    (tmp_path / "all").mkdir()
    (tmp_path / "asked").mkdir()
    files = draw_all(result, tmp_path / "all")
    assert {path.stem for path in files} == set(applicable(result)) - set(ZERO)
    (line,) = not_drawn(result, Drawings(), files)
    assert (
        line == "not drawn, as all in them is zero or missing: joint_rates, energy_drift (--plots draws them)"
    )
    asked = Drawings(ZERO)
    files = draw_all(result, tmp_path / "asked", asked)
    assert {path.stem for path in files} == set(ZERO)
    assert not not_drawn(result, asked, files)


def test_the_command_and_the_page_tell_them_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = resting()
    stored = write(result, tmp_path / "result.h5")
    assert run(["plot", str(stored), "--out", str(tmp_path / "p")]) == 0
    assert (
        "robodyn: not drawn, as all in them is zero or missing: joint_rates, energy_drift"
        in capsys.readouterr().err
    )
    page = str(plots_of(result, Store(), moving=True))
    assert (
        "Left out, as all in them is zero or missing: Joint rates, Energy drift." in page
        and "<h3>Energy drift" not in page
    )


def test_many_columns_of_zeros_are_an_empty_map_and_one_that_moves_is_none() -> None:
    result = chain_result(40)
    assert draw(result, "joint_angles").get_label() != EMPTY
    result["q"][:] = 0.0
    assert draw(result, "joint_angles").get_label() == EMPTY
    result["q"][-1, 7] = 1e-3
    assert draw(result, "joint_angles").get_label() != EMPTY


def printed(figure: Figure) -> Figure:
    print_figure(figure, BytesIO(), ".png")
    return figure


def numbers(axis: Any) -> list[str]:
    low, high = sorted(axis.get_view_interval())
    return [
        word
        for places, form in (
            (axis.get_majorticklocs(), axis.get_major_formatter()),
            (axis.get_minorticklocs(), axis.get_minor_formatter()),
        )
        for x, word in zip(places, form.format_ticks(list(places)))
        if low <= x <= high and word
    ]


@pytest.mark.parametrize(
    "ends", [(1.1, 9.0), (2.1e-9, 2.9e-9), (4.0, 40.0), (3e-4, 7e-3), (6.2, 6.4), (1e-12, 1e3)]
)
def test_logarithmic_axes_have_two_numbers_at_least(ends: tuple[float, float]) -> None:
    from robodyn_cli.report.analysis import powers

    figure = Figure()
    ax = figure.add_subplot()
    ax.plot(ends, ends)
    ax.set_xscale("log")
    ax.set_yscale("log")
    powers(ax, "x", "y")
    printed(figure)
    for axis in (ax.xaxis, ax.yaxis):
        words = numbers(axis)
        assert len(set(words)) == len(words) >= 2, words


def test_round_numbers_are_as_round_as_they_can_be() -> None:
    assert round_numbers(0.9, 40.0) == [1.0, 3.0, 10.0, 30.0]
    assert round_numbers(4.0, 8.5) == [4.0, 5.0, 6.0, 7.0, 8.0]


def test_what_numbers_are_multiplied_by_stands_in_the_label_and_what_is_added_inside() -> None:
    result = pendulum_result(51)
    result["q"][:] = 3e-7 * np.sin(result.time)[:, None]
    figure = printed(draw(result, "joint_angles"))
    assert figure.axes[0].get_ylabel() == "joint angle [10⁻⁷ rad]"
    assert figure.axes[0].yaxis.get_offset_text().get_text() == ""
    result["q"][:] = 0.1 + 1e-9 * np.sin(result.time)[:, None]
    figure = printed(printed(draw(result, "joint_angles")))
    ax = figure.axes[0]
    assert not ax.yaxis.get_offset_text().get_visible() and ax.get_ylabel() == "joint angle [rad]"
    (added,) = [text for text in ax.texts if text.get_text() == "·10⁻⁹ + 0.1"]
    lowest_note = min(text.get_window_extent().y0 for text in figure.texts if text.get_label() == NOTE)
    assert added.get_window_extent().y1 <= ax.bbox.y1 < lowest_note

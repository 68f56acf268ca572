"""Drawings: which are made, that odd results do not stop them, and that they cost little."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axis import YAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from robodyn_cli import inverse, load_scene, load_scene_text, simulate
from robodyn_cli.cli.app import run
from robodyn_cli.commands import PLOT_FORMATS
from robodyn_cli.errors import OutputError
from robodyn_cli.report import draw, draw_all, plot_files
from robodyn_cli.report.analysis import fit_label, panels
from robodyn_cli.report.canvas import wrapped
from robodyn_cli.report.lines import crest, envelope, finite, thin_path
from robodyn_cli.report.numbers import error_number, number, unit
from robodyn_cli.report.overlay import draw_over, labels_of
from robodyn_cli.report.plots.methods import MOST_METHODS, work_precision
from robodyn_cli.report.plots.stability import energy_growth
from robodyn_cli.report.registry import Drawings, applicable
from robodyn_cli.report.style import dashed_style, log_axis, marked_style, styled
from robodyn_cli.report.time_sheet import CLOSE_UP, LAST_PERIODS
from robodyn_cli.results.hdf5 import read, write
from robodyn_cli.results.moments import moment_lines
from robodyn_cli.results.output_dir import SIGNATURE, is_ours
from robodyn_cli.results.result import Result
from robodyn_cli.solve.extremes import root_mean_square
from tests.unit.synthetic_results import chain_result, four_bar_result, inverse_result, pendulum_result

INVERSE = [
    "joint_angles",
    "joint_rates",
    "joint_accelerations",
    "torques",
    "torque_terms",
    "tip_path",
    "point_coordinates",
]
SIMULATE = ["joint_angles", "joint_rates", "tip_path", "point_coordinates", "energy", "energy_drift"]
DEPLOY = ["joint_angles", "multipliers", "constraint_residual", "singular_values", "mechanism"]


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Libraries may use each other's old names.
        warnings.filterwarnings("ignore", category=DeprecationWarning, module="matplotlib|pyparsing")
        yield


def test_pictures_are_opaque_and_titles_take_no_layout(tmp_path: Path) -> None:
    """PNG has no transparency; places of titles are given, so numbers of axes are not laid out to find them."""
    laid_out = []

    def count(axis: YAxis, *_: object, **__: object) -> None:
        laid_out.append(axis)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(YAxis, "get_tightbbox", count)
        (file,) = draw_all(inverse_result(), tmp_path, Drawings(("torque_terms",)))
    with Image.open(file) as picture:
        assert picture.mode == "RGB" and picture.info["Title"]
    assert not laid_out


@pytest.mark.parametrize(
    ("result", "expected"),
    [(inverse_result(), INVERSE), (pendulum_result(201), SIMULATE), (four_bar_result(), DEPLOY)],
    ids=["inverse", "simulate", "deploy"],
)
def test_each_command_gets_its_drawings(tmp_path: Path, result: Result, expected: list[str]) -> None:
    paths = draw_all(result, tmp_path)
    assert [path.name for path in paths] == [f"{name}.png" for name in expected]
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in paths} <= set(plot_files())
    for path in paths:
        content = path.read_bytes()
        assert content.startswith(b"\x89PNG") and SIGNATURE in content[:512]
        width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
        assert width == 840 and 300 < height < 1000


def test_a_stored_result_draws_alike(tmp_path: Path) -> None:
    result = four_bar_result()
    first, second = tmp_path / "a", tmp_path / "b"
    for directory, source in ((first, result), (second, read(write(result, tmp_path / "r.h5")))):
        directory.mkdir()
        draw_all(source, directory)
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes(), path.name


@pytest.mark.parametrize("joints", [1, 7, 12, 100])
def test_any_number_of_joints_stays_a_page(tmp_path: Path, joints: int) -> None:
    for path in draw_all(chain_result(joints, 51), tmp_path):
        assert int.from_bytes(path.read_bytes()[20:24], "big") < 1200, path.name


@pytest.mark.parametrize("make", [inverse_result, four_bar_result, pendulum_result])
@pytest.mark.parametrize("samples", [1, 2, 3])
def test_few_samples(tmp_path: Path, make: object, samples: int) -> None:
    result = make(samples)  # type: ignore[operator]
    assert draw_all(result, tmp_path)


def test_no_samples_no_drawings(tmp_path: Path) -> None:
    result = Result("simulate", "", "failed", "")
    assert draw_all(result, tmp_path) == []
    result.add("time", [])
    result.add("q", np.zeros((0, 2)))
    assert draw_all(result, tmp_path) == []


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, 1e300])
@pytest.mark.parametrize("make", [inverse_result, four_bar_result, pendulum_result])
def test_values_that_scale_no_axis(tmp_path: Path, make: object, value: float) -> None:
    result = make(101)  # type: ignore[operator]
    for path, variable in result.variables.items():
        if path != "time":
            variable.data[:] = value
    assert draw_all(result, tmp_path, Drawings(tuple(applicable(result))))


def test_names_that_look_like_formulas(tmp_path: Path) -> None:
    result = inverse_result(51)
    result.title = "Cost: $5 and $6_{x}"
    for path in ("q", "qd", "qdd", "tau"):
        result.variables[path].names = ("_hidden", r"$\frac{")
    result.variables["points/$a_b"] = result.variables.pop("points/tip")
    assert len(draw_all(result, tmp_path)) == 7


def texts(result: Result, name: str) -> str:
    import matplotlib.text

    return "\n".join(item.get_text() for item in draw(result, name).findobj(matplotlib.text.Text))


def test_a_failed_run_says_so_on_every_drawing() -> None:
    result = pendulum_result(51)
    assert "failed" not in texts(result, "joint_angles")
    result.status = "failed"
    result.summary["termination"] = {"reason": "step size underflow", "time": 4.25}
    for name in applicable(result):
        assert "Run failed at t = 4.25 s: step size underflow" in texts(result, name)


def test_the_root_mean_square_in_the_drawing_is_that_of_the_summary() -> None:
    """Few samples, so that other averages of them (not over time) would show."""
    result = inverse(load_scene("configs/2r_circle.yaml"), samples=12)
    drawn = texts(result, "torques")
    for name, figures in result.summary["joints"].items():
        mean = float(np.sqrt(np.mean(result["tau"][:, result.variables["tau"].names.index(name)] ** 2)))
        assert number(figures["rms_torque"], 4) != number(mean, 4)
        assert f"RMS {number(figures['rms_torque'], 4)} N·m" in drawn


def test_figures_in_the_drawing_know_that_friction_jumps_between_samples() -> None:
    points = ", ".join(f"{{t: {t}, q: {{lift: {q}}}}}" for t, q in ((0, 0.1), (1.6, 0.5), (2.4, 0.2)))
    text = f"""
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{{name: lift, type: prismatic, axis: [0, 0, 1], friction: {{coulomb: 30}}}}]
  links: [{{name: car, mass: 3}}]
trajectory: {{type: quintic, points: [{points}]}}
"""
    result = inverse(load_scene_text(text), samples=31)
    figures = result.summary["joints"]["lift"]
    assert f"RMS {number(figures['rms_torque'], 4)} N" in texts(result, "torques")
    assert number(figures["rms_torque"], 4) != number(
        float(root_mean_square(result.time, result["tau"])[0][0]), 4
    )


def test_small_torques_beside_large_ones_have_a_panel_of_their_own() -> None:
    result = inverse_result()
    wave = np.sin(result.time)
    result.add(
        "tau",
        np.column_stack([60.0 * wave - 70.0, 20.0 * wave, 0.5 * wave]),
        names=("a", "b", "c"),
        units="N m",
    )
    large, small = draw(result, "torques").axes
    assert np.ptp(small.get_ylim()) < 2.0 < 100.0 < np.ptp(large.get_ylim())
    levels = [float(line.get_ydata()[0]) for line in large.lines if line.get_linewidth() == 0.8]
    assert levels == [pytest.approx(14.1, abs=0.5)], "of b alone: no torque comes as high as that of a"
    result["tau"][:, 2] *= 40.0
    assert len(draw(result, "torques").axes) == 1


def test_captions_state_the_figures() -> None:
    drawn = texts(inverse_result(), "torques")
    time, tau = inverse_result().time, inverse_result()["tau"][:, 0]
    average = float(np.sum(np.diff(time) * (tau[1:] ** 2 + tau[:-1] ** 2)) / 2 / (time[-1] - time[0]))
    assert f"theta1: peak {number(tau.max(), 4)}, RMS {number(average**0.5, 4)} N·m" in drawn
    result = pendulum_result(201)
    total = result["energy/total"]
    assert f"largest {error_number(np.abs(total - total[0]).max())} J" in texts(result, "energy_drift")
    drawn = texts(four_bar_result(), "multipliers")
    assert "dead point at 12.283 s" in drawn
    assert all(f"{factor}×" in drawn for factor in (10, 100, 1000))
    assert "12.28 s (locked)" in texts(four_bar_result(), "mechanism")


def test_growth_without_a_lock_and_rows_of_prescribed_joints() -> None:
    result = four_bar_result()
    lock = result.summary.pop("lock")
    result.summary["criteria"] = {"growth_times": {**lock["growth_times"], "1000": None}}
    drawn = texts(result, "multipliers")
    assert "100×" in drawn and "1000×" not in drawn and "dead point" not in drawn
    data = np.column_stack([result["constraints/multipliers"], np.full(len(result.time), 1e6)])
    result.add(
        "constraints/multipliers", data, units="N or N m", names=("pin.x", "pin.y", "prescribed.theta1")
    )
    assert f"largest norm of the samples {number(1e6, 6)}" in texts(result, "multipliers")
    result.summary["lock"] = {**lock, "multipliers": {"rows": ["pin.x", "pin.y"]}}
    assert f"largest norm of the samples {number(1e6, 6)}" not in texts(result, "multipliers")


def test_multipliers_of_each_unit_have_an_axis_of_their_own() -> None:
    result = four_bar_result()
    data = np.column_stack([result["constraints/multipliers"], np.full(len(result.time), 1e6)])
    result.add(
        "constraints/multipliers",
        data,
        units="N or N m",
        names=("pin.x", "pin.y", "pin.angle"),
        column_units=("N", "N", "N m"),
    )
    figure = draw(result, "multipliers")
    assert [ax.get_ylabel() for ax in figure.axes] == ["multiplier [N]", "multiplier [N·m]"] * 2
    assert max(np.max(line.get_ydata()) for line in figure.axes[0].lines) < 1e6
    drawn = texts(result, "multipliers")
    assert "1·10⁶ N·m" in drawn and "pin.angle" in drawn


def test_the_energy_a_latch_takes_is_no_drift() -> None:
    result = pendulum_result(201)
    total = result["energy/total"].copy()
    total[150:] -= 5.0
    result.add("energy/total", total)
    assert "largest 5" in texts(result, "energy_drift")
    result.summary["lock"] = {"time": float(result.time[150])}
    assert "largest 5" not in texts(result, "energy_drift")


def test_a_point_without_target_and_motion_in_another_plane() -> None:
    result = pendulum_result(101)
    for path in ("points/tip", "points/elbow"):
        result.variables[path].data = result[path][:, [0, 2, 1]]
    drawn = texts(result, "tip_path")
    assert "x [m]" in drawn and "z [m]" in drawn and "target" not in drawn


def test_torques_that_nobody_gave_are_not_drawn() -> None:
    result = pendulum_result(51)
    result.add("tau", np.zeros((51, 2)), units="N m", names=("theta1", "theta2"))
    assert "torques" not in applicable(result)
    result["tau"][3, 0] = 1.0
    assert "torques" in applicable(result)


def test_drawing_leaves_the_settings_of_matplotlib_alone(tmp_path: Path) -> None:
    import matplotlib

    names = [name for name in matplotlib.rcParams if name != "backend"]
    before = [matplotlib.rcParams[name] for name in names]
    draw_all(inverse_result(11), tmp_path)
    assert [matplotlib.rcParams[name] for name in names] == before


def test_an_unwritable_directory_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="nowhere"):
        draw_all(inverse_result(11), tmp_path / "nowhere")


def test_the_registry_imports_no_matplotlib() -> None:
    code = "import sys, robodyn_cli.report as r; r.plot_files(); sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_drawing_does_without_pyplot() -> None:
    code = (
        "import sys, tempfile, tests.unit.synthetic_results as s; from robodyn_cli.report import draw_all;"
        "draw_all(s.inverse_result(11), tempfile.mkdtemp()); sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, cwd=Path(__file__).parents[2])
    assert done.returncode == 0


def test_envelope_keeps_every_extreme() -> None:
    rng = np.random.default_rng(0)
    x = np.arange(100_003.0)
    y = rng.normal(size=x.size)
    y[77_777], y[100_002] = 50.0, -60.0
    few, low = envelope(x, y, 500)
    assert len(few) < 1600
    assert np.all(np.diff(few) > 0) and few[0] == 0 and few[-1] == x[-1]
    assert low.max() == 50.0 and low.min() == -60.0
    y[1000:90_000] = np.nan
    few, low = envelope(x, y, 500)
    assert np.isnan(low).any() and low[-1] == -60.0
    assert envelope(x[:10], y[:10])[0] is not None


def test_crest_and_path_keep_what_is_seen() -> None:
    x = np.arange(10_001.0)
    y = np.abs(np.sin(x))
    y[5000] = 3.0
    assert crest(x, y)[1].max() == 3.0 and len(crest(x, y)[0]) == 250
    angle = np.linspace(0.0, 20.0 * np.pi, 1_000_000)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    thin = thin_path(circle)
    assert len(thin) < 31_000
    assert np.array_equal(thin[0], circle[0]) and np.array_equal(thin[-1], circle[-1])
    assert np.abs(np.linalg.norm(0.5 * (thin[1:] + thin[:-1]), axis=1) - 1.0).max() < 1e-3
    assert np.isnan(finite(np.array([1.0, 1e200, np.inf]))[1:]).all()


def test_units_and_numbers_as_printed() -> None:
    assert unit("N m") == "N·m"
    assert unit("rad/s^2 or m/s^2") == "rad/s² or m/s²"
    assert unit("N m or N") == "N·m or N"
    assert number(-1.5e-12) == "−1.5·10⁻¹²"
    assert number(float("nan")) == "not finite"


def test_columns_of_different_units_have_panels_of_their_own() -> None:
    result = pendulum_result(51)
    result.add(
        "q", result["q"], units="rad or m", names=result.variables["q"].names, column_units=("rad", "m"),
        dims=("time", "joint"),
    )  # fmt: skip
    labels = [ax.get_ylabel() for ax in draw(result, "joint_angles").axes if ax.get_ylabel()]
    assert [label.rpartition(" ")[2] for label in labels][:2] == ["[rad]", "[m]"]


def test_sixteen_curves_look_different_on_a_grey_printer_too() -> None:
    looks = [marked_style(index) for index in range(16)]
    filled = [look["markerfacecolor"] == look["color"] for look in looks]
    assert len({(look["marker"], full) for look, full in zip(looks, filled)}) == 16
    assert len({(look["color"], look["marker"]) for look in looks}) == 16
    dashed = [dashed_style(index) for index in range(16)]
    assert len({(look["color"], str(look["linestyle"])) for look in dashed}) == 16


def _compared(methods: list[str]) -> Result:
    runs = [
        {
            "method": name,
            "formulation": "tree",
            "error": error * (1 + k),
            "run_time_s": 1e-3 / error,
            "evaluations": 9,
        }
        for k, name in enumerate(methods)
        for error in (1e-3, 1e-6)
    ]
    result = pendulum_result(3)
    result.summary = {"runs": runs, "best": [], "compared_until": 1.0, "reference_digits": 12.0}
    return result


def test_as_many_methods_as_are_compared_have_lines_of_their_own() -> None:
    figure = work_precision.draw(_compared([f"method{k}" for k in range(MOST_METHODS)]))
    for ax in figure.axes:
        looks = {(line.get_color(), line.get_marker(), line.get_markerfacecolor()) for line in ax.lines}
        assert len(looks) == len(ax.lines) == MOST_METHODS


def _growing(names: list[str]) -> Result:
    result = pendulum_result(3)
    facts = [{"method": n, "steps": 9, "exponent": 1.0, "status": "budget_exhausted"} for n in names]
    period = {"seconds": 1.0, "source": "given"}
    result.summary = {"energy_growth": {"methods": facts, "period": period}}
    for name in names:
        result.add(
            f"energy_growth/{name}/periods",
            np.array([0.0, 1.0, 10.0]),
            units="1",
            long_name="time",
            dims=("n",),
        )
        result.add(
            f"energy_growth/{name}/error",
            np.array([0.0, 1e-9, 1e-8]),
            units="1",
            long_name="error",
            dims=("n",),
        )
    return result


@pytest.mark.parametrize("count", [1, 3, 8, 12])
def test_the_legend_of_the_energy_stays_on_the_page_and_off_the_axes(count: int) -> None:
    with styled():
        figure = energy_growth.draw(_growing([f"generalized_alpha{k}" for k in range(count)]))
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        legend = figure.legends[0].get_window_extent()
        page = figure.bbox
        assert page.x0 <= legend.x0 and legend.x1 <= page.x1 and page.y0 <= legend.y0
        assert legend.y1 <= figure.axes[0].xaxis.label.get_window_extent().y0


# -- moments --------------------------------------------------------------------------------------------------
def bouncing(count: int) -> Result:
    result = pendulum_result(201)
    result.events = [{"time": 0.3 * k, "name": "theta1", "kind": "impact"} for k in range(1, count + 1)]
    result.events += [
        {"time": 2.5, "name": "theta2", "kind": "stick"},
        {"time": 3.0, "name": "pin", "kind": "overload"},
    ]
    result.events += [{"time": 1.0, "name": "multipliers 10 x median", "kind": "growth"}]
    return result


def test_moments_are_on_every_plot_over_time_and_in_its_legend() -> None:
    result = bouncing(7)
    for name in ("joint_angles", "joint_rates", "energy", "energy_drift"):
        figure = draw(result, name)
        words = "\n".join(text.get_text() for text in figure.texts + figure.legends[0].get_texts())
        assert "impacts (7)" in words and "stick (1)" in words
        assert "pin is overloaded at 3 s" in words
        for ax in figure.axes[:1]:
            marked = {
                round(float(x), 9) for line in ax.lines for x in line.get_xdata() if line.get_marker() == "v"
            }
            assert marked == {round(0.3 * k, 9) for k in range(1, 8)}
            assert any(list(line.get_xdata()) == [3.0, 3.0] for line in ax.lines)


def test_the_list_of_moments_fits_the_terminal() -> None:
    lines = moment_lines(bouncing(40))
    assert all(len(line) <= 80 for line in lines)
    assert lines[0].startswith("  moments            theta1 hits its stop, 40 times: 0.3, 0.6") and lines[
        0
    ].endswith("... s")
    assert lines[1] == " " * 21 + "theta2 sticks: 2.5 s"
    assert len(lines) == 2, "an overload is told by the summary"
    assert moment_lines(pendulum_result(11)) == []


# -- axes -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("low", "high"), [(3.0, 4.0), (1.0, 9.0), (2e-7, 3e-5), (1e-16, 1e-3), (5.0, 5.0)])
def test_a_logarithmic_axis_is_no_wider_than_its_data(low: float, high: float) -> None:
    ax = Figure().add_subplot()
    log_axis(ax, low, high)
    bottom, top = ax.get_ylim()
    assert bottom < low and high < top
    if high / low >= 10.0:
        assert ax.get_yscale() == "log"
        assert np.log10(top / bottom) <= 1.07 * np.log10(high / low)
    else:
        assert ax.get_yscale() == "linear", "a power of ten would be all that it shows"


def test_what_rounding_leaves_of_zero_does_not_fill_a_panel() -> None:
    result = pendulum_result(51)
    names = ("fx", "fy", "fz", "mx", "my", "mz")
    load = np.zeros((51, 6))
    load[:, 0], load[:, 5] = np.linspace(1.0, 9.0, 51), 1e-15 * np.sin(np.arange(51))
    result.add("reactions/theta1", load, names=names)
    figure = draw(result, "reactions")
    assert [ax.get_ylabel() for ax in figure.axes] == ["force [N]"] and figure.axes[0].get_ylim()[1] > 9.0
    assert any("no moments" in text.get_text() for text in figure.texts)
    load[:, 5] = 2.0
    result.variables["reactions/theta1"].data[:] = load
    assert len(draw(result, "reactions").axes) == 2


def test_residuals_that_are_zero_are_drawn_as_zero() -> None:
    result = four_bar_result()
    result["constraints/position_residual"][:] = 0.0
    result["constraints/velocity_residual"][:] *= 1e3
    position, velocity = draw(result, "constraint_residual").axes[:2]
    assert position.get_yscale() == "linear" and velocity.get_yscale() == "log"
    assert not np.any(position.lines[0].get_ydata()) and position.get_ylim()[0] < 0.0


def test_powers_of_ten_are_written_in_one_way() -> None:
    result = four_bar_result()
    steps = np.linspace(1.1e-12, 4.4e-12, len(result.time))
    result["constraints/position_residual"][:] = steps[:, None]
    result["constraints/velocity_residual"][:] = (
        1e4 * 20.0 ** np.linspace(-12.0, -11.0, len(result.time))[:, None]
    )
    figure = draw(result, "constraint_residual")
    FigureCanvasAgg(figure).draw()
    position, velocity = figure.axes[:2]
    assert position.yaxis.get_offset_text().get_text() == "·10⁻¹²"
    between = {label.get_text() for label in velocity.get_yticklabels(minor=True)} - {""}
    assert "5·10⁻¹²" in between and not any("e" in text for text in between)


@pytest.mark.parametrize("size", [1e-6, 0.01, 0.1, 123456.7])
@pytest.mark.parametrize("part", [0.0, 1e-9, 1e-3, 2.5])
def test_numbers_beside_an_axis_leave_room_for_its_label(size: float, part: float) -> None:
    result = pendulum_result(21)
    for path in ("q", "qd"):
        result[path][:] = -size * (1.0 + part * np.linspace(-0.3, 0.7, 21)[:, None])
        figure = draw(result, {"q": "joint_angles", "qd": "joint_rates"}[path])
        FigureCanvasAgg(figure).draw()
        for ax in figure.axes:
            box = ax.yaxis.get_tightbbox()
            assert box.x0 >= 0.0 and box.x1 <= figure.bbox.width
            assert "e" not in ax.yaxis.get_offset_text().get_text()
            # what is written is the place of the tick, to its last digit
            ticks = zip(ax.get_yticks(), ax.get_yticklabels())
            written = [(x, text.get_text()) for x, text in ticks if text.get_text()]
            values = [value_of(text, ax.yaxis.get_offset_text().get_text()) for _, text in written]
            distance = np.diff(ax.get_yticks())[0]
            np.testing.assert_allclose(values, [x for x, _ in written], rtol=0.0, atol=0.02 * distance)


def value_of(number: str, beside: str) -> float:
    """Return the value of a number beside an axis, with what stands above it."""
    plain = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹\N{MINUS SIGN}", "-0123456789-", "°")
    factor, sign, added = re.fullmatch(r"(?:·10(\S+))? ?(?:([+-]) (\S+))?", beside.translate(plain)).groups()
    value = float(number.translate(plain)) * 10.0 ** int(factor or 0)
    return value + float(f"{sign}{added}".replace("·10", "e")) if added else value


def test_every_axis_over_time_says_its_unit() -> None:
    for result in (inverse_result(), pendulum_result(201), four_bar_result()):
        for name in applicable(result):
            for ax in draw(result, name).axes:
                label = ax.get_ylabel()
                assert not label or (label.endswith("]") and "[" in label), (name, label)
    mixed = chain_result(100, 11)
    units = tuple("rad" if k % 2 else "m" for k in range(100))
    mixed.add("q", mixed["q"], units="rad or m", names=mixed.variables["q"].names, column_units=units)
    maps = [ax.get_title(loc="left") for ax in draw(mixed, "joint_angles").axes]
    assert maps == ["joint position [m]", "joint position [rad]"], "a map for each unit"


# -- drawn again ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("suffix", PLOT_FORMATS)
def test_kinds_of_files_are_ours_and_the_same_every_time(tmp_path: Path, suffix: str) -> None:
    result = four_bar_result(101)
    paths = draw_all(result, tmp_path, Drawings(("mechanism", "multipliers"), suffix))
    assert [path.name for path in paths] == [f"multipliers.{suffix}", f"mechanism.{suffix}"]
    assert all(is_ours(path) for path in paths)
    before = [path.read_bytes() for path in paths]
    assert [
        path.read_bytes()
        for path in draw_all(result, tmp_path, Drawings(("mechanism", "multipliers"), suffix))
    ] == before
    foreign = tmp_path / f"foreign.{suffix}"
    foreign.write_bytes(b"<svg></svg>")
    assert not is_ours(foreign)


def test_results_are_drawn_over_one_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = pendulum_result(101), pendulum_result(61, 6.0)
    second["q"][:] += 0.1
    places = [write(r, tmp_path / name / "simulate" / "result.h5") for name, r in (("a", first), ("b", second))
              if (tmp_path / name / "simulate").mkdir(parents=True) is None]  # fmt: skip
    assert labels_of(places, ["arm", "arm"]) == ["a/simulate", "b/simulate"]
    assert labels_of(places, ["arm", "heavy arm"]) == ["arm", "heavy arm"]
    assert labels_of([*places, tmp_path], ["arm", "arm", "leg"])[1:] == ["arm (b/simulate)", "leg"]
    figure = draw_over({"a": first, "b": second}, "joint_angles")
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["theta1 [rad]", "theta2 [rad]"]
    for column, ax in enumerate(figure.axes):
        for line, result in zip(ax.lines, (first, second)):
            assert np.array_equal(line.get_ydata(), result["q"][:, column])
        assert ax.get_xlim() == (0.0, 10.0)
    code = run(
        [
            "plot",
            *map(str, places),
            "--out",
            str(tmp_path / "p"),
            "--plots",
            "joint_angles,reactions",
            "--json",
        ]
    )
    report = json.loads(capsys.readouterr().out)
    assert code == 0 and report["without_data"] == ["reactions"]
    assert [path.name for path in (tmp_path / "p").iterdir()] == ["joint_angles.png"]


def test_results_over_one_another_say_what_they_are_and_which_failed() -> None:
    slides = [pendulum_result(21) for _ in range(2)]
    for slide in slides:
        slide.add("q", slide["q"], units="m", names=slide.variables["q"].names)
    texts = [text.get_text() for text in draw_over(dict(zip("ab", slides)), "joint_angles").texts]
    assert any(text.startswith("Joint displacements of 2 results") for text in texts)
    slides[0].status, slides[0].summary["termination"] = "failed", {"reason": "step too small", "time": 0.5}
    texts = [text.get_text() for text in draw_over(dict(zip("ab", slides)), "joint_angles").texts]
    assert "a: Run failed at t = 0.5 s: step too small" in texts


@pytest.mark.parametrize(("between", "sparse"), [(0.05, False), (5.0, True)])
def test_samples_that_are_too_far_apart_are_told(between: float, sparse: bool) -> None:
    result = pendulum_result(201)
    result.variables["time"].data[:] = between * np.arange(201)
    phase = 4.6 * result.time[:, None] + np.arange(result["q"].shape[1])
    result["q"][:], result["qd"][:] = np.sin(phase), 4.6 * np.cos(phase)
    result.summary["counters"] = {"steps": 5000}
    for name in ("joint_angles", "energy"):
        texts = " ".join(text.get_text() for text in draw(result, name).texts)
        assert ("Samples are too far apart" in texts) == sparse
    said = " ".join(text.get_text() for text in draw(result, "joint_angles").texts)
    assert ("took 25 steps between two" in said) == sparse


def test_nothing_to_draw_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stored = write(pendulum_result(11), tmp_path / "result.h5")
    assert run(["plot", str(stored), "--out", str(tmp_path / "p"), "--plots", "reactions"]) == 2
    assert "no data for them; possible: joint_angles, joint_rates, tip_path" in capsys.readouterr().err
    assert not (tmp_path / "p").exists()
    assert run(["plot", str(stored), "--plots", "torqes"]) == 2
    assert "did you mean 'torques'" in capsys.readouterr().err
    assert run(["plot", str(stored), "--format", "jpg"]) == 2
    assert "allowed: png, svg, pdf" in capsys.readouterr().err


def test_names_in_the_mechanism_do_not_overlap() -> None:
    figure = draw(four_bar_result(), "mechanism")
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    boxes = [text.get_window_extent(renderer) for ax in figure.axes for text in ax.texts]
    assert len(boxes) == 3
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])
    assert all(figure.axes[0].get_window_extent(renderer).overlaps(box) for box in boxes)


def test_loads_that_are_not_unique_are_said_to_be_so() -> None:
    """Rows of Bennett's linkage depend on each other; three motors share what two freedoms need."""
    changes = ["simulate.duration=0.2", "simulate.samples=21", "outputs.reactions=true"]
    bennett = simulate(load_scene("configs/benchmarks/bennett.yaml", changes))
    for name in ("multipliers", "reactions"):
        assert "rows depend on each other: those of least norm" in texts(bennett, name).replace("\n", " ")
    four_bar = simulate(load_scene("configs/benchmarks/rbd_four_bar.yaml", ["simulate.duration=0.2"]))
    assert "unique" not in texts(four_bar, "multipliers")
    few = inverse(load_scene("configs/mechanisms/five_bar_circle.yaml"), samples=11)
    assert "unique" not in texts(few, "torques") + texts(few, "multipliers")
    more = inverse(
        load_scene("configs/mechanisms/five_bar_circle.yaml", ["actuated=[left, right, bend_left]"]),
        samples=11,
    )
    drawn = texts(more, "torques").replace("\n", " ")
    assert "Not unique: those of least norm: more actuators than degrees of freedom" in drawn


@pytest.mark.parametrize("across", [1, 2])
def test_labels_are_no_longer_than_their_panels(across: int) -> None:
    """The longest keys of summaries, of keys of scenes even longer ones."""
    labels = ["lock.time [s]", "constraint_residual.position [m or rad]", "x" * 70, "robot.joints." * 12]
    with styled():
        sheet = panels(result_of_a_hinge(), "", labels, across=across)
        for ax, label in zip(sheet.axes, labels):
            fit_label(ax, "x", label)
            fit_label(ax, "y", label)
        renderer = FigureCanvasAgg(sheet.figure).get_renderer()
        for ax in sheet.axes:
            box = ax.get_window_extent()
            assert ax.xaxis.label.get_window_extent(renderer).width <= 1.1 * box.width
            assert (
                ax.yaxis.label.get_window_extent(renderer).height <= 1.1 * box.height
            )  # wide letters; panels are further apart
            assert ax.xaxis.label.get_fontsize() >= 6.5
        texts = [ax.get_xlabel() for ax in sheet.axes]
    assert texts[0] == labels[0] and texts[3].startswith("…") and texts[3].endswith("joints.")


def result_of_a_hinge() -> Result:
    return simulate(load_scene(Path("configs/benchmarks/simple_pendulum.yaml"), ["simulate.samples=11"]))


def test_margins_are_over_the_joint_by_name_and_static_ones_lie_on_dynamic_ones() -> None:
    result = inverse(load_scene(Path("configs/deployable_hinge.yaml")))
    figure = draw(result, "motorisation")
    over_time, over_angle = figure.axes
    assert over_time.get_xlabel() == "time [s]" and over_angle.get_xlabel() == "hinge [rad]"
    dynamic, static, _, least = over_time.lines
    found = result.summary["motorisation"]["hinge"]
    assert (least.get_xdata()[0], least.get_ydata()[0]) == (found["time"], found["ratio"])
    assert dynamic.get_linewidth() > 2.0 * static.get_linewidth() and static.get_linestyle() == "--"


def test_a_flight_has_a_view_of_its_own_below_the_mechanism() -> None:
    from tests.unit.test_drawing import CATAPULT

    result = simulate(load_scene_text(CATAPULT))
    near, whole = draw(result, "mechanism").axes
    assert np.ptp(near.get_xlim()) < 4.0 and np.ptp(whole.get_xlim()) > 8.0
    stays = simulate(
        load_scene_text(CATAPULT.replace("until: {when: ", "until: {when: 1000 + ").replace('"', ""))
    )
    assert len(draw(stays, "mechanism").axes) == 1
    short = CATAPULT.replace("[0, -3, 0]", "[-1.2, 0, 0], normal: [1, 0, 0]")
    (near,) = draw(simulate(load_scene_text(short)), "mechanism").axes
    assert near.get_xlim()[0] < -1.2 < -1.1  # where it lands


def test_commands_do_not_make_what_help_on_matplotlib_would_show() -> None:
    """Tables of properties in its docstrings take a third of its import; others who draw keep them."""
    code = "import sys; {}import robodyn_cli.report.plots; from matplotlib.lines import Line2D; print(len(Line2D.set.__doc__))"
    sizes = [
        int(subprocess.run([sys.executable, "-c", code.format(own)], capture_output=True, check=True).stdout)
        for own in ("import robodyn_cli.cli.main; ", "")
    ]
    assert 2 * sizes[0] < sizes[1]


def test_the_last_periods_of_many_are_drawn_once_more() -> None:
    """A curve of 200 periods is a band; of 20 it is not."""
    for periods, shown in ((200, 1), (20, 0)):
        result = pendulum_result(8001)
        swings = np.sin(2.0 * np.pi * periods * result.time / result.time[-1])
        result["q"][:] = np.column_stack([swings, 0.1 * result.time])
        figure = draw(result, "joint_angles")
        close = [ax for ax in figure.axes if ax.get_label() == CLOSE_UP]
        assert len(close) == shown
        for ax in close:
            low, high = ax.get_xlim()
            assert high == result.time[-1]
            assert (high - low) * periods / result.time[-1] == pytest.approx(LAST_PERIODS, abs=0.6)
            (whole,) = [one for one in figure.axes if one is not ax and one.get_ylabel()]
            assert ax.get_ylim() == whole.get_ylim() and whole.get_position().x1 < ax.get_position().x0
            assert [line.get_color() for line in ax.lines[:2]] == [
                line.get_color() for line in whole.lines[:2]
            ]


def test_no_line_of_a_note_ends_between_a_number_and_its_unit() -> None:
    text = " ".join(f"peak{'x' * (k % 7)} {k}.5·10⁻³ N·m at {k} ms," for k in range(60))
    lines = wrapped(text)
    assert len(lines) > 10 and " ".join(lines) == text
    assert not any(re.search(r"[\d⁰¹²³⁴⁵⁶⁷⁸⁹]$", line) for line in lines)


def test_residuals_that_are_zero_have_no_scale() -> None:
    result = four_bar_result()
    result["constraints/position_residual"][:] = 0.0
    figure = draw(result, "constraint_residual")
    assert not len(figure.axes[0].get_yticks())
    assert [text.get_text() for text in figure.axes[0].texts] == ["zero throughout"]

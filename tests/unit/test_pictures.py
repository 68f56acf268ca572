"""Pictures are figures: what a plot over time hands to its axes is what the result says, within its error."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D

from robodyn_cli.errors import RobodynError
from robodyn_cli.over.commands import functions
from robodyn_cli.report import draw
from robodyn_cli.report.drawing.places import moving_paths
from robodyn_cli.report.overlay import draw_over
from robodyn_cli.report.page.charts import Arrays, chart_data
from robodyn_cli.report.registry import applicable
from robodyn_cli.report.time_sheet import DECISIVE, MARKED
from robodyn_cli.results.moments import WORDS
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import meaningful_error, meaningful_until
from robodyn_cli.scene.load import load_scene
from tests.unit.synthetic_results import chain_result, four_bar_result, inverse_result, pendulum_result
from tests.unit.test_page import unpacked

CONFIGS = Path(__file__).parents[2] / "configs"
ROUNDING = 1e-12  # of the largest value of the same kind
Array = np.ndarray[Any, Any]


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=DeprecationWarning, module="matplotlib|pyparsing")
        yield


# -- what each plot may show, from the datasets alone ---------------------------------------------------------
def columns(result: Result, *paths: str) -> list[Array]:
    return [x for path in paths for x in np.atleast_2d(result[path].T)]


def lengths(result: Result, group: str, letter: str) -> list[Array]:
    items = result.group(group).values()
    return [np.linalg.norm(v.data[:, [n[0] == letter for n in v.names]], axis=1) for v in items]


def drifts(result: Result) -> list[Array]:
    work = result["energy/work"] if "energy/work" in result else np.zeros(len(result.time))
    change = result["energy/total"] - work
    return [np.abs(change - change[0])]


def energies(result: Result) -> list[Array]:
    own = columns(result, *(f"energy/{name}" for name in result.group("energy")))
    datum = result["energy/potential"][0] if "energy/potential" in result else 0.0
    return own + [x - datum for x in own]


def multiplier_sizes(result: Result) -> list[Array]:
    data, variable = np.abs(result["constraints/multipliers"]), result.variables["constraints/multipliers"]
    units = variable.column_units or (variable.units,) * data.shape[1]
    groups = [[k for k, u in enumerate(units) if u == one] for one in set(units)]
    rows = (result.summary.get("lock") or {}).get("multipliers", {}).get("rows") or variable.names
    groups += [[k for k in group if variable.names[k] in rows] for group in groups]
    return [*data.T, *(np.linalg.norm(data[:, group], axis=1) for group in groups)]


SHOWN: dict[str, Callable[[Result], list[Array]]] = {
    "joint_angles": lambda r: columns(r, "q"),
    "joint_rates": lambda r: columns(r, "qd"),
    "joint_accelerations": lambda r: columns(r, "qdd"),
    "torques": lambda r: columns(r, "tau"),
    "torque_terms": lambda r: columns(r, "tau", *(f"torque_terms/{name}" for name in r.group("torque_terms"))),
    "energy": energies,
    "energy_drift": drifts,
    "multipliers": multiplier_sizes,
    "reactions": lambda r: [x for g in ("reactions", "loop_reactions") for k in "fm" for x in lengths(r, g, k)],
    "singular_values": lambda r: [
        x for p in ("psi", "passive") if f"singularity/{p}" in r for x in np.sort(r[f"singularity/{p}"], axis=1).T
    ],
    "constraint_residual": lambda r: [
        np.abs(v.data).max(axis=1) for k, v in r.group("constraints").items() if k.endswith("residual") and v.data.size
    ],
    "point_motion": lambda r: [
        np.linalg.norm(v.data, axis=1)
        for g in ("point_velocities", "point_accelerations") for v in r.group(g).values()
    ],
    "point_coordinates": lambda r: [x for path in moving_paths(r).values() for x in path.T],
    "transmission_angle": lambda r: [np.degrees(r["transmission_angle"])],
    "tracking": lambda r: columns(r, "control/reference", "control/error", "control/torque")
    + list((r["control/reference"] - r["control/error"]).T),
    "limits": lambda r: columns(r, "limits/use"),
}  # fmt: skip
ARE_ERRORS = ("energy_drift", "constraint_residual")
BOUNDED = {"joint_angles": "q", "joint_rates": "qd", "torques": "tau"}


def lines_of(ax: Any) -> list[Line2D | Array]:
    """Return the curves of a panel: lines in its own coordinates that no other plot of a result has too."""
    own = [x for x in ax.lines if x.get_transform() == ax.transData and len(x.get_xdata()) > 0]
    # what sensors show is a difference of steps and a curve
    own = [x for x in own if x.get_alpha() is None or x.get_zorder() != 1]
    groups = [
        c for c in ax.collections if isinstance(c, LineCollection) and c.get_transform() == ax.transData
    ]
    joined = [segment for group in groups for segment in group.get_segments()]
    return [np.column_stack(np.asarray(x.get_data(), dtype=float)) for x in own] + joined


def panels(figure: Any) -> list[Any]:
    return [ax for ax in figure.axes if ax.lines or len(ax.collections)]


def words(figure: Any) -> str:
    return "\n".join(text.get_text() for text in figure.texts)


def tolerance(result: Result, name: str, series: list[Array]) -> float:
    """Return what may be drawn as zero: the error that is stated, or rounding of the largest value of any kind."""
    error = meaningful_error(result, {**BOUNDED, "tracking": "q", "energy": "energy/total"}.get(name, ""))
    size = float(np.nanmax(np.abs(series), initial=0.0))
    if name == "energy_drift":
        size = max(size, *(float(np.abs(v.data).max()) for v in result.group("energy").values()))
    if name == "constraint_residual":  # of coordinates of some metre, and of the speed of the mechanism
        size = max(1.0, 5.0 * float(np.abs(result["qd"]).max(initial=0.0))) if "qd" in result else 1.0
    return float(np.fmax(error, ROUNDING * size))


def offset(time: Array, values: Array, x: Array, y: Array, width: float) -> float:
    """Return how far a curve is from the samples (T,) that are as near to its points in time as ``width``."""
    low, high = np.searchsorted(time, x - width, "left"), np.searchsorted(time, x + width, "right")
    if not (high > low).all():
        return np.inf
    if not width:
        return float(np.max(np.abs(values[low] - y), initial=0.0))
    return max(float(np.nanmin(np.abs(values[a:b] - v))) for a, b, v in zip(low, high, y))


def check_lines(result: Result, name: str, figure: Any) -> None:
    """Each point of each curve is a sample of one dataset; crests stand in the middle of their bin."""
    series = [np.where(np.abs(x) < 1e100, x, np.nan) for x in SHOWN[name](result)]
    least, time = tolerance(result, name, series), result.time
    width = float(time[-1] - time[0]) / 240.0 if name in ARE_ERRORS else 0.0
    count = 0
    for ax in panels(figure):
        for line in lines_of(ax):
            x, y = line[np.isfinite(line).all(axis=1)].T
            if len(x) == 1 and len(time) > 1 and x[0] not in time:
                continue  # a mark of growth, between samples
            if name in (
                "tracking",
                "torques",
            ):  # corners of held torques stand between samples, see test_held_lines
                x, y = x[np.isin(x, time)], y[np.isin(x, time)]
            off = min(offset(time, own, x, y, width) for own in series)
            assert off <= least + 1e-9 * float(np.abs(y).max(initial=0.0)), (name, off, least)
            count += 1
    assert count


def check_axes(result: Result, name: str, figure: Any) -> None:
    """No axis shows rounding at full height, and none on a logarithmic scale has a zero within it unmarked."""
    series = SHOWN[name](result)
    for ax in panels(figure):
        low, high = ax.get_ylim()
        curves = [line[:, 1] for line in lines_of(ax)]
        values = np.concatenate(curves) if curves else np.zeros(1)
        values = values[np.isfinite(values)]
        if ax.get_yscale() == "log":
            assert low > 0.5 * ROUNDING * min(high, float(values.max())), (name, low, high)
            zeros = [line[line[:, 1] == 0.0, 0] for line in lines_of(ax)]
            marked = [
                x
                for x in ax.lines
                if x.get_transform() == ax.get_xaxis_transform() and not np.any(np.nan_to_num(x.get_ydata()))
            ]
            at = np.concatenate(
                [np.asarray(x.get_xdata())[np.isfinite(x.get_ydata())] for x in marked] or [np.empty(0)]
            )
            bin_width = (result.time[-1] - result.time[0]) / 240.0
            for t in np.concatenate(zeros) if zeros else ():
                assert np.any(np.abs(at - t) <= bin_width), (name, t)
        elif values.size and name not in ARE_ERRORS:
            level = float(np.abs(values).max())
            assert high - low > ROUNDING * level and (level > 0.0 or high - low >= 1e-3 or series), name


def check_errors(result: Result, name: str, figure: Any) -> None:
    """The errors are told in a line, and drawn where they are broader than a line."""
    said = words(figure)
    assert name in ARE_ERRORS or "Errors: " in said or "No error" in said, name
    if name not in BOUNDED or len(result.time) < 2 or any(ax.images for ax in figure.axes):
        return
    error, seen = meaningful_error(result, BOUNDED[name]), False
    for ax in panels(figure):
        bands = [x for x in ax.collections if isinstance(x, PolyCollection)]
        low, high = ax.get_ylim()
        points = 72.0 * ax.get_position().height * figure.get_size_inches()[1]
        assert bool(bands) == bool(2.0 * error * points > 1.5 * (high - low)), name
        for band in bands:
            seen = True
            for path in band.get_paths():
                x, y = path.vertices.T
                for t in np.unique(x):
                    assert np.ptp(y[x == t]) == pytest.approx(2.0 * error, rel=1e-6, abs=1e-12 * (high - low))
                assert x.max() <= meaningful_until(result.summary)
    assert ("(bands)" in said) == seen and ("(under the lines)" in said) == (np.isfinite(error) and not seen)


def check_hatched(result: Result, name: str, figure: Any) -> None:
    until = meaningful_until(result.summary)
    lost = until < result.time[-1]
    assert ("Hatched: not meaningful after" in words(figure)) == lost, name
    for ax in panels(figure):
        if ax.get_xlabel() == "" and not any(line.get_transform() == ax.transData for line in ax.lines):
            continue
        hatched = [patch for patch in ax.patches if patch.get_hatch()]
        assert len(hatched) == (1 if until < ax.get_xlim()[1] else 0), name
        for patch in hatched:
            assert patch.get_x() == max(until, ax.get_xlim()[0])
            assert patch.get_x() + patch.get_width() == pytest.approx(ax.get_xlim()[1])


def check_page(result: Result, figure: Any) -> None:
    """Curves of a page have the zeros of the figure, so that its legend reads off zero where a result is zero."""
    arrays = Arrays()
    data = chart_data(figure, arrays)
    if data is None:
        return
    for ax, panel in zip(panels(figure), data["panels"]):
        assert len(panel["errors"]) == sum(isinstance(x, PolyCollection) for x in ax.collections)
        assert sum(band["hatched"] for band in panel["bands"]) == sum(bool(x.get_hatch()) for x in ax.patches)
        for line, artist in zip(panel["lines"], ax.lines):
            # rates of which only the sign counts are zero
            y = np.asarray(artist.get_ydata(), dtype=np.float32)
            assert np.any(unpacked(arrays, line["y"]) == 0.0) == np.any(y == 0.0)


def check(result: Result) -> set[str]:
    """Check all plots over time of a result; return their names."""
    names = [name for name in applicable(result) if name in SHOWN]
    for name in names:
        figure = draw(result, name)
        if not any(ax.images for ax in figure.axes):
            check_lines(result, name, figure)
            check_axes(result, name, figure)
        check_errors(result, name, figure)
        check_hatched(result, name, figure)
        check_page(result, figure)
    return set(names)


# -- scenes ---------------------------------------------------------------------------------------------------
SCENES = {
    "2r_circle": "inverse", "2r_drives": "inverse", "arm_weightless": "inverse", "seven_joint_arm": "inverse",
    "trajectories/fastest_2r": "inverse", "mechanisms/five_bar_circle": "inverse", "mechanisms/lift_arm": "inverse",
    "mechanisms/four_bar_kinematics": "kinematics", "mechanisms/four_bar_locked": "deploy", "controlled_arm": "simulate",
    "double_pendulum": "simulate", "stick_slip": "simulate", "parallelogram": "deploy",
    "benchmarks/stewart_platform": "simulate", "benchmarks/adams_rev_spherical": "simulate",
    "benchmarks/adams_lin_actuator": "simulate",
}  # fmt: skip
DRAWN: set[str] = set()
RAN: set[str] = set()


def made(scene: str) -> Result:
    loaded, command = load_scene(CONFIGS / f"{scene}.yaml"), SCENES[scene]
    try:
        return functions[command](loaded)
    except RobodynError as error:  # a run that is meant to fail has its pictures too
        assert isinstance(error.result, Result)
        return error.result


@pytest.mark.parametrize("scene", SCENES)
def test_what_is_drawn_of_example_scenes_is_what_was_computed(scene: str) -> None:
    DRAWN.update(check(made(scene)))
    RAN.add(scene)


def test_all_plots_over_time_were_checked() -> None:
    if set(SCENES) == RAN:  # in this process, long cases too
        assert set(SHOWN) - {"point_motion"} <= DRAWN


# -- awkward results ------------------------------------------------------------------------------------------
def stated(result: Result, **errors: float) -> Result:
    result.summary["error_estimate"] = {"method": "m", **errors}
    return result


def noisy(result: Result, path: str, column: int, size: float) -> Result:
    rng = np.random.default_rng(5)
    result[path][:, column] = size * rng.integers(-3, 4, len(result.time))
    return result


def stretched(result: Result, factor: float) -> Result:
    result.time[:] = factor * result.time
    return result


def latched() -> Result:
    """Multipliers of a latch that closes: zero before, and a single one of them again afterwards."""
    result = four_bar_result()
    load = result["constraints/multipliers"]
    load[:600] = 0.0
    load[900] = 0.0
    load[700] = 1e-15
    return result


def zeros(result: Result) -> Result:
    for path, variable in result.variables.items():
        if path != "time":
            variable.data[:] = 0.0
    return result


AWKWARD: dict[str, Callable[[], Result]] = {
    "zero torques": lambda: zeros(inverse_result(101)),
    "zero motion": lambda: zeros(pendulum_result(101)),
    "zero loads": lambda: zeros(four_bar_result(101)),
    "a latch": latched,
    "one sample": lambda: inverse_result(1),
    "one sample of a mechanism": lambda: four_bar_result(1),
    "one sample with an error": lambda: stated(pendulum_result(1), q_max=0.3, qd_max=0.1),
    "two samples": lambda: pendulum_result(2),
    "thirty joints": lambda: chain_result(30),
    "twelve joints": lambda: stated(chain_result(12), q_max=0.2, qd_max=1e-9),
    "a nanosecond": lambda: stretched(pendulum_result(301), 1e-10),
    "a century": lambda: stretched(four_bar_result(), 3e8),
    "torques of rounding": lambda: noisy(inverse_result(301), "tau", 1, 2e-15),
    "terms of rounding": lambda: noisy(inverse_result(301), "torque_terms/coriolis", 0, 7e-15),
    "a joint that rests": lambda: noisy(chain_result(3), "q", 1, 2e-16),
    "a large error": lambda: stated(pendulum_result(301), q_max=0.05, qd_max=1e-9),
    "a known error": lambda: stated(pendulum_result(301), q_max=1e-10, qd_max=3e-10),
    "a lost motion": lambda: stated(pendulum_result(20_001), q_max=5.0, qd_max=9.0, meaningful_until=6.0),
    "no estimate": lambda: stated(pendulum_result(301), reason="the second integration failed"),
}  # fmt: skip


@pytest.mark.parametrize("kind", AWKWARD)
def test_what_is_drawn_of_awkward_results_is_what_they_hold(kind: str) -> None:
    assert check(AWKWARD[kind]())


def levels(ax: Any) -> list[float]:
    return [float(np.nanmax(np.abs(line[:, 1]))) for line in lines_of(ax)]


def test_zeros_before_a_latch_stay_zero() -> None:
    """The floor of a logarithmic axis is no value: 0.0479 N m before a latch closes was none of it."""
    result = latched()
    figure = draw(result, "multipliers")
    before = result.time[599]
    for ax in figure.axes[:1]:
        assert ax.get_yscale() == "log"
        for line in lines_of(ax)[:3]:
            assert not np.any(line[line[:, 0] <= before, 1])
        transform = ax.transScale.transform(np.array([[0.0, 0.0]]))
        assert not np.isfinite(transform[0, 1]), "no line leads down to a zero"
    assert "lower edge: zero or rounding" in words(figure).replace("\n", " ")


def test_rounding_is_said_to_be_zero_beside_peers() -> None:
    result = noisy(inverse_result(301), "tau", 1, 2e-15)
    figure = draw(result, "torques")
    assert "Drawn as zero, within rounding or error: theta2 (6·10⁻¹⁵ N·m)" in words(figure).replace("\n", " ")
    assert len(figure.axes) == 1 and figure.axes[0].get_ylim()[1] > 100.0
    resting = noisy(chain_result(3), "q", 1, 2e-16)
    resting["q"][:, 1] += 0.7
    resting["q"][:, [0, 2]] = resting["q"][:, [1]]
    low, high = draw(resting, "joint_angles").axes[0].get_ylim()
    assert low < 0.65 and high > 0.75, "steps of rounding are no picture"


def test_a_motion_within_its_error_is_zero_and_one_beyond_is_not() -> None:
    result = stated(pendulum_result(301), q_max=1e-6, qd_max=1e-6)
    result["q"][:, 1] = 0.9e-6 * np.sin(result.time)
    assert levels(draw(result, "joint_angles").axes[0])[1] == 0.0
    result["q"][:, 1] *= 2.0
    assert levels(draw(result, "joint_angles").axes[0])[1] == pytest.approx(1.8e-6, rel=0.01)


def test_the_error_of_a_lost_motion_is_that_of_its_meaningful_part() -> None:
    """The time until which it is meaningful is defined by an error of 1 % of the range of all its coordinates."""
    result = stated(pendulum_result(301), q_max=5.0, qd_max=1e-9, meaningful_until=6.0)
    ranges = {path: float(np.ptp(result[path], axis=0).max()) for path in ("q", "qd")}
    assert meaningful_error(result, "q") == pytest.approx(0.01 * ranges["q"])
    assert meaningful_error(result, "qd") == 1e-9
    assert f"until {6} s" in words(draw(result, "joint_angles"))


def test_results_over_one_another_have_their_errors_and_are_hatched() -> None:
    one = stated(pendulum_result(301), q_max=0.2, qd_max=1e-9)
    other = stated(pendulum_result(301), q_max=5.0, qd_max=9.0, meaningful_until=6.0)
    figure = draw_over({"one": one, "other": dataclasses.replace(other)}, "joint_angles")
    said = words(figure)
    assert "one: Errors: largest error of q 0.2" in said and "Hatched: not meaningful after t = 6 s" in said
    for ax in figure.axes:
        assert any(patch.get_hatch() for patch in ax.patches)
        assert any(isinstance(item, PolyCollection) for item in ax.collections)


def test_each_kind_of_moment_has_a_mark() -> None:
    assert set(WORDS) <= {*DECISIVE, *MARKED}

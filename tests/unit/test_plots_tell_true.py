"""No plot draws a line through what its samples do not show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import simulate
from robodyn_cli.over.commands import functions
from robodyn_cli.report import draw
from robodyn_cli.report.drawing.build import make_drawing, paths_of
from robodyn_cli.report.drawing.camera import View, default_camera
from robodyn_cli.report.drawing.strokes import TRAIL, strokes
from robodyn_cli.report.figures import alarms
from robodyn_cli.report.lines import envelope
from robodyn_cli.report.overlay import draw_over
from robodyn_cli.report.registry import Drawings, doubts
from robodyn_cli.results.result import Result
from robodyn_cli.results.sampling import is_sparse, too_far_apart
from robodyn_cli.scene.load import load_scene
from robodyn_cli.works.reach import reach
from tests.unit.synthetic_results import pendulum_result

CONFIGS = Path(__file__).parents[2] / "configs"


def swinging(per_period: float, samples: int = 201, accelerations: bool = True) -> Result:
    """One joint that swings, with so many samples a period, and what its energy would be."""
    time = np.linspace(0.0, 10.0, samples)
    w = 2.0 * np.pi / (per_period * time[1])
    q, qd = np.sin(w * time + 0.3), w * np.cos(w * time + 0.3)
    result = Result("simulate", "Swing", "ok", "schema: 1\n")
    result.add("time", time)
    result.add("q", q[:, None], units="m", names=("x",))
    result.add("qd", qd[:, None], units="m/s", names=("x",))
    if accelerations:
        result.add("qdd", -(w**2) * q[:, None], units="m/s^2", names=("x",))
    for kind, values in (
        ("kinetic", 0.5 * qd**2),
        ("potential", 0.5 * w**2 * q**2),
        ("total", 0.5 * w**2 + 0.0 * q),
    ):
        result.add(f"energy/{kind}", values)
    return result


def crank(turned: float, samples: int = 101) -> Result:
    """A crank that turns evenly, so far between two samples [rad], and its end."""
    time = np.linspace(0.0, 10.0, samples)
    speed = turned / time[1]
    angle = speed * time
    result = Result("simulate", "Crank", "ok", "schema: 1\n")
    result.add("time", time)
    result.add("q", angle[:, None], units="rad", names=("crank",))
    result.add("qd", np.full((samples, 1), speed), units="rad/s", names=("crank",))
    result.add("qdd", np.zeros((samples, 1)), units="rad/s^2", names=("crank",))
    result.add("points/end", np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1))
    for kind, values in (
        ("kinetic", 0.0 * angle + 2.0),
        ("potential", np.sin(angle)),
        ("total", 2.0 + np.sin(angle)),
    ):
        result.add(f"energy/{kind}", values)
    return result


def drawn(figure: Any, panel: int = 0) -> tuple[int, int]:
    """Return how many stretches are joined by lines in a panel, and how many samples stand alone as dots."""
    lines = [
        line for line in figure.axes[panel].lines if line.get_transform() == figure.axes[panel].transData
    ]
    joined = [np.diff(line.get_ydata()) for line in lines if line.get_linestyle() != "None"]
    dots = [line.get_ydata() for line in lines if line.get_linestyle() == "None" and line.get_marker() == "."]
    return sum(int(np.isfinite(x).sum()) for x in joined), sum(map(len, dots))


@pytest.mark.parametrize(("per_period", "sparse"), [(40.0, False), (12.0, False), (4.5, True), (1.3, True)])
def test_positions_and_rates_are_dots_where_their_own_rates_say_so(per_period: float, sparse: bool) -> None:
    result = swinging(per_period)
    for name in ("joint_angles", "joint_rates"):
        lines, dots = drawn(draw(result, name))
        assert (lines == 0 and dots == 201) if sparse else (lines == 200 and dots == 0)
    assert is_sparse(result) == sparse
    told = doubts(result, Drawings())
    assert bool(told) == sparse and all("too far apart" in line for line in told)
    assert any("too far apart" in line for line in alarms(result)) == sparse


def test_samples_that_meet_each_period_again_do_not_hide_it() -> None:
    """Values stand still, rates do not."""
    result = swinging(1.0)
    assert np.ptp(result["q"]) < 1e-9 and too_far_apart(result, "q").all()


def test_energies_go_twice_as_often_as_the_motion() -> None:
    result = swinging(8.0)
    assert not too_far_apart(result, "q").any()
    assert too_far_apart(result, "energy/potential").any() and too_far_apart(result, "energy/kinetic").any()
    assert not any(too_far_apart(swinging(40.0), f"energy/{x}").any() for x in ("kinetic", "potential"))


def test_what_turns_evenly_is_drawn_and_what_follows_from_its_direction_is_not() -> None:
    result = crank(2.0)
    assert drawn(draw(result, "joint_angles")) == (100, 0) == drawn(draw(result, "joint_rates"))
    figure = draw(result, "point_coordinates")
    assert drawn(figure) == (0, 101) and "too far apart" in "".join(text.get_text() for text in figure.texts)
    assert (
        not too_far_apart(result, "energy/kinetic").any() and too_far_apart(result, "energy/potential").all()
    )
    assert drawn(draw(crank(0.2), "point_coordinates")) == (100, 0)


def test_a_part_that_swings_faster_has_dots_and_the_rest_its_line() -> None:
    result = swinging(40.0)
    t = result.time
    fast = t > 7.0
    result["q"][fast, 0], result["qd"][fast, 0] = np.sin(40.0 * t[fast]), 40.0 * np.cos(40.0 * t[fast])
    missed = too_far_apart(result, "q")[:, 0]
    assert not missed[t[1:] < 6.9].any() and missed[t[:-1] > 7.1].all()
    lines, dots = drawn(draw(result, "joint_angles"))
    assert 130 < lines < 145 and 55 < dots < 70


def test_nothing_is_missed_at_rest_of_rounding_or_where_something_happens() -> None:
    result = swinging(40.0)
    result["q"][:], result["qd"][:] = 1.0 + 1e-16 * np.arange(201)[:, None], 1e-9
    assert not too_far_apart(result, "q").any() and not is_sparse(result)
    result = swinging(40.0, accelerations=False)
    result["q"][:, 0], result["qd"][:, 0] = abs(result.time - 5.02), np.sign(result.time - 5.02) * 20.0
    result["qd"][:, 0] /= 20.0
    result.add("qdd", 0.0 * result["qd"], units="m/s^2", names=("x",))
    assert too_far_apart(result, "qd").any()
    result.events.append({"time": 5.02, "kind": "impact", "name": "x"})
    assert not too_far_apart(result, "qd").any()
    single = Result("simulate", "One", "ok", "")
    single.add("time", np.zeros(1))
    assert too_far_apart(single).shape == (0, 1)


def test_results_over_one_another_have_dots_too() -> None:
    lines, dots = drawn(draw_over({"coarse": swinging(4.0), "fine": swinging(40.0)}, "joint_angles"))
    assert (lines, dots) == (200, 201)


def test_a_long_line_keeps_its_gaps() -> None:
    x = np.arange(50_000.0)
    y = np.sin(x / 900.0)
    y[20_000:20_003] = np.nan
    thin_x, thin_y = envelope(x, y)
    assert len(thin_x) < 6000 and np.isnan(thin_y).sum() >= 1
    gap = int(np.flatnonzero(np.isnan(thin_y))[0])
    assert thin_x[gap - 1] < thin_x[gap] < thin_x[gap + 1] and 19_990 < thin_x[gap] < 20_010


def test_root_mean_squares_stand_on_no_negative_level() -> None:
    result = pendulum_result(201)
    wave = np.sin(result.time)
    for mean, level in ((0.0, 0.7), (-5.0, None)):
        result.add("tau", (wave + mean)[:, None], names=("theta1",), units="N m")
        (ax,) = draw(result, "torques").axes
        levels = [float(line.get_ydata()[0]) for line in ax.lines if line.get_linewidth() == 0.8]
        assert levels == ([] if level is None else [pytest.approx(level, abs=0.05)])


@pytest.mark.parametrize("name", ["double_pendulum", "bouncing_pendulum", "four_bar_deploy", "spinning_top"])
def test_examples_have_lines(name: str) -> None:
    """Their samples show their motion."""
    scene = load_scene(CONFIGS / f"{name}.yaml")
    result = functions[str(scene.command)](scene)
    assert not is_sparse(result)
    for path in ("q", "qd", "energy/kinetic"):
        assert path not in result or not too_far_apart(result, path).mean() > 0.02, path


def test_an_example_with_few_samples_has_dots() -> None:
    result = functions["simulate"](load_scene(CONFIGS / "double_pendulum.yaml", ["simulate.samples=41"]))
    assert is_sparse(result) and drawn(draw(result, "joint_angles"))[0] == 0


def test_coordinates_of_several_results_are_not_called_a_path() -> None:
    said = [
        text.get_text()
        for text in draw_over({"a": pendulum_result(51), "b": pendulum_result(51)}, "tip_path").texts
    ]
    assert any(text.startswith("Coordinates of the named points of 2 results") for text in said)


def test_branches_that_look_the_same_share_a_picture() -> None:
    """A wrist that flips moves no link: the eight branches of a Puma are four pictures, each with both names."""
    result = reach(load_scene(CONFIGS / "mechanisms/puma_reach.yaml"))
    assert len(result["branches/q"]) == 8
    figure = draw(result, "branches")
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert len(titles) == 4 and all(len(set(title.split("\n"))) == 2 for title in titles)
    names = {line.removesuffix(", chosen") for title in titles for line in title.split("\n")}
    assert names == {f"{side}, elbow {way}, {flip}" for side in ("righty", "lefty") for way in ("up", "down")
                     for flip in ("flip", "no flip")}  # fmt: skip
    (note,) = [text.get_text() for text in figure.texts if "share a picture" in text.get_text()]
    assert note.startswith("8 branches")


def test_paths_are_dots_where_joint_angles_are() -> None:
    """A pendulum that swings more than once between two samples: rates fit lines by chance here and there."""
    far = ["simulate.error_estimate=false", "simulate.samples=201", "simulate.duration=500"]
    near = [*far[:2], "simulate.duration=5"]
    for changes, sparse in ((far, True), (near, False)):
        result = simulate(load_scene(CONFIGS / "double_pendulum.yaml", changes))
        assert too_far_apart(result, "q").any(axis=1).all() == sparse
        for name, (_, path) in paths_of(result).items():
            joined = np.isfinite(path[1:]).all(axis=1) & np.isfinite(path[:-1]).all(axis=1)
            assert joined.any() != sparse, name
        view = View(drawing := make_drawing(result), default_camera(drawing))
        trails = [stroke for stroke in strokes(view, 0) if stroke.layer == TRAIL]
        dots = [stroke for stroke in trails if stroke.closed]
        assert len(dots) == (len(result.time) * len(drawing.trails) if sparse else 0)
        for name in ("mechanism", "tip_path"):
            said = " ".join(text.get_text() for text in draw(result, name).texts)
            assert ("dots where samples" in " ".join(said.split())) == sparse

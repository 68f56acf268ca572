"""Kinematic analysis: closed forms, rates against differences, mobility, ends of a sweep, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text
from robodyn_cli.cli.figure_words import figure_lines
from robodyn_cli.errors import GeometryError, RobodynError, SceneError, SingularConfigurationError
from robodyn_cli.report.registry import draw
from robodyn_cli.results.result import Result
from robodyn_cli.works.kinematics import kinematics
from tests.mechanisms import BENNETT, CONFIGS, SIX_BAR, SLIDER, close

SCENE = CONFIGS / "mechanisms" / "four_bar_kinematics.yaml"


def turn(*overrides: str) -> Result:
    return kinematics(load_scene(SCENE, overrides))


def of(text: str, *overrides: str) -> Result:
    return kinematics(load_scene_text("schema: 1\n" + text, overrides=overrides))


def test_rocker_in_closed_form() -> None:
    """Freudenstein: the rocker's angle is the direction to the pin, the intersection of two circles."""
    result = turn()
    crank = result["q"][:, 0]
    a = 0.4 * np.stack([np.cos(crank), np.sin(crank)], axis=1)
    d = a - [1.0, 0.0]
    f = np.linalg.norm(d, axis=1)
    inner = np.arccos((0.9**2 + f**2 - 1.2**2) / (2 * 0.9 * f))
    close(np.cos(result["q"][:, 2]), np.cos(np.arctan2(d[:, 1], d[:, 0]) - inner), 1e-12)
    mu = np.arccos((1.2**2 + 0.9**2 - f**2) / (2 * 1.2 * 0.9))
    close(result["transmission_angle"], mu, 1e-12)
    assert result.time[-1] == pytest.approx(np.pi)
    close(result["qd"][:, 0], 2.0, 1e-14)
    assert len(draw(result, "transmission_angle").axes) == 1 and len(draw(result, "point_motion").axes) == 2


def test_rates_and_accelerations_are_derivatives() -> None:
    result = turn("kinematics.samples=4001")
    h, inner = result.time[1], slice(5, -5)
    for path, rate in (
        ("q", "qd"), ("qd", "qdd"), ("points/trace", "point_velocities/trace"),
        ("point_velocities/trace", "point_accelerations/trace"),
    ):  # fmt: skip
        x = result[path]
        slope = (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12 * h)
        close(slope[inner], result[rate][2:-2][inner], 1e-8)


def test_mobility_by_counting_and_by_rank() -> None:
    plane = turn("kinematics.samples=11").summary["mobility"]
    assert (plane["actual"], plane["count"], plane["planar_count"], plane["redundant_rows"]) == (1, -2, 1, 0)
    sweep = "kinematics={samples: 21, sweep: {joint: j1, start: 1, stop: 2}}"
    bennett = of(BENNETT, sweep).summary["mobility"]
    assert (bennett["actual"], bennett["count"], bennett["rank"], bennett["redundant_rows"]) == (1, -2, 2, 3)
    spatial = kinematics(
        load_scene(
            CONFIGS / "benchmarks" / "spatial_slider_crank.yaml",
            ["kinematics={samples: 41, sweep: {joint: crank, start: 0, stop: 360 deg}}"],
        )
    )
    assert spatial.summary["mobility"]["actual"] == spatial.summary["mobility"]["count"] == 1
    # the ball stays at the distance of the rod from the slider (Haug 1989)
    pin = np.stack(
        [0 * spatial.time, 0.1 - 0.08 * np.sin(spatial["q"][:, 0]), 0.12 + 0.08 * np.cos(spatial["q"][:, 0])]
    )
    slider = np.stack([spatial["q"][:, 1], 0 * spatial.time, 0 * spatial.time])
    close(np.linalg.norm(pin - slider, axis=0), 0.3, 1e-13)


def test_a_sweep_ends_at_the_dead_point() -> None:
    """The rocker cannot go beyond crank and coupler in line; what was reached is kept."""
    limit = np.pi - np.arccos((0.9**2 + 1 - 0.8**2) / (2 * 0.9))
    with pytest.raises(SingularConfigurationError) as caught:
        turn(
            "kinematics.sweep={joint: rocker, start: 1.5, stop: 3}",
            "initial.q={crank: 0.6, coupler: 0.2, rocker: 1.5}",
        )
    error: RobodynError = caught.value
    assert error.details["time"] + 1.5 == pytest.approx(limit, abs=1e-6)
    assert error.details["loop"] == "pin" and error.details["joint"] in ("crank", "coupler")
    result: Result = error.result  # type: ignore[attr-defined]
    assert result.status == "failed" and 0.0 < result.time[-1] < error.details["time"]


def test_rates_that_contradict_each_other_are_no_dead_point() -> None:
    """One degree of freedom and two leads: of held joints the message names the key that holds them."""
    q = "initial.q={crank: 0.6, coupler: 0.2, rocker: 1.5}"
    start = turn("kinematics.sweep={joint: rocker, start: 1.5, stop: 1.6}", q)["q"][0].tolist()
    closed = f"initial={{q: {{crank: {start[0]!r}, coupler: {start[1]!r}, rocker: 1.5}}, hold: [crank]}}"
    with pytest.raises(
        GeometryError, match=r"'initial\.hold' keeps crank where it is, .* let rocker move"
    ) as caught:
        turn("kinematics.sweep={joint: rocker, start: 1.5, stop: 1.6}", closed)
    assert caught.value.details["key"] == "initial.hold"
    both = f"trajectory={{type: joint, duration: 1, q: {{crank: '{start[0]!r} + t', rocker: '1.5 + t'}}}}"
    with pytest.raises(GeometryError, match=r"led \(crank, rocker\) contradict each other"):
        turn("kinematics.sweep=null", both, q)
    slow = "kinematics.sweep={joint: rocker, start: 1.5, stop: 1.6, rate: 1e-9}"
    with pytest.raises(GeometryError, match="keeps crank"):
        turn(slow, closed)


def test_trajectories_prescribed_joints_and_open_chains_move_too() -> None:
    moves = "trajectory={type: joint, duration: 1, q: {crank: '1 + t'}}"
    led = of(SIX_BAR, moves, "kinematics.samples=11", "initial.q.crank=1")
    same = of(
        SIX_BAR, "prescribed={crank: '1 + t'}", "torques=null", "simulate.duration=1", "kinematics.samples=11"
    )
    close(led["q"], same["q"], 1e-12)
    close(led["qdd"], same["qdd"], 1e-10)
    arm = kinematics(load_scene(CONFIGS / "2r_circle.yaml"))
    assert np.abs(np.linalg.norm(arm["point_velocities/tip"], axis=1) - 0.2 * 0.2 * np.pi).max() < 1e-12
    swung = kinematics(
        load_scene(CONFIGS / "double_pendulum.yaml", ["kinematics.sweep={joint: theta2, start: 0, stop: 1}"])
    )
    assert np.ptp(swung["q"][:, 0]) == 0.0 and swung["q"][-1, 1] == pytest.approx(1.0)
    assert "mobility" not in swung.summary


def test_what_is_refused() -> None:
    with pytest.raises(SceneError, match="nothing moves"):
        of(SLIDER)
    with pytest.raises(SceneError, match="unknown joint 'cranc'"):
        turn("kinematics.sweep.joint=cranc")
    with pytest.raises(SceneError, match="allowed: another position"):
        turn("kinematics.sweep.stop=0")
    with pytest.raises(SceneError, match="unknown point 'pim'"):
        turn("kinematics.transmission=[bar.origin, pim, base.pivot]")


def test_bifurcations_are_told_from_dead_points() -> None:
    """The parallelogram led through its flat pose: the loop itself loses rank there."""
    sweep = "kinematics={samples: 101, sweep: {joint: theta1, start: 60 deg, stop: -60 deg}}"
    q = "initial={q: {theta1: 60 deg, phi2: -60 deg, phi1: 60 deg}}"
    with pytest.raises(SingularConfigurationError) as caught:
        kinematics(load_scene(CONFIGS / "parallelogram.yaml", [sweep, q]))
    assert caught.value.details["kind"] == "bifurcation" and caught.value.details["loop"] == "pin"
    assert caught.value.details["time"] == pytest.approx(np.pi / 3, abs=1e-3)


ARM = """\
gravity: [0, 0, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}
  links: [{name: l}, {name: m}]
  points: {tip: {link: m, at: [0.8, 0, 0]}}
initial: {q: {a: 0, b: 0.5}}
"""


def test_an_open_chain_has_no_figures_of_loops_and_none_of_rounding() -> None:
    turned = of(ARM, "kinematics={sweep: {joint: a, start: 0, stop: 3.1, rate: 1}}")
    swept, told = turned.summary, "\n".join(figure_lines(turned, True))
    assert "error_estimate" not in swept and "errors" not in told
    # a joint that rests is where it rests, a rate that is constant is that
    assert swept["joints"]["b"]["largest"] == 0.5 and swept["joints"]["a"]["peak_speed"] == 1.0
    assert "-0 " not in told
    straight = "trajectory={type: cartesian, point: tip, position: ['0.9 + 0.1*t', 0.2], duration: 3}"
    line = of(ARM, straight)
    tip = line.summary["points"]["tip"]
    assert 0.0 < tip["peak_acceleration"] <= tip["errors"]["peak_acceleration"]

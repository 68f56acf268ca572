"""``kinematics`` of mechanisms for many runs: what compiled runs and the command say is the same, errors too; places of
points at times, between samples as well."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.over.sensitivity.of_kinematics import PlacesTogether
from robodyn_cli.over.sensitivity.report import sensitivity
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, make_one, suits
from robodyn_cli.scene.load import Family, load_scene, load_scene_text
from robodyn_cli.trajectories.course import between
from robodyn_cli.works.kinematics import kinematics
from tests.many import compare_all

FIVE = Path(__file__).parents[2] / "configs" / "search" / "five_point_four_bar.yaml"
KEYS = (
    "robot.joints.coupler.origin.xyz#1",
    "robot.points.pin.at#1",
    "robot.points.tip.at#1",
    "robot.points.trace.at#2",
)
OF = tuple(f"at.{k}.points.trace.{axis}" for k in range(3) for axis in "xyz")


def task(*changes: str) -> Task:
    return Task(Family(FIVE, ("expect={}", "kinematics.at=[0, 1.37, 4]", *changes)), "kinematics", KEYS, OF)


@pytest.mark.parametrize("changes", [(), ("kinematics.samples=41",), ("kinematics.sweep.stop=-80 deg",)])
def test_compiled_runs_say_what_the_command_says(changes: tuple[str, ...]) -> None:
    asked = task(*changes)
    assert suits(asked)
    rng = np.random.default_rng(len(changes))
    values = rng.uniform((0.2, 0.8, 0.6, 0.2), (0.45, 1.3, 1.1, 0.7), size=(24, 4))
    made = Compiled(asked, 1).make(Points(np.arange(24), values))
    assert len(made) >= 16
    for run, row in list(zip(made.runs.tolist(), made.rows))[::4]:
        one = make_one(asked, run, values[run])[0].rows[0]
        assert np.abs(row["outputs"] - one["outputs"]).max() <= 1e-12
        np.testing.assert_allclose(row["errors"], one["errors"], rtol=1e-3, atol=1e-13)
        assert row["code"] == one["code"] == 0
    for run in set(range(24)) - set(made.runs.tolist()):  # what is left fails as a command
        assert make_one(asked, run, values[run])[0].rows["code"][0] in (4, 5)


@pytest.mark.parametrize(
    ("name", "changes", "keys"),
    [
        (
            "four_bar_kinematics",
            ("kinematics.at=[0.3, 1.7]",),
            ("robot.joints.crank.a", "robot.joints.coupler.a"),
        ),
        ("four_bar_kinematics", ("kinematics.samples=21",), ("robot.joints.rocker.a",)),
        ("five_bar_circle", ("outputs={}",), ("robot.joints.left.a", "robot.joints.bend_right.a")),
    ],
)
def test_every_figure_is_that_of_the_command(
    name: str, changes: tuple[str, ...], keys: tuple[str, ...]
) -> None:
    path = FIVE.parents[1] / "mechanisms" / f"{name}.yaml"
    keys_of = compare_all(Task(Family(path, ("expect={}", *changes)), "kinematics", keys, ()), 3)
    groups = {"joints", "mobility", "error_estimate", "samples", "termination"}
    assert groups <= {key.partition(".")[0] for key in keys_of}


def test_runs_that_meet_a_dead_point_are_left_to_the_command() -> None:
    asked = task("kinematics.sweep.stop=200 deg", "kinematics.samples=21")
    values = np.array([[0.35, 1.05, 0.8, 0.4], [0.5, 1.3, 0.3, 0.4], [0.5, 0.8, 0.35, 0.4]])
    made = Compiled(asked, 1).make(Points(np.arange(3), values))
    for run in range(3):
        one = make_one(asked, run, values[run])[0].rows[0]
        assert (run in made.runs) == (one["code"] == 0)


def test_runs_far_from_their_guess_are_left_to_the_command() -> None:
    """Newton's method goes farther there than the command lets it, and comes back, perhaps to another solution."""
    path = FIVE.parents[1] / "mechanisms" / "five_bar_circle.yaml"
    keys = tuple(f"robot.joints.{name}.a" for name in ("left", "bend_left", "right", "bend_right"))
    guess = "initial.q={left: 2.37, bend_left: -1.09, right: 1.07, bend_right: 0.85}"
    changes = ("command=kinematics", "expect={}", "outputs={}", "kinematics.samples=9", guess)
    asked = Task(Family(path, changes), "kinematics", keys, ())
    values = np.random.default_rng(1).uniform((0.35, 0.6, 0.35, 0.6), (0.75, 1.1, 0.75, 1.1), size=(16, 4))
    made = Compiled(asked, 1).make(Points(np.arange(16), values))
    assert 3 <= len(made) < 16
    for run in made.runs.tolist():
        assert make_one(asked, run, values[run])[0].rows[0]["code"] == 0


def slopes_of(compiled: Compiled, values: np.ndarray) -> np.ndarray:
    ((structure, rows),) = compiled.structures(values)
    assert len(rows) == len(values)
    return PlacesTogether()(structure, values, compiled.task.outputs)


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_of_places_side_by_side_are_those_of_the_runs(seed: int) -> None:
    """Of dimensions in closed loops and in an open chain, at samples and between them, by differences of order 4."""
    rng = np.random.default_rng(seed)
    asked = task(f"kinematics.at={sorted(rng.uniform(0.0, 4.0, 2).tolist()) + [4]}", "kinematics.samples=9")
    compiled = Compiled(asked, 1)
    values = rng.uniform((0.25, 0.9, 0.7, 0.3), (0.4, 1.2, 1.0, 0.6), size=(6, 4))
    rows = compiled.make(Points(np.arange(6), values))
    good = rows.runs[rows.rows["code"] == 0]
    slopes = slopes_of(compiled, values[good])
    assert len(good) >= 3 and np.isfinite(slopes).all()
    h = 1e-3
    for k in range(len(KEYS)):
        beside = np.repeat(values[good], 4, axis=0)
        beside[:, k] += np.tile(np.array([-2.0, -1.0, 1.0, 2.0]) * h, len(good))
        y = compiled.make(Points(np.arange(len(beside)), beside)).rows["outputs"].reshape(len(good), 4, -1)
        expected = (y[:, 0] - 8.0 * y[:, 1] + 8.0 * y[:, 2] - y[:, 3]) / (12.0 * h)
        np.testing.assert_allclose(slopes[:, :, k], expected, atol=1e-8)


def test_derivatives_of_places_of_an_open_chain_are_explicit() -> None:
    path = FIVE.parents[1] / "2r_circle.yaml"
    ends = "[{t: 0, q: {theta1: 0, theta2: 1}}, {t: 1, q: {theta1: 1, theta2: 2}}]"
    changes = (
        "expect={}",
        f"trajectory={{type: quintic, points: {ends}}}",
        "kinematics={samples: 5, at: [0, 0.37, 1]}",
        "initial={q: {theta1: 0, theta2: 1}}",
    )
    of = tuple(f"at.{k}.points.tip.{axis}" for k in range(3) for axis in "xy")
    asked = Task(Family(path, changes), "kinematics", ("robot.joints.theta1.a", "robot.joints.theta2.a"), of)
    values = np.array([[0.9, 0.8], [1.0, 1.1]])
    slopes = slopes_of(Compiled(asked, 1), values)
    h = 1e-4
    for k in range(2):
        one, two = (
            Compiled(asked, 1).make(Points(np.arange(2), values + s * h * np.eye(2)[k])).rows["outputs"]
            for s in (1, -1)
        )
        np.testing.assert_allclose(slopes[:, :, k], (one - two) / (2.0 * h), atol=1e-9)


def places(scene: Any) -> tuple[np.ndarray, np.ndarray]:
    at = kinematics(scene).summary["at"]
    rows = [[one["points"]["trace"][axis] for axis in ("x", "y", "z", "error")] for one in at]
    return np.array(rows)[:, :3], np.array(rows)[:, 3]


def test_a_place_between_samples_is_within_its_error_whatever_the_samples() -> None:
    times = "kinematics.at=[0, 0.3, 1.9, 2, 3.77, 4]"
    truth, small = places(load_scene(FIVE, (times, "kinematics.samples=4001")))
    assert small.max() < 1e-9
    worst = 0.0
    for samples in (5, 9, 12, 40, 101):
        y, error = places(load_scene(FIVE, (times, f"kinematics.samples={samples}")))
        assert (np.abs(y - truth).max(axis=1) <= error + small).all()
        worst = max(worst, float((np.abs(y - truth).max(axis=1) / error).max()))
    assert worst > 1e-4  # the errors are no mere bounds


def test_the_quintic_goes_through_values_rates_and_accelerations() -> None:
    f = np.polynomial.Polynomial([0.3, -1.0, 0.7, 0.2, -0.4, 0.1])
    first, last = (tuple(np.array([f.deriv(n)(t) if n else f(t)]) for n in range(3)) for t in (0.5, 1.1))
    for s in (0.0, 0.25, 0.9, 1.0):
        value, error = between((first, last), 0.6, s)
        assert value[0] == pytest.approx(f(0.5 + 0.6 * s), abs=1e-14)
        assert (error[0] > 0.0) == (0.0 < s < 1.0)


def test_a_time_behind_the_end_is_refused() -> None:
    with pytest.raises(SceneError, match=r"kinematics.at.1: 5 s is behind the end of the motion, 4 s"):
        kinematics(load_scene(FIVE, ("kinematics.at=[1, 5]",)))
    points = Points(np.arange(1), np.array([[0.35, 1.05, 0.8, 0.4]]))
    assert not len(Compiled(task("kinematics.at=[0, 1, 5]"), 1).make(points))


def test_derivatives_of_places_are_exact() -> None:
    family = Family(FIVE, ("expect={}", "robot.points.trace.at=[0.55, 0.4, 0]"))
    result = sensitivity(family, [KEYS[1], KEYS[3]], ["at.2.points.trace.x"])
    slopes = result.summary["sensitivities"]["at.2.points.trace.x"]
    assert all(slope["method"] == "exact" for slope in slopes.values())
    for key in (KEYS[1], KEYS[3]):
        own = Task(family, "kinematics", (key,), ("at.2.points.trace.x",))
        here = {KEYS[1]: 1.0, KEYS[3]: 0.4}[key]
        sides = [make_one(own, 0, np.array([here + way * 1e-5]))[0].rows["outputs"][0, 0] for way in (1, -1)]
        assert slopes[key]["derivative"] == pytest.approx((sides[0] - sides[1]) / 2e-5, rel=1e-7, abs=1e-9)


def test_an_open_chain_has_places_at_times_too() -> None:
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1], parent: base}]
  links: [{name: fore}]
  points: {tip: {link: fore, at: [2, 0, 0]}, post: {link: base, at: [1, 2, 3]}}
kinematics: {sweep: {joint: a, start: 0, stop: 2, rate: 1}, samples: 81, at: [0.777]}
"""
    points = kinematics(load_scene_text(text)).summary["at"][0]["points"]
    assert [points["post"][axis] for axis in "xyz"] == [1, 2, 3] and points["post"]["error"] <= 1e-12
    tip, angle = points["tip"], 0.777
    assert np.hypot(tip["x"] - 2 * np.cos(angle), tip["y"] - 2 * np.sin(angle)) <= 2 * tip["error"] < 1e-7

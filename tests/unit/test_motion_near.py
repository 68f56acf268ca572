"""A motion that is known at some times is solved at others from these; what a key leaves alone is not followed again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import load_scene
from robodyn_cli.equations.problem import Problem
from robodyn_cli.given.motion import plan_motion, plan_near
from robodyn_cli.over.sensitivity.asked import prepare
from robodyn_cli.over.sensitivity.report import exact_slopes
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, make_one
from robodyn_cli.scene.load import Family
from robodyn_cli.solve.follow import PathFollower
from robodyn_cli.works.inverse import inverse

CONFIGS = Path(__file__).parents[2] / "configs"
PICK = CONFIGS / "trajectories" / "pick_and_place.yaml"


@pytest.fixture
def followed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many samples each path has that is followed from its start."""
    found: list[int] = []
    run = PathFollower.run

    def counted(follower: PathFollower, start: np.ndarray) -> object:
        found.append(len(follower.times))
        return run(follower, start)

    monkeypatch.setattr(PathFollower, "run", counted)
    return found


@pytest.mark.parametrize("scene", [PICK, CONFIGS / "benchmarks" / "puma560.yaml"])
def test_what_is_solved_near_a_known_motion_is_that_motion(scene: Path) -> None:
    own = load_scene(scene)
    problem = Problem(own)
    duration = float(own.trajectory.duration)
    known = plan_motion(problem, np.linspace(0.0, duration, 400))
    times = np.sort(np.random.default_rng(3).uniform(0.0, duration, 90))
    near, anew = plan_near(problem, known, times), plan_motion(problem, np.concatenate([[0.0], times]))
    if known.near is None:
        assert near is None
        return
    assert near is not None and near.target is not None
    for name in ("q", "qd", "qdd"):
        one, two = getattr(near.motion, name), getattr(anew.motion, name)[1:]
        assert np.abs(one - two).max() <= 1e-9 * max(1.0, np.abs(two).max()), name
    assert near.target == pytest.approx(anew.target[1:], abs=1e-14)
    assert near.axes is None or near.axes == pytest.approx(anew.axes[1:], abs=1e-13)


def test_figures_follow_a_path_once(followed: list[int]) -> None:
    scene = load_scene(PICK)
    inverse(scene)
    assert followed == [scene.inverse.samples]


def test_a_mass_leaves_the_path_alone(followed: list[int]) -> None:
    """Of derivatives by a mass, the path is followed for the samples and where joints turn back."""
    asked = prepare(Family(PICK), ("robot.links.link2.mass",), ("rms_torque.q1",))
    before = len(followed)
    slopes, why = exact_slopes(asked)
    assert not why and len(followed) - before <= 2
    ((_, slope),) = slopes.items()
    values = [make_one(asked.task, 0, np.array([17.4 + d]))[0].rows[0]["outputs"][0] for d in (-0.1, 0.1)]
    assert slope.value == pytest.approx((values[1] - values[0]) / 0.2, rel=1e-5)


def test_runs_that_expect_an_attitude_stay_together() -> None:
    task = Task(Family(PICK), "inverse", ("robot.links.link2.mass",), ("rms_torque.q1", "attitude_residual"))
    masses = np.array([[17.1], [17.4], [18.0]])
    made = Compiled(task, 1).make(Points(np.arange(3), masses))
    assert len(made.rows) == 3
    for mass, row in zip(masses, made.rows):
        one = make_one(task, 0, mass)[0].rows[0]
        assert row["outputs"][0] == pytest.approx(one["outputs"][0], rel=1e-12)
        assert 0.0 < row["outputs"][1] < 1e-14 and 0.0 < one["outputs"][1] < 1e-14

"""Many runs from positions that are given to a scene which has none: each is that of the command from there."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis.strategies import integers

from robodyn_cli import Mechanism
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import RobodynError
from robodyn_cli.over.many.command import ManyRuns
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.works.simulate import simulate
from tests.bars import random_bars
from tests.exported_robots import random_q, random_robot, scene_of
from tests.numeric import examples

CONFIGS = Path(__file__).parents[2] / "configs"
ENDS = ("q", "qd")
ROUNDED = (
    1e-13  # rad, m, and their rates: what rounding leaves of a start that two ways of closing loops find
)


def without_start(path: Path, **more: Any) -> Scene:
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    del tree["initial"]["q"]
    tree["simulate"] |= more
    return load_scene_text(yaml.safe_dump({**tree, "expect": {}}), str(path))


def agree(scene: Scene, runs: ManyRuns, q: np.ndarray) -> None:
    """Compare runs with those of the command, within the sum of the errors of both."""
    for k, row in enumerate(q.tolist()):
        start = dataclasses.replace(scene.initial, q=dict(zip(runs.q_names, row)))
        try:
            summary = simulate(dataclasses.replace(scene, initial=start)).summary
        except RobodynError as error:
            assert runs.code[k] == error.exit_code
            continue
        assert runs.code[k] == 0
        for name, own, off in zip(ENDS, (runs.q[k], runs.qd[k]), (runs.q_error[k], runs.qd_error[k])):
            end = np.array(list(summary["final"][name].values()))
            assert np.abs(own - end).max() <= off.max() + summary["error_estimate"][f"{name}_end"] + ROUNDED


@examples(6)
@given(seed=integers(0, 1_000_000))
def test_open_chains_start_where_they_are_told(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = ("revolute", "spherical" if seed % 2 else "prismatic")
    robot = random_robot(rng, kinds, ("damper", "spring"), 3)
    scene = scene_of(robot, command="simulate", simulate={"duration": 0.3, "samples": 4})
    q = np.array([random_q(Problem(scene).model, rng) for _ in range(4)])
    runs = Mechanism(scene).simulate_many(q=q)
    assert not runs.one_by_one.any(), runs.left
    agree(scene, runs, q)


@examples(6)
@given(seed=integers(0, 1_000_000))
def test_loops_close_from_where_they_are_told(seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_bars(rng, 3 + seed % 2).text
    start = text.index("initial: {q: {")
    scene = load_scene_text(text[:start] + "initial: {" + text[text.index("hold:", start) :])
    q = rng.uniform(-np.pi, np.pi, (5, 3 + seed % 2))
    runs = Mechanism(scene).simulate_many(q=q)
    agree(scene, runs, q)
    assert (runs.ok & runs.one_by_one).sum() <= 1, runs.left


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("four_bar_deploy", ""),
        ("controlled_arm", ""),
        ("cart_pole_lqr", ""),
        ("four_bar_prescribed", "a prescribed motion starts otherwise"),
        ("benchmarks/stewart_platform", "loops with balls or free bodies are closed one by one"),
    ],
)
def test_example_scenes_start_where_they_are_told(name: str, why: str) -> None:
    path = CONFIGS / f"{name}.yaml"
    own = prepare(load_scene(path)).assembled.q
    scene = without_start(path, duration=0.1, samples=4)
    q = own + np.array([[0.0], [0.0 if why else 1e-2]])
    mechanism = Mechanism(scene)
    runs = mechanism.simulate_many(q=q)
    assert runs.left == ({why: 2} if why else {}), runs.left
    agree(scene, runs, q)


def test_deployments_and_statics_start_where_they_are_told() -> None:
    path = CONFIGS / "four_bar_deploy.yaml"
    scene, own = without_start(path), load_scene(path)
    q = prepare(own).assembled.q[None]
    found, same = (Mechanism(x).deploy_many(q=q) for x in (scene, own))
    assert not found.one_by_one.any() and found.time == same.time and found.code == same.code
    chain = without_start(CONFIGS / "double_pendulum.yaml")
    rest = Mechanism(chain).statics_many(q=[[0.1, -0.1]])
    assert rest.ok.all() and not rest.one_by_one.any()


def test_what_has_no_start_is_not_taken_from_earlier_runs() -> None:
    """The equations of runs that are given their starts serve no run without one."""
    scene = without_start(CONFIGS / "double_pendulum.yaml", duration=0.1)
    mechanism = Mechanism(scene)
    assert not mechanism.simulate_many(q=[[np.nan, 0.0], [0.1, 0.2]]).one_by_one[1]
    runs = mechanism.simulate_many()
    assert runs.code[0] == 2 and "has no initial position" in runs.reason[0]

"""The error that a run reports beside its true error, over the scenes of the repository."""

from __future__ import annotations

import importlib
import sys
from functools import lru_cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robodyn_cli import deploy, load_scene, load_scene_text, simulate
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.error import Courses, First, Floor, first_attempt, remainder
from tests.mechanisms import CONFIGS
from tests.methods import ADAPTIVE, taking

ROOT = Path(__file__).parents[2]


@lru_cache
def script() -> ModuleType:
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        return importlib.import_module("error_estimates")
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))


SCENES = script().scenes()
TOLD: dict[str, int] = {}
METHODS = ("gauss", "rodas5p")
# a method whose Jacobian takes a minute to compile there is left out
INSTEAD = {"stewart_platform": ("gauss", "dopri5")}


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_estimate_is_within_a_factor_of_ten(path: Path) -> None:
    """Each scene with two methods, one at a loose and one at a tight tolerance, in the next scene the other way round."""
    names = INSTEAD.get(path.stem, METHODS)
    turn = 1 - 2 * (SCENES.index(path) % 2)
    rows = list(script().runs_of(path, names, dict(zip(names, ((1e-5,), (1e-9,))[::turn]))))
    told = [row for row in rows if row.ratio is not None]
    TOLD[path.stem] = len(told)
    for row in told:
        assert 0.1 <= row.ratio <= 10.0, row
    for row in rows:
        assert row.estimate is not None, row


@pytest.mark.parametrize("method", taking("accelerations from velocities"))
def test_estimates_of_each_method(method: str) -> None:
    path = ROOT / "configs" / "double_pendulum.yaml"
    rows = list(script().runs_of(path, [method], (1e-3, 1e-6, 1e-9)))
    told = [row for row in rows if row.ratio is not None]
    assert told
    for row in told:
        assert 0.1 <= row.ratio <= 10.0, row


def test_enough_errors_could_be_told() -> None:
    assert sum(TOLD.values()) >= 25 or len(TOLD) < len(SCENES), TOLD


@pytest.mark.parametrize("method", ["gauss", "dopri5", "rodas5p"])
@pytest.mark.parametrize("rtol", ["1e-5", "1e-7", "1e-9"])
def test_error_of_the_time_of_the_lock(method: str, rtol: str) -> None:
    scene = ROOT / "configs" / "four_bar_deploy.yaml"
    exact = 12.28299560962995  # README: an independent integral of the energy
    loose = [
        f"simulate.integrator={method}",
        f"simulate.rtol={rtol}",
        f"simulate.atol={rtol}",
        "simulate.samples=101",
    ]
    lock = deploy(load_scene(scene, loose)).summary["lock"]
    true = abs(lock["time"] - exact)
    if true > 1e-11:
        assert 0.1 * true <= lock["time_error"] <= 10.0 * true


def test_the_second_run_takes_less_than_twice_the_steps() -> None:
    for name in ADAPTIVE:
        first = First(Options(rtol=1e-7, atol=1e-9), name, np.array([1000]), np.array([100.0]))
        tight = first_attempt(first).alone
        more = (1e-7 / tight.rtol) ** (methods[name].proportion / methods[name].order)
        assert more < 1.95, name
        assert 1.0 <= remainder(first, np.array([round(1000 * more)]))[0] < 2.0


NOTHING = Floor(np.zeros(1), np.zeros(1))


def test_errors_that_agree_at_the_end_are_not_taken_for_none() -> None:
    """Errors of a swinging motion, that of the second run a part of the first's and late by a little."""
    one: Any = SimpleNamespace(q_places=(0,), v_places=())
    time = np.linspace(0.0, 7.0, 41)
    ratios = []
    for part, late, phase in (
        (p, d, f) for p in (0.05, 0.3) for d in (0.0, 0.2) for f in np.linspace(0, np.pi, 400)
    ):
        first = time * np.sin(3.0 * time + phase)
        second = part * time * np.sin(3.0 * time + phase - late)
        scale = 1.0 / (1.0 - part)
        courses = Courses(one, first[None, :, None], np.abs(second - first)[None, :, None], np.array([scale]))
        ratios.append(abs(first[-1]) / float(courses.at_end(NOTHING)[0, 0]))
    assert max(ratios) < 10.0 and np.median(ratios) == pytest.approx(1.0, abs=0.2)


def test_the_error_at_the_end_is_that_of_the_last_sample_too() -> None:
    """37 intervals: every second sample counted, so the last one, dense output with 20 times the error, did not."""
    pytest.importorskip("pinocchio")
    from tests.proof.families import make

    text = make(900049)[1].scene()
    runs = [
        simulate(load_scene_text(text, overrides=[f"simulate.rtol={rtol}", f"simulate.atol={atol}"]))
        for rtol, atol in ((2.7e-6, 7.8e-7), (1e-12, 1e-14))
    ]
    apart = float(np.abs(runs[0]["qd"][-1] - runs[1]["qd"][-1]).max())
    assert 0.5 * apart < runs[0].summary["error_estimate"]["qd_end"] < 5.0 * apart


def test_estimate_says_where_it_means_nothing() -> None:
    """A double pendulum thrown over loses its first digits; a run at tight tolerance is at rounding."""
    scene = ROOT / "configs" / "double_pendulum.yaml"
    thrown = [
        "initial.q={theta1: 80 deg, theta2: 30 deg}",
        "simulate.duration=60",
        "simulate.rtol=1e-5",
        "simulate.atol=1e-5",
    ]
    found = simulate(load_scene(scene, thrown)).summary["error_estimate"]
    assert 0.0 < found["meaningful_until"] < 60.0 and not found["at_rounding"]
    calm = ["simulate.integrator=dop853", "simulate.rtol=1e-15", "simulate.atol=1e-15", "simulate.duration=1"]
    found = simulate(load_scene(scene, calm)).summary["error_estimate"]
    assert found["at_rounding"] and "meaningful_until" not in found


def test_a_structure_at_rest_loses_no_digits() -> None:
    """Its coordinates range over nothing, and are off by rounding."""
    text = """
schema: 1
gravity: [0.3, -0.5, -9.81]
robot:
  joints: [{name: a, type: revolute, axis: [1, 2, 3]}, {name: b, type: revolute, axis: [0, 0.2, 1], origin: {xyz: [0.2, 0.1, 0]}}]
  links: [{name: one, mass: 1, com: [0.1, 0, 0], inertia: ALL}, {name: two, mass: 2, com: [0.1, 0.1, 0], inertia: ALL}]
  points: {tip: {link: two, at: [0.3, 0, 0]}, wall: {link: base, at: [0.5, 0.1, 0]}}
loops: [{name: weld, type: fixed, between: [wall, tip]}]
simulate: {duration: 0.001, samples: 2}
"""
    summary = simulate(load_scene_text(text.replace("ALL", "{xx: 1, yy: 1, zz: 1}"))).summary
    assert summary["error_estimate"]["q_max"] < 1e-15
    assert not any("not meaningful" in text for text in summary["warnings"])


def test_without_an_estimate() -> None:
    scene = load_scene(ROOT / "configs" / "four_bar_deploy.yaml", ["simulate.error_estimate=false"])
    summary = deploy(scene).summary
    assert summary["error_estimate"] is None and summary["lock"]["time_error"] is None
    assert "error_estimate" not in summary["wall_time_s"]


def test_a_tolerance_that_a_method_cannot_keep_does_not_multiply_the_work() -> None:
    """Backward differentiation of the squeezer needs 8000 steps at 1e-12, and 2e5 at the tolerance of the estimate."""
    overrides = [
        "simulate.duration=0.05", "simulate.samples=26", "simulate.integrator=bdf", "simulate.rtol=1e-12",
        "simulate.atol=1e-13",
    ]  # fmt: skip
    result = simulate(load_scene(CONFIGS / "benchmarks" / "andrews.yaml", overrides))
    estimate = result.summary["error_estimate"]
    assert estimate["steps"] <= 3 * result.summary["counters"]["steps"]
    assert 1e-8 < estimate["state_max"] < 1e-4


def test_a_run_that_no_second_one_confirms_carries_a_warning() -> None:
    overrides = ["simulate.integrator=rk4", "simulate.step=100", "simulate.samples=11"]
    summary = simulate(load_scene(CONFIGS / "double_pendulum.yaml", overrides)).summary
    assert summary["error_estimate"]["state_max"] is None
    told = "no second run confirms this motion: the second integration failed"
    assert any(text.startswith(told) for text in summary["warnings"])


PULSED = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: j1, type: prismatic, parent: base, link: l1, axis: [1, 0, 0],
       limits: {upper: 0.3, stop: {law: hunt_crossley, stiffness: 3500, damping: 7, exponent: 1.5}}}
  links: [{name: l1, mass: 2}]
initial: {q: {j1: 0.0}, qd: {j1: 0.7}}
torques: {j1: "if(t < 0.1, 0, if(t < 0.1003, 30, 0)) + if(t < 0.2, 0, if(t < 0.2003, 30, 0)) + sin(3*t)"}
simulate: {duration: 1, samples: 11}
"""


@pytest.mark.parametrize("rtol", [1e-3, 1e-5, 1e-7])
def test_the_second_run_takes_steps_of_its_own(rtol: float) -> None:
    """Where jumps and contacts decide about the steps, a tighter tolerance alone would take the same ones."""
    settings = [f"simulate.rtol={rtol}", f"simulate.atol={0.1 * rtol}", "simulate.integrator=gauss"]
    summary = simulate(load_scene_text(PULSED, overrides=settings)).summary
    assert summary["error_estimate"]["steps"] > 1.15 * summary["counters"]["steps"]


def test_a_mechanism_at_rest_has_a_meaning() -> None:
    """Rounding turns the weight of one finger by 1e-16, so that coordinates range over rounding: no motion to lose."""
    fingers = """
schema: 1
command: simulate
gravity: [0, -5.9, -7.8]
robot:
  links: [{name: a, mass: 0.015, com: [0, 0, 0]}, {name: b, mass: 0.015, com: [0, 0, 0]}]
  joints:
    - {name: s, type: prismatic, parent: base, axis: [0, 1, 0], spring: {stiffness: 10, rest: 0}}
    - {name: r, type: prismatic, parent: base, axis: [0, 1, 0], origin: {rpy: [0, 0, 3.141592653589793]}}
couplers: [{name: c, terms: {s: 1, r: -1}}]
initial: {q: {s: 0, r: 0}}
simulate: {duration: 1}
"""
    result = simulate(load_scene_text(fingers))
    assert 0.0 < np.abs(result["q"]).max() < 1e-13
    assert "meaningful_until" not in result.summary["error_estimate"] and "warnings" not in result.summary

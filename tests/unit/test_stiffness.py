"""The automatic method: it changes to a stiff one on the way, and back, and costs little where there is nothing to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import deploy, load_scene, load_scene_text, simulate
from robodyn_cli.errors import NumericalError
from robodyn_cli.integration_methods import DEFAULT, STIFF
from robodyn_cli.motion import stiffness
from robodyn_cli.results.result import Result

CONFIGS = Path(__file__).parents[2] / "configs"

# two pendulums; a brake holds the second one's joint almost rigid for a while
BRAKED = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, parent: base, a: 1, alpha: 0, d: 0}
    - {name: b, type: revolute, parent: one, a: 0.5, alpha: 0, d: 0}
  links:
    - {name: one, mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: two, mass: 1, com: [0.25, 0, 0], com_frame: joint, inertia: {zz: 0.02}}
torques: {b: "if(t < 20, 0, if(t < 24, -3e4*qd.b, 0))"}
initial: {q: {a: -0.5, b: 0.3}}
simulate: {duration: 200, samples: 201, error_estimate: false}
"""


def steps_of(found: Result) -> int:
    return int(found.summary["counters"]["steps"])


def cost_of(found: Result, method: str) -> float:
    return stiffness.COST[method] * float(found.summary["counters"]["evaluations"])


def test_a_brake_for_a_while_changes_the_method_there_and_back() -> None:
    found = simulate(load_scene_text(BRAKED))
    changes = found.summary["switches"]
    assert [c["to"] for c in changes] == [STIFF, DEFAULT]
    assert 20.0 < changes[0]["time"] < 20.1 and 24.0 < changes[1]["time"] < 40.0
    assert changes[0]["fastest_decay"] < 1e-4 and changes[1]["fastest_decay"] > 1e-2
    assert steps_of(found) < 8_000
    assert found.summary["energy_drift_relative"] < 1e-7
    # over the brake and a little beyond, before chaos: the same motion as with the one method throughout
    short = ["simulate.duration=26", "simulate.samples=27", "simulate.rtol=1e-12"]
    plain = simulate(load_scene_text(BRAKED, overrides=[*short, "simulate.integrator=gauss"]))
    mixed = simulate(load_scene_text(BRAKED, overrides=short))
    assert "switches" in mixed.summary and steps_of(plain) > 20 * steps_of(mixed)
    assert np.abs(plain["q"] - mixed["q"]).max() < 1e-7


def test_steps_before_a_change_of_method_count() -> None:
    whole = simulate(load_scene_text(BRAKED)).summary["counters"]
    limit = whole["steps"] + whole["rejected"] - 10
    with pytest.raises(NumericalError, match=f"more than {limit} steps, stopped at t = 19") as caught:
        simulate(load_scene_text(BRAKED, overrides=[f"simulate.max_steps={limit}"]))
    assert caught.value.__cause__ is None
    summary = caught.value.result.summary  # type: ignore[attr-defined]
    assert len(summary["switches"]) == 2
    assert summary["counters"]["steps"] + summary["counters"]["rejected"] == limit


def test_the_error_of_a_run_that_changes_its_method_is_estimated_by_one_that_does_too() -> None:
    short = ["simulate.duration=26", "simulate.samples=27", "simulate.error_estimate=true"]
    found = simulate(load_scene_text(BRAKED, overrides=short))
    estimate = found.summary["error_estimate"]
    fine = simulate(
        load_scene_text(BRAKED, overrides=[*short, "simulate.integrator=gauss", "simulate.rtol=1e-12"])
    )
    error = np.abs(found["q"] - fine["q"]).max()
    assert "switches" in found.summary and error < 10 * estimate["q_max"]
    assert estimate["steps"] < 5 * steps_of(found)


PUMA = """
schema: 1
gravity: [0, 0, -9.81]
robot: ROBOT
initial: {q: {q1: 0, q2: 0.785, q3: 3.1415, q4: 0, q5: 0.785, q6: 0}, qd: {q1: 1, q2: 1, q3: 1, q4: 1, q5: 1, q6: 1}}
simulate: {duration: 4, samples: 201, error_estimate: false}
""".replace("ROBOT", str(CONFIGS / "robots" / "puma560.yaml"))


def test_friction_that_makes_a_robot_stiff_on_the_way_is_noticed() -> None:
    """All friction of a Puma 560 is smoothed over 1e-3 rad/s: joints that come to rest one by one are stiff."""
    smooth = [f"robot.joints.q{k}.friction.transition_speed=1e-3" for k in range(1, 7)]
    found, gauss, radau = (
        simulate(load_scene_text(PUMA, overrides=[*smooth, f"simulate.integrator={name}"]))
        for name in ("auto", DEFAULT, STIFF)
    )
    assert [c["to"] for c in found.summary["switches"]] == [STIFF]
    assert steps_of(gauss) > 5 * steps_of(found)
    # no more than the look, the trial, and what has gone before cost beside the better method
    assert steps_of(found) < steps_of(radau) + 2 * stiffness.FIRST_LOOK
    assert np.abs(found["q"] - radau["q"]).max() < 1e-6


DAMPED = BRAKED.replace("if(t < 20, 0, if(t < 24, -3e4*qd.b, 0))", "20*sin(3*t) - 0.4*qd.b")


@pytest.mark.parametrize("damping", [0.4, 3.0, 30.0, 300.0])
def test_looking_costs_little_and_changes_nothing(damping: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the damping: a run that keeps its method is the same to the last digit, and trials are a tenth of it."""
    watches: list[stiffness.StiffnessWatch] = []
    begin = stiffness.StiffnessWatch.__init__

    def noted(self: stiffness.StiffnessWatch) -> None:
        begin(self)
        watches.append(self)

    monkeypatch.setattr(stiffness.StiffnessWatch, "__init__", noted)
    text = DAMPED.replace("0.4*qd.b", f"{damping}*qd.b")
    found = simulate(load_scene_text(text))
    plain = simulate(load_scene_text(text, overrides=[f"simulate.integrator={found.summary['integrator']}"]))
    (watch,) = watches
    assert watch.cost > 0.0 and watch.spent <= 0.1 * watch.cost
    if "switches" not in found.summary:
        assert np.array_equal(found["q"], plain["q"]) and steps_of(found) == steps_of(plain)


def test_a_brake_that_comes_and_goes_does_not_make_the_method_flap() -> None:
    text = BRAKED.replace("if(t < 20, 0, if(t < 24, -3e4*qd.b, 0))", "-300*(1 + sin(2*t))^8*qd.b")
    found, gauss, radau = (
        simulate(load_scene_text(text, overrides=["simulate.duration=30", f"simulate.integrator={name}"]))
        for name in ("auto", DEFAULT, STIFF)
    )
    best = min(cost_of(gauss, DEFAULT), cost_of(radau, STIFF))
    assert len(found.summary.get("switches", ())) <= 6
    # what the run has cost is at most as if all of it were done by the dearer of the two
    assert cost_of(found, DEFAULT) < 1.5 * best


def test_the_limit_on_steps_counts_those_between_looks_too() -> None:
    with pytest.raises(NumericalError) as caught:
        simulate(load_scene_text(DAMPED, overrides=["simulate.max_steps=1000"]))
    assert caught.value.details["status"] == "max_steps"
    counters = caught.value.result.summary["counters"]  # type: ignore[attr-defined]
    assert counters["steps"] + counters["rejected"] == 1000


def test_a_deployment_changes_its_method_and_records_what_it_has_scanned() -> None:
    brake = "torques={theta1: 'if(t < 6, 1.96 - 0.1*theta1, if(t < 9, 1.96 - 0.1*theta1 - 1e6*qd.theta1, 1.96 - 0.1*theta1))'}"
    scene = [brake, "expect={}", "simulate.duration=60"]
    found = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml", scene))
    plain = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml", [*scene, "simulate.integrator=gauss"]))
    assert STIFF in [c["to"] for c in found.summary["switches"]]
    lock, other = found.summary["lock"], plain.summary["lock"]
    assert lock["time"] == pytest.approx(other["time"], abs=1e-6)
    assert found.time[-1] == lock["time"] and found.status == "locked"
    assert found["q"][-1, 0] == pytest.approx(lock["angles"]["theta1"], abs=1e-12)
    assert steps_of(plain) > 5 * steps_of(found)

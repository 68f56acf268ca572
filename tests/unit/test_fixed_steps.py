"""Steps of a fixed length: k of them end at k h to rounding, and shorter ones are not taken in silence."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text, simulate
from tests.mechanisms import CONFIGS

OSCILLATOR = """
schema: 1
command: simulate
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0], spring: {stiffness: 100}}]
  links: [{name: b, mass: 1, com: [0, 0, 0]}]
initial: {q: {x: 1}}
simulate: {duration: 200, samples: 5, integrator: symplectic8, step: 1e-3}
"""


@pytest.mark.parametrize("step", [1e-3, 2.0**-10, 7e-4, 1 / 3000])
def test_time_does_not_add_up_its_rounding(step: float) -> None:
    """x'' = -100 x, whose phase shows an error of the time ten times enlarged."""
    found = simulate(load_scene_text(OSCILLATOR, overrides=[f"simulate.step={step!r}"]))
    error = np.abs(found["q"][:, 0] - np.cos(10 * found["time"])).max()
    assert error < 1e-12
    estimate = found.summary["error_estimate"]
    assert estimate["at_rounding"] or estimate["q_max"] > 0.1 * error
    assert abs(found.summary["counters"]["steps"] - 200 / step) <= 4 + 200 / step * 1e-9


@pytest.mark.parametrize("method", ["implicit_midpoint", "gauss4", "gauss6"])
def test_a_step_that_had_to_be_shorter_is_told(method: str) -> None:
    options = [f"simulate.integrator={method}", "simulate.duration=5", "simulate.error_estimate=false"]
    scene = CONFIGS / "double_pendulum.yaml"
    long = simulate(load_scene(scene, [*options, "simulate.step=0.5"])).summary
    assert any("had no solution" in text for text in long["warnings"])
    fine = simulate(load_scene(scene, [*options, "simulate.step=0.01"])).summary
    assert fine["counters"]["rejected"] == 0 and not any(
        "no solution" in text for text in fine.get("warnings", ())
    )
    assert fine["counters"]["steps"] == 500


DAMPED_STOP = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: j1, type: prismatic, axis: [1, 0, 0],
       limits: {upper: 0.18, stop: {law: spring_damper, stiffness: 2900, damping: 57}}}
  links: [{name: l1, mass: 2}]
initial: {q: {j1: 0}, qd: {j1: 1.3}}
simulate: {duration: 0.16, samples: 3}
"""


@pytest.mark.parametrize("method", ["rk4", "gauss4", "gauss6"])
@pytest.mark.parametrize("step", [4e-4, 4.1e-4, 3.9999e-4, 1.7e-4])
def test_a_step_that_ends_at_a_jump_does_not_see_the_other_side(method: str, step: float) -> None:
    """Damping sets in at once when the stop is met, at t = 0.18 / 1.3: from there on the motion is a damped oscillation."""
    settings = [f"simulate.integrator={method}", f"simulate.step={step}"]
    found = simulate(load_scene_text(DAMPED_STOP, overrides=settings))
    decay, rate = 57 / 4, (2900 / 2 - (57 / 4) ** 2) ** 0.5
    since = 0.16 - 0.18 / 1.3
    wave = math.cos(rate * since) - decay / rate * math.sin(rate * since)
    assert abs(found["qd"][-1, 0] - 1.3 * math.exp(-decay * since) * wave) < 1e-9

"""How small changes of the start grow: motions that are integrable are never called exponential, chaotic ones are."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.motion.build import build_motion
from robodyn_cli.over.work_precision.error_growth import Sensitivity, exponential_rate, sensitivity
from robodyn_cli.over.work_precision.work_precision import work_precision
from robodyn_cli.scene.load import load_scene_text

TIMES = np.linspace(0.0, 10.0, 257)


def growth_of(text: str) -> Sensitivity:
    motion = build_motion(load_scene_text(text), work=False)
    return sensitivity(motion, motion.scene.simulate.duration, "gauss", 257)


def cart_pole(mass: float, angle: float, duration: float = 10.0) -> str:
    """Without friction, energy and momentum along the rail are kept: two integrals for two freedoms."""
    return f"""
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {{name: x, type: prismatic, axis: [1, 0, 0]}}
    - {{name: q, type: revolute, axis: [0, 1, 0]}}
  links:
    - {{name: cart, mass: {mass}}}
    - {{name: pole, mass: 1, com: [0, 0, -1], inertia: {{yy: 0}}}}
initial: {{q: {{x: 0, q: {angle}}}, qd: {{x: 0, q: 0}}}}
simulate: {{duration: {duration}}}
"""


def rods(q1: float, q2: float, gravity: float, v: float = 0.0, duration: float = 10.0) -> str:
    """Two uniform rods; without gravity energy and angular momentum are kept."""
    return f"""
schema: 1
gravity: [0, 0, {-gravity}]
robot:
  joints:
    - {{name: q1, type: revolute, axis: [0, 1, 0]}}
    - {{name: q2, type: revolute, axis: [0, 1, 0], origin: {{xyz: [1, 0, 0]}}}}
  links:
    - {{name: a, mass: 1, com: [0.5, 0, 0], inertia: {{yy: 0.08}}}}
    - {{name: b, mass: 1, com: [0.5, 0, 0], inertia: {{yy: 0.08}}}}
initial: {{q: {{q1: {q1}, q2: {q2}}}, qd: {{q1: {v}, q2: 0}}}}
simulate: {{duration: {duration}}}
"""


def free_body(wx: float, wy: float, wz: float) -> str:
    """Without forces a body keeps energy and angular momentum, whichever way it tumbles."""
    return f"""
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{{name: ball, type: spherical}}]
  links: [{{name: body, mass: 1, com: [0, 0, 0], inertia: {{xx: 1, yy: 2, zz: 3}}}}]
initial: {{q: {{ball: [1, 0, 0, 0]}}, qd: {{ball: [{wx}, {wy}, {wz}]}}}}
simulate: {{duration: 40}}
"""


@pytest.mark.parametrize("mass", [1.0, 1e-3, 1e-4, 1e-6])
def test_a_light_cart_with_a_pole_is_not_chaotic(mass: float) -> None:
    """A light cart is thrown to and fro in spikes, which the references resolve to fewer digits."""
    for angle in (1.2, 2.9):
        assert growth_of(cart_pole(mass, angle)).kind == "polynomial"


@pytest.mark.parametrize("seed", range(8))
def test_integrable_motions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert growth_of(rods(*rng.uniform(-2, 2, 2), 0.0, rng.uniform(1, 5))).kind == "polynomial"
    assert growth_of(free_body(*rng.uniform(-3, 3, 3))).kind == "polynomial"
    # about the middle axis: unstable, but each turn-over passes
    assert growth_of(free_body(1e-3 * rng.normal(), 2.0, 1e-3 * rng.normal())).kind == "polynomial"
    # a pendulum that has stood upright
    assert (
        growth_of(cart_pole(10.0 ** rng.uniform(-2, 2), np.pi - 10.0 ** rng.uniform(-4, -1))).kind
        == "polynomial"
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_double_pendulum_from_high_up_is_chaotic(seed: int) -> None:
    """Its largest Lyapunov exponent is some 1 to 3 per second."""
    rng = np.random.default_rng(seed)
    found = growth_of(rods(*rng.uniform([-2.0, 1.0], [-1.0, 2.5]), 9.81, duration=20.0))
    assert found.kind == "exponential" and found.e_folding is not None and 0.2 < found.e_folding < 2.0


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0, 3.0, 4.0])
def test_powers_of_time_are_not_exponential(power: float) -> None:
    ripple = 2.0 + np.cos(7 * TIMES) ** 20
    assert exponential_rate(TIMES, np.log(1e-9 * (TIMES + 1e-3) ** power * ripple)) is None


@pytest.mark.parametrize("rate", [0.8, 1.0, 5.0, 20.0])
def test_exponential_growth_is_found_with_its_rate(rate: float) -> None:
    ripple = 2.0 + np.cos(7 * TIMES)
    found = exponential_rate(TIMES, np.log(1e-8 * np.exp(rate * TIMES) * ripple))
    assert found == pytest.approx(rate, rel=0.25)


def test_an_instability_that_passes_is_not_exponential() -> None:
    for middle in (2.0, 5.0, 8.0):
        step = 1e-8 * np.exp(6.0 * (1.0 + np.tanh((TIMES - middle) / 0.3)))
        assert exponential_rate(TIMES, np.log(step * (1.0 + TIMES))) is None


def test_work_precision_compares_a_light_cart_over_its_whole_run() -> None:
    found = work_precision(load_scene_text(cart_pole(1e-4, 1.2)), ["gauss"], [1e-6, 1e-9], repeats=1).summary
    assert found["compared_whole_duration"] and found["compared_until"] == 10.0
    assert found["perturbation_grows"] == "polynomial" and "e_folding_time" not in found
    # no level of error below what the references themselves are apart
    apart = 10.0 ** -found["reference_digits"] * 100.0
    assert found["best"] and all(best["level"] > 1e-9 for best in found["best"]) and apart < 1e-3

"""Figures of a response against closed forms, whatever the samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from robodyn_cli import simulate
from robodyn_cli.expr.statements import parse_expectation
from robodyn_cli.over.batch.criteria import judge
from robodyn_cli.scene import load_scene_text
from robodyn_cli.solve.step_response import SmoothCourse, rise_of, settling_of

MASS = 2.0
CART = f"""\
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{{name: x, type: prismatic, axis: [1, 0, 0]}}]
  links: [{{name: cart, mass: {MASS}, com: [0, 0, 0], inertia: {{xx: 1, yy: 1, zz: 1}}}}]
initial: {{q: {{x: 0.1}}}}
"""
STEP = "reference: {type: joint, duration: 4, q: {x: '0.6'}}"


def cart(control: str, samples: int, *more: str):
    text = f"{CART}control: {control}\nsimulate: {{duration: 4, samples: {samples}}}"
    return simulate(load_scene_text(text, overrides=["outputs.response=true", *more]))


@pytest.mark.parametrize("samples", [5, 60, 401])
@pytest.mark.parametrize("damping", [0.2, 0.6, 1.4])
def test_a_cart_under_pd_has_the_figures_of_its_closed_form(samples: int, damping: float) -> None:
    w, size, start, end = 5.0, 0.5, 0.1, 0.6
    kp, kd = MASS * w**2, 2.0 * damping * w * MASS
    run = cart(f"{{type: pd, gains: {{kp: {kp}, kd: {kd}}}, {STEP}}}", samples)
    own, errors = run.summary["response"]["x"], run.summary["response"]["x"]["errors"]
    poles = np.roots([1.0, 2.0 * damping * w, w**2]).astype(complex)
    b = poles[0] * size / (poles[0] - poles[1])
    a = size - b

    def e(t: float) -> float:  # what is left of the step
        return float((a * np.exp(poles[0] * t) + b * np.exp(poles[1] * t)).real)

    def v(t: float) -> float:
        return -float((a * poles[0] * np.exp(poles[0] * t) + b * poles[1] * np.exp(poles[1] * t)).real)

    def torque(t: float) -> float:
        return kp * e(t) - kd * v(t)

    assert own["step"] == pytest.approx(end - start)
    grid = np.linspace(0.0, 4.0, 40001)
    left = np.array([e(t) for t in grid])
    wanted = {"final_error": e(4.0)}

    def crossing(part: float) -> float:
        k = int(np.flatnonzero(left <= part * size)[0]) - 1
        return brentq(lambda t: e(t) - part * size, grid[k], grid[k + 1], xtol=1e-15)

    low, high = crossing(0.9), crossing(0.1)
    wanted["rise"] = high - low
    wanted["overshoot"] = math.exp(-math.pi * damping / math.sqrt(1 - damping**2)) if damping < 1 else 0.0
    k = int(np.flatnonzero(np.abs(left) > 0.02 * size)[-1])
    if k < len(grid) - 1:
        side = math.copysign(0.02 * size, left[k])
        wanted["settling"] = brentq(lambda t: e(t) - side, grid[k], grid[k + 1], xtol=1e-15)
    else:
        assert own["settling"] is None
    turns = [grid[j] for j in np.flatnonzero(np.diff(np.sign([torque(t) * v(t) for t in grid])))]
    wanted["effort"] = quad(lambda t: torque(t) ** 2, 0, 4, limit=500, epsabs=1e-12)[0]
    wanted["energy"] = quad(lambda t: abs(torque(t) * v(t)), 0, 4, limit=1000, points=turns[:40])[0]
    for key, value in wanted.items():
        assert abs(own[key] - value) <= errors[key] + 1e-9 * max(1.0, abs(value)), key
        assert errors[key] <= (1e-2 if key == "energy" else 1e-7) * max(1.0, abs(value)), key


def test_a_sampled_controller_has_the_same_figures_at_any_samples() -> None:
    law = f"{{type: pid, period: 0.05, delay: 0.02, gains: {{kp: 40, kd: 12, ki: 4}}, {STEP}}}"
    one, two = (cart(law, samples).summary["response"]["x"] for samples in (401, 23))
    for key in ("rise", "overshoot", "settling", "final_error", "effort", "energy"):
        assert (one[key] is None) == (two[key] is None)
        if one[key] is not None:
            apart = abs(one[key] - two[key])
            assert apart <= one["errors"][key] + two["errors"][key] + 1e-12, key


def test_without_a_step_there_is_no_rise_and_keys_ask_for_themselves() -> None:
    held = cart("{type: pd, gains: {kp: 9, kd: 2}}", 11).summary["response"]["x"]
    assert (
        held["step"] == 0.0 and held["rise"] is None and held["overshoot"] is None and held["effort"] == 0.0
    )
    text = f"{CART}control: {{type: pd, gains: {{kp: 90, kd: 20}}, {STEP}}}\nsimulate: {{duration: 4, samples: 11}}\n"
    asked = simulate(
        load_scene_text(
            text + "command: simulate\nexpect: {response.x.overshoot: < 0.05, response.x.settling: < 2 s}"
        )
    )
    expected = {"response.x.settling": parse_expectation("< 2 s")}
    assert judge(expected, asked.summary)[0].holds
    assert "response" not in simulate(load_scene_text(text)).summary


def test_levels_that_are_touched_have_errors_that_cover() -> None:
    """A wave that touches the band within what the motion may be off."""
    t = np.linspace(0.0, 3.0, 301)
    y = 1.0 - np.exp(-4.0 * t) + 0.02 * np.exp(-((t - 2.0) ** 2) / 0.01)
    course = SmoothCourse([(t[:150], y[:150]), (t[149:], y[149:])])
    settled = settling_of(course, 0.0, 1.0, 1e-3)
    assert settled.value is not None and settled.error is not None and settled.error > 0.5
    sharp = rise_of(course, 0.0, 1.0, 0.0)
    assert sharp.value is not None
    assert abs(sharp.value - math.log(9.0) / 4.0) < 1e-9

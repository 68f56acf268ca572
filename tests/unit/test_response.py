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
from tests.figures.judge import figures_of, moves

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


LAWS = (
    "{type: pd, gains: {kp: 50, kd: 20}",
    "{type: pid, gains: {kp: 50, kd: 20, ki: 30}",
    "{type: pd, period: 0.01, sensors: {noise: 1e-5}, gains: {kp: 50, kd: 20}",
)


@pytest.mark.parametrize("law", LAWS)
def test_what_is_left_of_a_step_is_no_surer_than_the_motion(law: str) -> None:
    """Both integrations come to the same rest, which is no error of 1e-22; the loop of few digits at the limit moves."""
    ends = []
    for rtol in ("1e-5", "1e-8", "1e-11"):
        text = f"{CART}control: {law}, {STEP}}}\nsimulate: {{duration: 9, samples: 41}}"
        asked = ["outputs.response=true", f"simulate.rtol={rtol}", "simulate.error_estimate=true"]
        summary = simulate(load_scene_text(text, overrides=asked)).summary
        own = summary["response"]["x"]
        assert own["errors"]["final_error"] >= summary["error_estimate"]["q_end"] >= 1e-16
        assert summary["control"]["tracking"]["x"]["errors"]["rms"] >= 1e-16
        ends.append((own["final_error"], own["errors"]["final_error"]))
    for one, off in ends:
        for other, more in ends:
            assert abs(one - other) <= off + more


def random_arm(seed: int) -> str:
    random = np.random.default_rng(seed)
    joints, links = [], []
    for k, name in enumerate("ab"):
        axis = [*random.uniform(-0.3, 0.3, 2).round(3).tolist(), 1]
        joints.append(
            f"{{name: {name}, type: {random.choice(['revolute', 'prismatic'])}, axis: {axis}, "
            f"origin: {{xyz: [{0.4 * k}, 0, 0]}}, damper: {{damping: {random.uniform(0.1, 0.5):.3f}}}}}"
        )
        com = random.uniform(-0.2, 0.2, 3).round(3).tolist()
        links.append(f"{{name: L{name}, mass: {random.uniform(0.5, 2):.3f}, com: {com}, {INERTIA}}}")
    gains = f"gains: {{kp: {random.uniform(8, 60):.3f}, kd: {random.uniform(2, 8):.3f}}}"
    keys = ("", ", period: 0.01, sensors: {noise: 1e-4, rates: differences}", ", limit: 6")[seed % 3]
    kind = ("pd", "computed_torque", "gravity")[seed // 3 % 3]
    return (
        f"schema: 1\ngravity: [0, -9.81, 0]\nrobot: {{joints: [{', '.join(joints)}], links: [{', '.join(links)}]}}\n"
        f"initial: {{q: {{a: 0.2, b: -0.3}}}}\ncontrol: {{type: {kind}, {gains}{keys}, reference: "
        "{type: joint, duration: 1, q: {a: '0.5', b: '0.1*sin(3*t)'}}}\nsimulate: {duration: 1, samples: 21}\n"
    )


INERTIA = "inertia: {xx: 0.15, yy: 0.17, zz: 0.16}"


@pytest.mark.parametrize("seed", range(6))
def test_figures_of_random_arms_move_within_their_errors(seed: int) -> None:
    runs = []
    for rtol, samples in (("1e-6", 21), ("1e-10", 44)):
        asked = [f"simulate.rtol={rtol}", f"simulate.samples={samples}", "simulate.error_estimate=true"]
        scene = load_scene_text(random_arm(seed), overrides=["outputs.response=true", *asked])
        runs.append(figures_of("simulate", simulate(scene).summary))
    found = [x for x in moves(dict(zip(("one", "two"), runs))) if x.key.startswith(("response", "control"))]
    assert len(found) > 20 and not [str(x) for x in found if x.ratio > 1.0]


SWITCHING = """\
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0.1327, -0.0127, 1.0], damper: {damping: 0.2972}, spring: {stiffness: 19.8105}}]
  links: [{name: L, mass: 0.4942, com: [0.2041, -0.028, 0.028], inertia: {xx: 0.0465, yy: 0.0352, zz: 0.0489}}]
initial: {q: {a: 0.368}}
control: {type: pd, period: 0.0137, limit: 13.4189, gains: {kp: 82.8527, kd: 12.241},
  reference: {type: joint, duration: 1.5, q: {a: "0.7375*sin(3.5456*t)"}}}
simulate: {duration: 1.5, samples: 401}
"""


def test_times_at_a_limit_are_unsure_where_torques_come_near_to_it() -> None:
    """A loop that switches between its limits at each sample, and amplifies what its motion is off."""
    told = []
    for rtol in ("1e-6", "1e-10"):
        asked = [f"simulate.rtol={rtol}", "simulate.error_estimate=true"]
        own = simulate(load_scene_text(SWITCHING, overrides=asked)).summary["control"]
        told.append((own["saturated"]["a"], own["saturated_error"]["a"]))
    (one, off), (two, more) = told
    assert one > 0.3 and 1e-3 < abs(one - two) <= off + more


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

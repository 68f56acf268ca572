"""Sticking and slipping by events: closed forms, several joints at once, convergence of the smooth law to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate
from tests.mechanisms import SLIDER

CONFIGS = Path(__file__).parents[2] / "configs"

BLOCK = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  base: {rpy: [0, -20 deg, 0]}
  joints: [{name: x, type: prismatic, axis: [1, 0, 0], friction: {law: set_valued, coulomb: 9, side: joint}}]
  links: [{name: block, mass: 2, com: [0, 0, 0]}]
initial: {q: {x: 0}, qd: {x: 3}}
simulate: {duration: 2, samples: 201, rtol: 1e-11, atol: 1e-13}
"""


def run(text: str, *overrides: str) -> Any:
    return simulate(load_scene_text(text, overrides=overrides))


def kinds(found: Any) -> list[str]:
    return [event["kind"] for event in found.events]


def test_a_block_slides_up_an_incline_and_stays_or_comes_back() -> None:
    """Deceleration g sin + F/m upwards; at rest it stays if F > m g sin, else slides down with g sin - F/m."""
    weight, m, F = 2 * 9.81 * np.sin(np.radians(20)), 2.0, 9.0
    assert weight < F
    found = run(BLOCK)
    t, stop = found["time"], 3.0 / ((weight + F) / m)
    top = 3.0**2 / 2 / ((weight + F) / m)
    up = 3 * np.minimum(t, stop) - (weight + F) / m * np.minimum(t, stop) ** 2 / 2
    assert kinds(found) == ["stick"] and abs(found.events[0]["time"] - stop) < 1e-12
    assert np.abs(found["q"][:, 0] - up).max() < 1e-12
    assert np.all(found["qd"][t > stop, 0] == 0.0) and np.ptp(found["q"][t > stop, 0]) == 0.0
    assert np.abs(found["energy/work"][-1] + F * top) < 1e-11 and found.summary["energy_drift"] < 1e-11
    back = run(BLOCK, "robot.joints.x.friction.coulomb={positive: 9, negative: -4}")
    stop, top = 3.0 / ((weight + 9) / m), 3.0**2 / 2 / ((weight + 9) / m)
    late = t > stop
    assert np.abs(back["q"][late, 0] - (top - (weight - 4) / m * (t[late] - stop) ** 2 / 2)).max() < 1e-11
    assert kinds(back) == ["slip"]


def test_an_oscillator_with_coulomb_friction_stops_exactly() -> None:
    """Each half cycle is a cosine about +-F/k and ends 2 F/k nearer; it stops where k |x| is below F (Den Hartog)."""
    k, m, F, x0 = 50.0, 2.0, 3.0, 1.0
    found = run(
        BLOCK, "robot.base.rpy=[0, 0, 0]", "robot.joints.x.friction.coulomb=3", "robot.joints.x.spring={stiffness: 50}",
        "initial={q: {x: 1}}", "simulate.duration=6",
    )  # fmt: skip
    w, t = np.sqrt(k / m), found["time"]
    expected, amplitude, side, start = np.zeros_like(t), x0, 1.0, 0.0
    while k * amplitude > F:
        part = (t >= start) & (t <= start + np.pi / w)
        expected[part] = side * ((amplitude - F / k) * np.cos(w * (t[part] - start)) + F / k)
        amplitude, side, start = amplitude - 2 * F / k, -side, start + np.pi / w
    expected[t > start] = side * amplitude
    assert np.abs(found["q"][:, 0] - expected).max() < 1e-10
    assert kinds(found)[-1] == "stick" and abs(found.events[-1]["time"] - start) < 1e-9
    assert np.all(found["qd"][t > start + 1e-9] == 0.0)
    assert found.summary["energy_drift"] < 1e-10
    assert found.summary["error_estimate"]["state_max"] < 1e-8


BELT = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: belt, type: prismatic, axis: [1, 0, 0]}
    - {name: slide, type: prismatic, axis: [1, 0, 0], friction: {law: set_valued, coulomb: 6, static: 10, viscous: 0.3}}
  links: [{name: band, mass: 1, com: [0, 0, 0]}, {name: block, mass: 1.5, com: [0, 0, 0]}]
prescribed: {belt: "0.2*t"}
forces: [{name: spring, type: spring, between: [base.origin, block.com], stiffness: 20}]
initial: {q: {belt: 0, slide: 0}, qd: {slide: 0}}
simulate: {duration: 12, samples: 1201, rtol: 1e-11, atol: 1e-13}
"""


def test_a_block_on_a_moving_belt_sticks_and_slips() -> None:
    """It is carried until the spring has the break-away force, slips, and is caught at the speed of the belt again."""
    found = run(BELT)
    k, m, b, speed = 20.0, 1.5, 0.3, 0.2
    slip = 10.0 / k / speed
    assert kinds(found)[:3] == ["stick", "slip", "stick"]
    assert abs(found.events[1]["time"] - slip) < 1e-11
    # while it slips back: m x'' = -k x + F - b (x' - speed), from x = 0.5 and x' = 0.2
    mean, decay = (6.0 + b * speed) / k, b / (2 * m)
    w = np.sqrt(k / m - decay**2)
    a, s = 0.5 - mean, (speed + decay * (0.5 - mean)) / w

    def rate(t: float) -> float:
        c, d = np.cos(w * t), np.sin(w * t)
        return float(np.exp(-decay * t) * ((-decay * a + w * s) * c - (decay * s + w * a) * d))

    low, high = 0.1, 2 * np.pi / w  # it has the belt's speed again in the second half of the cycle
    low = next(x for x in np.linspace(0.02, high, 2000) if rate(x) < speed - 1e-3)
    high = next(x for x in np.linspace(low, high, 2000) if rate(x) > speed)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rate(middle) < speed else (low, middle)
    assert abs(found.events[2]["time"] - slip - high) < 1e-9
    assert found.summary["energy_drift_relative"] < 1e-9
    cycle = np.diff([e["time"] for e in found.events if e["kind"] == "slip"])
    assert np.ptp(cycle) < 1e-8
    # with Stribeck's curve the friction falls gradually, and less energy goes into each slip
    stribeck = run(BELT, "robot.joints.slide.friction.stribeck_speed=0.2")
    assert abs(stribeck.events[1]["time"] - slip) < 1e-11
    assert stribeck.summary["energy_drift_relative"] < 1e-8


PAIR = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: a, type: prismatic, axis: [1, 0, 0], friction: {law: set_valued, coulomb: 4}}
    - {name: b, type: prismatic, parent: base, axis: [0, 1, 0], friction: {law: set_valued, coulomb: 4}}
    - {name: c, type: prismatic, parent: right, axis: [1, 0, 0], friction: {law: set_valued, coulomb: 1}}
  links: [{name: left, mass: 2, com: [0, 0, 0]}, {name: right, mass: 1, com: [0, 0, 0]}, {name: top, mass: 1, com: [0, 0, 0]}]
initial: {q: {a: 0, b: 0, c: 0}, qd: {a: 1, b: 1}}
simulate: {duration: 3, samples: 31}
"""


def test_two_joints_stick_at_once_and_one_goes_on_alone() -> None:
    found = run(PAIR, "torques={c: '0.5*t'}")
    sticks = {e["name"]: e["time"] for e in found.events if e["kind"] == "stick" and e["time"] > 0}
    assert set(sticks) == {"a", "b"} and abs(sticks["a"] - 0.5) < 1e-13 and abs(sticks["b"] - 0.5) < 1e-13
    (slip,) = (e for e in found.events if e["kind"] == "slip")
    assert slip["name"] == "c" and abs(slip["time"] - 2.0) < 1e-12
    t = np.maximum(found["time"] - 2.0, 0.0)
    assert np.abs(found["q"][:, 2] - 0.5 * t**3 / 6).max() < 1e-12


SERIES = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: a, type: prismatic, axis: [1, 0, 0], friction: {law: set_valued, coulomb: 3}}
    - {name: b, type: prismatic, axis: [1, 0, 0], friction: {law: set_valued, coulomb: 2}}
  links: [{name: cart, mass: 2, com: [0, 0, 0]}, {name: load, mass: 1, com: [0, 0, 0]}]
torques: {a: "%s"}
initial: {q: {a: 0, b: 0}}
simulate: {duration: 2, samples: 41}
"""


@pytest.mark.parametrize(
    ("force", "second"),
    [
        ("2.9", "stick"),
        ("6", "carried"),  # (6 - 3) / 3 = 1: the load needs 1 < 2 of friction
        ("15", "left behind"),
    ],
)
def test_loads_on_a_cart(force: str, second: str) -> None:
    found = run(SERIES % force)
    F, t = float(force), found["time"]
    if second == "stick":
        expected = (0.0, 0.0)
    elif second == "carried":
        expected = ((F - 3) / 3, 0.0)
    else:
        # the load is pulled along by friction 2: 2 / 1; the cart: (F - 3 - 2) / 2
        expected = ((F - 3 - 2) / 2, 2.0 - (F - 3 - 2) / 2)
    assert np.abs(found["q"] - 0.5 * t[:, None] ** 2 * np.array(expected)).max() < 1e-11


ARM = """
schema: 1
gravity: [1, 2, -9.81]
robot:
  joints:
    - {name: j1, type: revolute, axis: [0, 0, 1], friction: {%s, coulomb: 2, viscous: 0.05}}
    - {name: j2, type: revolute, origin: {xyz: [0.5, 0.1, 0], rpy: [0.4, 0, 0]}, axis: [0, 1, 0.3], gear_ratio: -20, rotor_inertia: 1e-4, friction: {%s, coulomb: {positive: 0.2, negative: -0.15}, side: motor}}
    - {name: j3, type: revolute, origin: {xyz: [0.3, 0, 0.1]}, axis: [1, 0.2, 0], friction: {%s, coulomb: 0.5}}
  links:
    - {name: l1, mass: 3, com: [0.2, 0.03, 0.01], inertia: {xx: 0.05, yy: 0.06, zz: 0.07, xy: 0.01, xz: -0.005, yz: 0.002}}
    - {name: l2, mass: 2, com: [0.1, 0.05, -0.02], inertia: {xx: 0.03, yy: 0.04, zz: 0.05, xy: 0.004, xz: -0.005, yz: 0.002}}
    - {name: l3, mass: 1, com: [0.1, -0.03, 0.04], inertia: {xx: 0.02, yy: 0.03, zz: 0.025, xy: 0.003, xz: -0.001, yz: 0.002}}
torques: {j1: "4*sin(3*t)", j2: "6*cos(2*t)"}
initial: {q: {j1: 0.3, j2: 0.8, j3: 0.1}, qd: {j1: 1}}
simulate: {duration: 2, samples: 101, rtol: 1e-9, atol: 1e-11}
"""


def test_the_smooth_law_tends_to_the_exact_one() -> None:
    """A spatial arm with friction in every joint: the difference falls with the transition speed."""
    exact = run(ARM % (("law: set_valued",) * 3))
    assert {"stick", "slip"} <= set(kinds(exact)) and len(exact.events) > 5
    assert exact.summary["energy_drift_relative"] < 1e-7
    gaps = []
    for speed in (3e-3, 3e-4):
        smooth = run(ARM % ((f"transition_speed: {speed}",) * 3), "simulate.error_estimate=false")
        gaps.append(np.abs(smooth["q"] - exact["q"]).max())
    assert gaps[1] < 2e-3 and gaps[1] < 0.2 * gaps[0]


@pytest.mark.parametrize("method", ["gauss", "dop853", "dopri5", "rodas5p"])
def test_every_method_takes_the_same_events(method: str) -> None:
    found = run(
        ARM % (("law: set_valued",) * 3),
        f"simulate.integrator={method}",
        "simulate.rtol=1e-8",
        "simulate.atol=1e-10",
    )
    exact = run(ARM % (("law: set_valued",) * 3))
    assert [(e["name"], e["kind"]) for e in found.events] == [(e["name"], e["kind"]) for e in exact.events]
    assert np.abs(found["q"] - exact["q"]).max() < 1e-6


def test_loops_with_friction_in_the_crank() -> None:
    """A slider-crank with one sticking joint: one degree of freedom, so its friction is determined."""
    text = "schema: 1\n" + SLIDER.replace(
        "a: 0.3, alpha: 0, d: 0}", "a: 0.3, alpha: 0, d: 0, friction: {law: set_valued, coulomb: 4}}", 1
    )
    found = run(text, "torques={crank: '14*sin(2*t)'}", "simulate.duration=6")
    assert {"stick", "slip"} <= set(kinds(found))
    assert found.summary["energy_drift_relative"] < 1e-8
    assert found.summary["constraint_residual"]["position"] < 1e-12


def test_inverse_dynamics_needs_no_contact_states() -> None:
    law = "robot.joints.theta1.friction={law: set_valued, coulomb: 1, static: 2}"
    found = inverse(load_scene(CONFIGS / "2r_circle.yaml", [law]))
    assert np.abs(found["torque_terms/friction"][:, 0] - np.sign(found["qd"][:, 0])).max() < 1e-12


def test_stribeck_in_inverse_and_in_the_smooth_law() -> None:
    law = "robot.joints.theta1.friction={coulomb: 1, static: 2, stribeck_speed: 0.1, viscous: 0.5}"
    found = inverse(load_scene(CONFIGS / "2r_circle.yaml", [law]))
    v = found["qd"][:, 0]
    expected = np.sign(v) * (1 + np.exp(-((v / 0.1) ** 2))) + 0.5 * v
    assert np.abs(found["torque_terms/friction"][:, 0] - expected).max() < 1e-12


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("{law: set_valued, coulomb: 1, transition_speed: 1}", "smooths nothing"),
        ("{coulomb: 1, stribeck_speed: 1}", "static"),
        ("{coulomb: 1, static: 2}", "stribeck_speed"),
        ("{law: set_valued, coulomb: 2, static: 1}", "below"),
        ("{law: set_valued, coulomb: {positive: 1, negative: 1}}", "oppose"),
    ],
)
def test_laws_that_do_not_fit_together(law: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        load_scene_text(BLOCK.replace("{law: set_valued, coulomb: 9, side: joint}", law))

"""Limits of joints without stops: what passes them is said with joint and time, and moves as if there were none."""

from __future__ import annotations

import re

import numpy as np
import pytest

from robodyn_cli import inverse, kinematics, simulate
from robodyn_cli.errors import SceneError
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text

CART = """\
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0], limits: LIMITS}]
  links: [{name: cart, mass: 2}]
"""


def cart(limits: str, more: str) -> str:
    return CART.replace("LIMITS", limits) + more


def warnings(result: Result) -> list[str]:
    return list(result.summary.get("warnings", []))


def time_of(text: str) -> float:
    found = re.search(r"at t = (\S+) s", text)
    assert found is not None, text
    return float(found[1])


PUSHED = 'torques: {x: "4*t"}\ninitial: {q: {x: 0}}\nsimulate: {duration: 2, samples: 3}\n'  # x = t^3 / 3


@pytest.mark.parametrize(
    ("limits", "words", "time"),
    [
        ("{upper: 1}", "passes its upper limit of 1 m", 3 ** (1 / 3)),
        ("{speed: 0.5}", "passes its speed limit of 0.5 m/s", 0.5**0.5),
        ("{effort: 5}", "passes its effort limit of 5 N", 1.25),
        ("{lower: 0.1}", "starts beyond its lower limit of 0.1 m", None),
        ("{upper: 3, speed: 5, effort: 9}", "", None),
        ("{lower: 8.9e-15}", "", None),  # as files round zero
    ],
)
def test_a_simulation_says_when(limits: str, words: str, time: float | None) -> None:
    """Between the samples of a run: at the times of the closed form."""
    found = warnings(simulate(load_scene_text(cart(limits, PUSHED))))
    if not words:
        assert found == []
        return
    assert len(found) == 1 and f"joint 'x' {words}" in found[0]
    assert time is None or abs(time_of(found[0]) - time) < 1e-5


def test_a_short_excursion_between_samples_is_seen() -> None:
    """q = 1.001 sin(t), beyond 1 for a moment, at its largest at pi/2; samples at 0, 5, 10."""
    more = "initial: {q: {x: 0}, qd: {x: 1.001}}\nsimulate: {duration: 10, samples: 3}\n"
    text = cart("{lower: -2, upper: 1}, spring: {stiffness: 2}", more)
    found = warnings(simulate(load_scene_text(text)))
    assert len(found) == 1 and abs(time_of(found[0]) - np.arcsin(1 / 1.001)) < 1e-5


@pytest.mark.parametrize(
    "more",
    [
        "type: pd, gains: {kp: 100, kd: 1}",
        "type: pd, gains: {kp: 100, kd: 1}, limit: {x: 3}",
        "type: pid, gains: {kp: 100, kd: 1, ki: 5}",
        "type: pid, gains: {kp: 100, kd: 1, ki: 5}, period: 0.01, delay: 0.02",
        "type: pd, gains: {kp: 100, kd: 1}, period: 0.01, sensors: {noise: 1e-4, seed: 1}",
    ],
)
def test_a_controller_at_the_limit_of_its_joint_does_not_pass_it(more: str) -> None:
    motion = (
        'control: {CONTROL, reference: {type: joint, duration: 1, q: {x: "t^2*5"}}}\ninitial: {q: {x: 0}}\n'
    )
    more = motion.replace("CONTROL", more) + "simulate: {duration: 1, samples: 101}\n"
    result = simulate(load_scene_text(cart("{effort: 3}", more)))
    assert np.abs(result["tau"]).max() == 3.0
    assert warnings(result) == []


def test_a_joint_that_is_led_along_its_limits_does_not_pass_them() -> None:
    more = 'prescribed: {x: "sin(3*t)"}\nsimulate: {duration: 2, samples: 3}\n'
    assert warnings(simulate(load_scene_text(cart("{upper: 1, lower: -1, speed: 3}", more)))) == []


def test_limits_change_nothing() -> None:
    text = cart("{upper: 0.3, speed: 0.2, effort: 1}", PUSHED)
    limited = simulate(load_scene_text(text))
    free = simulate(load_scene_text(text.replace(", limits: {upper: 0.3, speed: 0.2, effort: 1}", "")))
    assert np.abs(limited["q"] - free["q"]).max() < 1e-12
    assert len(warnings(limited)) == 3 and not warnings(free)
    assert limited.summary["error_estimate"]["q_end"] < 1e-10


def test_acceleration_and_jerk_of_a_simulation() -> None:
    """a = 2 t, jerk 2: looked at in the samples."""
    more = PUSHED.replace("samples: 3", "samples: 201")
    found = warnings(simulate(load_scene_text(cart("{acceleration: 3, jerk: 1.9}", more))))
    assert [re.sub(r" m/s.*", "", text) for text in found] == [
        "joint 'x' is beyond its acceleration limit of 3",
        "joint 'x' is beyond its jerk limit of 1.9",
    ]
    assert "from t = 1.51 s; 4 m/s^2 at t = 2 s" in found[0]


MOTION = 'trajectory: {type: joint, duration: 2, q: {x: "t^3/3"}}\ninverse: {samples: 201}\nkinematics: {samples: 201}\n'


def test_a_given_motion_beyond_limits() -> None:
    limits = "{lower: -1, upper: 1, speed: 2, acceleration: 3, jerk: 1.9, effort: 5}"
    scene = load_scene_text(cart(limits, MOTION))
    words = [
        "upper limit of 1 m from t = 1.45 s; 2.66667 m at t = 2 s",
        "speed limit of 2 m/s from t = 1.42 s; 4 m/s at t = 2 s",
        "acceleration limit of 3 m/s^2 from t = 1.51 s; 4 m/s^2 at t = 2 s",
        "jerk limit of 1.9 m/s^3 from t = 0 s; 2 m/s^3 at t = ",
        "effort limit of 5 N from t = 1.26 s; 8 N at t = 2 s",
    ]
    for command, expected in ((inverse, words), (kinematics, words[:4])):
        found = warnings(command(scene))
        assert len(found) == len(expected)
        for text, part in zip(found, expected):
            assert f"joint 'x' is beyond its {part}" in text, text


def test_warning_and_legend_state_the_peak_of_the_summary() -> None:
    """The peak of 2 |x''| lies between samples."""
    motion = 'trajectory: {type: joint, duration: 1, q: {x: "sin(4*t)"}}\ninverse: {samples: 41}\n'
    result = inverse(load_scene_text(cart("{effort: 5}", motion)))
    peak = result.summary["joints"]["x"]["peak_torque"]
    assert abs(peak - 32.0) < 1e-6 and np.abs(result["tau"]).max() < 31.999
    assert f"; -{peak:.6g} N at t = {np.pi / 8:.6g} s" in warnings(result)[0]
    from robodyn_cli.report.registry import draw

    labels = " ".join(
        text.get_text() for text in draw(result, "torques").findobj() if hasattr(text, "get_text")
    )
    assert "peak -32 N" in labels.replace("\u2212", "-") or "peak -32," in labels.replace("\u2212", "-")


def test_a_motion_on_its_limits_is_within_them() -> None:
    text = cart("{upper: 8/3, speed: 4, acceleration: 4, effort: 8}", MOTION)
    assert warnings(inverse(load_scene_text(text))) == []


def test_stops_speak_for_positions() -> None:
    """Beyond a stop there is a torque, or an impact: nothing else is said of it."""
    text = cart("{upper: 1, speed: 9, stop: {stiffness: 1000}}", PUSHED)
    assert warnings(simulate(load_scene_text(text))) == []
    given = warnings(inverse(load_scene_text(cart("{upper: 1, stop: {stiffness: 10}}", MOTION))))
    assert len(given) == 1 and given[0].endswith("the torques press on its stop")
    rigid = warnings(inverse(load_scene_text(cart("{upper: 1, stop: {restitution: 0}}", MOTION))))
    assert len(rigid) == 1 and rigid[0].endswith("its rigid stop is ignored")


def test_no_term_of_torque_without_a_stop() -> None:
    with_limits = inverse(load_scene_text(cart("{upper: 1}", MOTION)))
    assert not any(name.startswith("torque_terms/stops") for name in with_limits.variables)


CHAIN = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
%s
  links:
%s
initial: {q: {%s}}
simulate: {duration: 0.3, samples: 31, rtol: 1e-8, atol: 1e-10}
"""


@pytest.mark.parametrize(("n", "method"), [(3, "dop853"), (3, "generalized_alpha"), (40, "auto")])
def test_in_long_chains_and_by_other_methods(n: int, method: str) -> None:
    """Against the samples: each joint is said to pass its limit in the interval in which its rate does."""
    joints = "\n".join(
        f"    - {{name: j{k}, type: revolute, axis: [0, 1, 0], origin: {{xyz: [0.1, 0, 0]}}, limits: {{speed: 2}}}}"
        for k in range(n)
    )
    links = "\n".join(
        f"    - {{name: l{k}, mass: 0.2, com: [0.05, 0, 0], inertia: {{xx: 1e-4, yy: 1e-3, zz: 1e-3}}}}"
        for k in range(n)
    )
    text = CHAIN % (joints, links, ", ".join(f"j{k}: {0.05 * k}" for k in range(n)))
    scene = load_scene_text(
        text,
        overrides=[f"simulate.integrator={method}"]
        + (["simulate.step=1e-3"] if method == "generalized_alpha" else []),
    )
    result = simulate(scene)
    said = {text.split("'")[1]: time_of(text) for text in warnings(result)}
    beyond = np.abs(result["qd"]) > 2
    assert said and set(said) >= {f"j{k}" for k in np.flatnonzero(beyond.any(axis=0))}
    for name, time in said.items():
        column = beyond[:, int(name[1:])]
        if column.any():
            first = int(np.argmax(column))
            assert result["time"][first - 1] - 1e-9 <= time <= result["time"][first] + 1e-9


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ("{upper: 1, lower: 2}", "must be above 'lower'"),
        ("{velocity: 1}", "unknown key 'velocity'"),
        ("{acceleration: -1}", "too small"),
        ("{effort: 3, stop: {stiffness: 10}}", "'lower' or 'upper' beside it"),
    ],
)
def test_limits_that_make_no_sense(limits: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        load_scene_text(cart(limits, MOTION))

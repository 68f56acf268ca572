"""Derivatives of extremes: closed forms, random chains beside differences, ends that move, corners, kinematic design."""

from __future__ import annotations

import math

import mpmath
import pytest

from robodyn_cli.over.sensitivity.asked import prepare
from robodyn_cli.over.sensitivity.differences import differences
from robodyn_cli.over.sensitivity.report import exact_slopes, sensitivity
from robodyn_cli.scene.load import Family, load_scene_text
from tests.unit.test_sensitivity import (
    CONFIGS,
    asked,
    compare_with_differences,
    exact,
    random_scene,
)

WAVE = """
schema: 1
command: simulate
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, parent: base, axis: [1, 0, 0], spring: {stiffness: 12, rest: 0}}]
  links: [{name: ball, mass: 3.0}]
  points: {tip: {link: ball, at: [0, 0.3, 0]}}
initial: {q: {x: 0.2}, qd: {x: 0.5}}
simulate: {duration: 2.6, samples: 7, rtol: 1e-11, atol: 1e-13}
"""


def test_an_oscillator_has_a_closed_form() -> None:
    """The amplitude is sqrt(x^2 + m v^2 / k), the largest speed that times sqrt(k / m); what is last is last."""
    keys = ["robot.links.ball.mass", "robot.joints.x.spring.stiffness", "initial.q.x", "initial.qd.x"]
    at = (3.0, 12.0, 0.2, 0.5)

    def swing(m, k, x, v):  # type: ignore[no-untyped-def]
        return mpmath.sqrt(x * x + m * v * v / k)

    def last(m, k, x, v):  # type: ignore[no-untyped-def]
        w = mpmath.sqrt(k / m)
        return x * mpmath.cos(2.6 * w) + v / w * mpmath.sin(2.6 * w)

    true = {
        "extremes.q.x.largest": swing,
        "extremes.points/tip.x.smallest": lambda *x: -swing(*x),
        "extremes.points/tip.length.smallest": lambda *x: mpmath.mpf("0.3"),
        "extremes.qd.x.smallest": lambda m, k, x, v: -swing(m, k, x, v) * mpmath.sqrt(k / m),
        "extremes.qdd.x.largest": lambda m, k, x, v: swing(m, k, x, v) * k / m,
        "extremes.q.x.final": last,
    }
    found = exact(asked(WAVE, keys, list(true)))
    for name, function in true.items():
        for k, key in enumerate(keys):
            slope = found[name, key]
            expected = float(mpmath.diff(function, at, tuple(int(j == k) for j in range(4))))
            assert abs(slope.value - expected) <= slope.error <= 1e-6, (name, key, slope, expected)


@pytest.mark.parametrize("seed", range(3))
def test_random_chains_agree_with_differences(seed: int) -> None:
    text, keys = random_scene(seed)
    names = ("q.j0.largest", "qd.j2.smallest", "qdd.j1.largest", "q.j1.final")
    question = asked(text, keys[:3], [f"extremes.{name}" for name in names])
    compare_with_differences(question, 5.0)


def test_extremes_up_to_a_lock_and_at_it() -> None:
    names = ("qd.theta1.largest", "q.phi1.largest", "q.theta1.final", "tau.theta1.smallest")
    to = ["torques.theta1#2", "robot.joints.theta1.a"]
    question = asked(CONFIGS / "four_bar_deploy.yaml", to, [f"extremes.{name}" for name in names])
    found = exact(question)
    # the pose of the lock is geometry, and the spring is weakest there
    angle = math.acos((1.2 * 2) ** 2 / (-2 * 1.241**2) + 1)
    weakest = found["extremes.tau.theta1.smallest", "torques.theta1#2"]
    assert abs(weakest.value + angle) <= weakest.error <= 1e-9
    with mpmath.workdps(25):
        turned = mpmath.diff(lambda a: mpmath.acos((a * a + mpmath.mpf("1.241") ** 2 - mpmath.mpf("2.4") ** 2) / (2 * a * mpmath.mpf("1.241"))), mpmath.mpf("1.241"))  # fmt: skip
    last = found["extremes.q.theta1.final", "robot.joints.theta1.a"]
    assert abs(last.value - float(turned)) <= last.error <= 1e-7
    compare_with_differences(asked(CONFIGS / "four_bar_deploy.yaml", to[:1], ["extremes.qd.theta1.largest"]))


def test_a_corner_is_left_to_differences() -> None:
    """A force that sets in at once makes the largest acceleration one of a jump; equal swings are not told apart."""
    key = "robot.joints.x.spring.stiffness"
    pushed = WAVE.replace("initial:", 'torques: {x: "if(t > 1, 100*exp(1 - t), 0)"}\ninitial:')
    found = exact(asked(pushed, [key], ["extremes.qdd.x.largest", "extremes.q.x.final"]))
    assert ("extremes.q.x.final", key) in found and ("extremes.qdd.x.largest", key) not in found
    longer = WAVE.replace("duration: 2.6", "duration: 12")
    assert not exact(asked(longer, [key], ["extremes.q.x.largest"]))


def test_kinematic_design_has_exact_derivatives() -> None:
    """The rocker turns back where crank and coupler are in line: the law of cosines."""
    path = CONFIGS / "mechanisms" / "kinematic_design.yaml"
    names = [
        "extremes.q.rocker.largest",
        "extremes.pressure_angles/drive.largest",
        "extremes.ratios/output.largest",
    ]
    to = ["robot.joints.crank.a", "robot.joints.coupler.a"]
    result = sensitivity(Family(path, ("expect={}",)), to, names)
    with mpmath.workdps(25):
        a, b, c, g = (mpmath.mpf(x) for x in ("0.4", "1.2", "0.9", "1.0"))

        def most(a, b):  # type: ignore[no-untyped-def]
            return mpmath.pi - mpmath.acos((c * c + g * g - (a + b) ** 2) / (2 * c * g))

        expected = [abs(mpmath.diff(most, (a, b), x)) for x in ((1, 0), (0, 1))]
    own = result.summary["sensitivities"][names[0]]
    for key, _ in zip(to, expected):
        assert own[key]["method"] == "exact" and own[key]["error"] < 1e-8
    question = prepare(Family(path, ("expect={}",)), to, names[1:])
    compare_with_differences(question, 5.0)
    assert len(exact_slopes(question)[0]) == 4


def test_differences_narrow_until_they_resolve_an_extreme() -> None:
    """The crank of the folded four-bar moves the least acceleration over parts of a thousandth of its length."""
    question = asked(
        CONFIGS / "four_bar_deploy.yaml",
        ["robot.joints.theta1.a"],
        ["extremes.qdd.phi1.smallest", "lock.time"],
    )
    compare_with_differences(question, 5.0)
    own = differences(question, [0], 1)[0]
    assert own[0].error < 1e-5 * abs(own[0].value) and own[1].error < 1e-7 * abs(own[1].value)


def test_an_extreme_at_the_start_is_that_of_the_start() -> None:
    text = WAVE.replace("qd: {x: 0.5}", "qd: {x: 0}").replace("duration: 2.6", "duration: 0.5")
    slope = exact(asked(text, ["initial.q.x"], ["extremes.q.x.largest"]))[
        "extremes.q.x.largest", "initial.q.x"
    ]
    assert abs(slope.value - 1.0) <= slope.error <= 1e-6
    assert load_scene_text(text).simulate.duration == 0.5
    # what a key changes right after the start does not count there
    rest = exact(asked(text, ["robot.links.ball.mass"], ["extremes.qd.x.largest"]))
    none = rest["extremes.qd.x.largest", "robot.links.ball.mass"]
    assert abs(none.value) <= none.error <= 1e-7

"""Exact derivatives of small systems: closed forms, and quotients of two runs of the command itself."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.over.batch.criteria import lookup_number
from robodyn_cli.over.sensitivity.report import exact_slopes
from robodyn_cli.results.hdf5 import write
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate
from robodyn_cli.works.statics import statics
from tests.mechanisms import SLIDER
from tests.unit.test_drive_figures import SINE
from tests.unit.test_sensitivity import asked

CONFIGS = Path(__file__).parents[2] / "configs"
RUN: dict[str, Any] = {"inverse": inverse, "simulate": simulate, "kinematics": kinematics, "statics": statics}


def slopes(text: str, to: list[str], of: list[str]) -> dict[tuple[str, str], float]:
    """Return the exact derivatives by output and key; there must be all of them."""
    found, why = exact_slopes(asked(text, to, of))
    assert not why and len(found) == len(to) * len(of), why
    return {(name, to[k]): slope.value for (name, k), slope in found.items()}


def check(
    text: str, keys: dict[str, float], of: list[str], change: float = 1e-4, within: float = 1e-5
) -> None:
    """Compare with quotients of runs whose keys are a little larger and smaller than these values."""
    command = text.partition("command: ")[2].split()[0]
    found = slopes(text, list(keys), of)
    for key, value in keys.items():
        sides = [
            RUN[command](load_scene_text(text, overrides=[f"{key}={value + way * change!r}"])).summary
            for way in (1, -1)
        ]
        for name in of:
            above, below = (lookup_number(side, name) for side in sides)
            assert above is not None and below is not None
            quotient = (above - below) / (2.0 * change)
            assert found[name, key] == pytest.approx(quotient, rel=within, abs=within), (name, key)


MASS = """
schema: 1
command: simulate
gravity: [0, 0, 0]
parameters: {f: 3, on: 0.4, off: 0.6, k: 5}
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: body, mass: 2}]
initial: {q: {x: 0}, qd: {x: 1}}
simulate: {duration: 1, samples: 3, rtol: 1e-11, atol: 1e-13}
"""
ENDS = ["final.q.x", "final.qd.x"]


def test_a_force_that_begins_at_a_time() -> None:
    """x = v T + f (T - on)^2 / (2 m)."""
    found = slopes(
        MASS + 'torques: {x: "if(t > on, f, 0)"}\n',
        ["parameters.on", "parameters.f", "robot.links.body.mass"],
        ENDS,
    )
    left, a = 0.6, 1.5
    truth = {"parameters.on": (-a * left, -a), "parameters.f": (left**2 / 4.0, left / 2.0),
             "robot.links.body.mass": (-a * left**2 / 4.0, -a * left / 2.0)}  # fmt: skip
    for key, pair in truth.items():
        for name, y in zip(ENDS, pair):
            assert found[name, key] == pytest.approx(y, rel=1e-9), (name, key)


def test_a_force_that_begins_at_a_place() -> None:
    """It is reached at off / v; behind it x = off + v s - k s^2 / (2 m) for the time s that is left."""
    found = slopes(
        MASS + 'torques: {x: "if(x > off, -k, 0)"}\n', ["parameters.off", "initial.qd.x", "initial.q.x"], ENDS
    )
    a, s = 2.5, 0.4
    truth = {"parameters.off": (a * s, a), "initial.qd.x": (0.6 + s - a * s * 0.6, 1.0 - a * 0.6),
             "initial.q.x": (1.0 - a * s, -a)}  # fmt: skip
    for key, pair in truth.items():
        for name, y in zip(ENDS, pair):
            assert found[name, key] == pytest.approx(y, rel=1e-8), (name, key)


def test_a_mass_on_a_sampled_controller() -> None:
    """x and v over a period T under u = -kp x - kd v: a matrix, whose powers and their slopes by kp are exact."""
    text = MASS + "control: {type: pd, joints: [x], period: 0.1, gains: {kp: 20, kd: 4}}\n"
    found = slopes(text, ["initial.qd.x", "control.gains.kp"], ENDS)

    def end(kp: float) -> np.ndarray:
        T, m = 0.1, 2.0
        A = np.array([[1.0, T], [0.0, 1.0]]) + np.outer([T * T / (2 * m), T / m], [-kp, -4.0])
        return np.linalg.matrix_power(A, 10)

    slope = (end(20.0 + 1e-4) - end(20.0 - 1e-4)) @ np.array([0.0, 1.0]) / 2e-4
    for k, name in enumerate(ENDS):
        assert found[name, "initial.qd.x"] == pytest.approx(end(20.0)[k, 1], rel=1e-7)
        assert found[name, "control.gains.kp"] == pytest.approx(slope[k], rel=1e-6)


def test_a_mechanism_that_moves() -> None:
    text = "schema: 1\ncommand: simulate\n" + SLIDER.replace(
        "duration: 3, samples: 31", "duration: 0.2, samples: 3, rtol: 1e-11, atol: 1e-13"
    )
    check(
        text,
        {"robot.joints.rod.a": 0.9, "initial.q.crank": 0.2},
        ["final.q.slide", "final.qd.crank"],
        1e-4,
        1e-4,
    )


CIRCLE = """
schema: 1
command: inverse
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, a: 1, alpha: 0, d: 0}
    - {name: b, type: revolute, a: 0.8, alpha: 0, d: 0}
  links:
    - {name: A, mass: 2, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.2}}
    - {name: B, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
  points: {tip: {link: B, at: end}}
trajectory: {type: circle, point: tip, center: [-0.9, 0.4], radius: 0.3, duration: 2, ik: {branch: elbow_up}}
inverse: {samples: 41}
"""


def test_a_point_that_is_led() -> None:
    """A centre on the negative side too."""
    keys = {"trajectory.center.0": -0.9, "robot.joints.b.a": 0.8}
    check(CIRCLE, keys, ["joints.a.peak_torque", "joints.b.rms_torque"], 1e-5, 1e-4)


def test_figures_of_a_drive() -> None:
    """q = 0.3 t^3: torques rise with the inertia of the body, 0.7 kg m^2; the rotor turns 20 times as fast."""
    of = [
        "drives.j.joint.peak_torque",
        "drives.j.joint.rms_torque",
        "drives.j.shaft.peak_torque",
        "peak_torque.j",
    ]
    text = SINE.replace("schema: 1", "schema: 1\ncommand: inverse").replace("samples: 401", "samples: 31")
    text = text.replace("duration: 2", "duration: 1").replace("0.3*sin(2*pi*t)", "0.3*t^3")
    found = slopes(text, ["robot.links.l.inertia.zz"], of)
    for name, y in zip(of, (1.8, 1.8 / math.sqrt(3.0), 1.8 / 20.0, 1.8)):
        assert found[name, "robot.links.l.inertia.zz"] == pytest.approx(y, rel=1e-6), name


def test_the_stroke_of_a_slider_crank() -> None:
    """From b - a to b + a."""
    text = "schema: 1\ncommand: kinematics\n" + SLIDER.replace(
        "torques: {crank: 5}", 'prescribed: {crank: "0.2 + 2*pi*t"}'
    )
    of, to = ["joints.slide.smallest", "joints.slide.largest"], ["robot.joints.crank.a", "robot.joints.rod.a"]
    found = slopes(
        text.replace(
            "simulate: {duration: 3, samples: 31}", "simulate: {duration: 1}\nkinematics: {samples: 31}"
        ),
        to,
        of,
    )
    assert [found[name, key] for name in of for key in to] == pytest.approx([-1.0, 1.0, 1.0, 1.0], rel=1e-5)


def test_mechanisms_at_rest() -> None:
    text = "schema: 1\ncommand: statics\n" + SLIDER.replace(
        "torques: {crank: 5}", 'torques: {crank: "5 - 20*crank", slide: "-40*(slide - 1)"}'
    )
    keys = {"robot.joints.rod.a": 0.9, "robot.links.bar.mass": 1.0, "gravity.1": -9.81}
    of = [
        "configuration.crank",
        "configuration.slide",
        "torques_of_joints.crank",
        "multipliers.pin.x",
        "multipliers.pin.y",
    ]
    for hold in (", hold: [crank]", ""):
        check(text.replace(", hold: [crank]", hold) + "statics: {find: balance}\n", keys, of)


def test_a_pendulum_that_is_held() -> None:
    """m g c cos(q)."""
    text = """
schema: 1
command: statics
gravity: [0, -9.81, 0]
robot:
  joints: [{name: j, type: revolute, axis: [0, 0, 1]}]
  links: [{name: l, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.1}}]
initial: {q: {j: -0.4}}
statics: {find: hold}
"""
    found = slopes(text, ["initial.q.j", "robot.links.l.mass", "gravity.1"], ["torques_of_joints.j"])
    size = 9.81 * 0.5
    for key, y in (
        ("initial.q.j", 2 * size * math.sin(0.4)),
        ("robot.links.l.mass", size * math.cos(0.4)),
        ("gravity.1", -math.cos(0.4)),
    ):
        assert found["torques_of_joints.j", key] == pytest.approx(y, rel=1e-9)


def test_errors_of_a_run_have_no_exact_slopes() -> None:
    of = ["error_estimate.energy_quadrature", "ik_residual", "joints.a.peak_torque"]
    found, _ = exact_slopes(asked(CIRCLE, ["robot.links.B.mass"], of))
    assert [name for name, _ in found] == of[2:]


def test_keys_without_a_number_are_told_as_such() -> None:
    for key in ("robot.joints.x.type", "robot.joints.x.axis", "gravity", "title"):
        with pytest.raises(SceneError, match="the scene has no number there; allowed: a key with a number"):
            asked(MASS + "title: fall\n", [key], ENDS)
    with pytest.raises(SceneError, match="has no item named 'y'"):
        asked(MASS, ["robot.joints.y.axis"], ENDS)


def test_a_run_that_goes_on_is_left_to_differences(tmp_path: Path) -> None:
    write(simulate(load_scene_text(MASS)), tmp_path / "result.h5")
    question = asked(MASS, ["robot.links.body.mass"], ENDS, f"initial={{from: {tmp_path}, at: 0.5}}")
    found, why = exact_slopes(question)
    assert not found and "the run goes on from a stored one" in why[0]


@pytest.mark.parametrize("samples", [5, 9, 40, 201])
def test_the_slope_of_a_peak_between_samples(samples: int) -> None:
    """Published: 274.8100 N m/m, found apart from this program; the error covers what the samples leave of it."""
    text = load_scene(CONFIGS / "2r_circle.yaml", [f"inverse.samples={samples}"]).text
    found, why = exact_slopes(asked(text, ["trajectory.radius"], ["peak_torque.theta1"]))
    (slope,) = found.values()
    assert not why and abs(slope.value - 274.8100) < slope.error + 1e-4

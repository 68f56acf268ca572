"""Sensitivities of inverse dynamics, kinematics and statics: closed forms, and central differences on mechanisms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import inverse, sensitivity
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import differences, is_time_of_sample
from robodyn_cli.over.sensitivity.report import exact_slopes
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.load_sharing import share, share_change
from tests.mechanisms import SLIDER
from tests.unit.test_sensitivity import asked

CONFIGS = Path(__file__).parents[2] / "configs"
KNOWN = 1e-5  # relative error above which a difference proves nothing

# a slider-crank with an offset spring and full loads in its joints
LOADED = SLIDER.replace(
    "robot:",
    "forces: [{name: push, type: spring, between: [disc.end, base.origin], stiffness: 300, length: 0.2},\n"
    "         {name: pull, type: spring, between: [bar.end, base.origin], stiffness: 70, length: 0.5}]\n"
    "outputs: {reactions: true}\nparameters: {w: 1.3}\nrobot:",
    1,
)
STILL = LOADED.replace("torques: {crank: 5}", 'torques: {crank: "5 - 20*crank", slide: "-40*(slide - 1)"}')
LED = LOADED.replace(
    "torques: {crank: 5}",
    'trajectory: {type: joint, duration: 2, q: {crank: "0.3 + w*t + 0.2*t^2"}}\ninverse: {samples: 41}',
)
WRIST = """
gravity: [0.4, -2.0, -9.0]
robot:
  joints:
    - {name: a, type: revolute, parent: base, axis: [0.1, 0.2, 1], friction: {viscous: 0.4, coulomb: 0.3}}
    - {name: b, type: revolute, parent: la, axis: [0.3, 1, 0], origin: {xyz: [0.1, 0, 0.5]}, rotor_inertia: 1e-3, gear_ratio: 20}
    - {name: c, type: revolute, parent: lb, axis: [0, 1, 0.2], origin: {xyz: [0.4, 0.05, 0]}}
    - {name: d, type: revolute, parent: lc, axis: [1, 0.1, 0], origin: {xyz: [0.3, 0, 0]}}
    - {name: ee, type: revolute, parent: ld, axis: [0, 1, 0], origin: {xyz: [0.1, 0, 0]}}
    - {name: f, type: revolute, parent: le, axis: [1, 0, 0.3], origin: {xyz: [0.1, 0.03, 0]}}
  links:
    - {name: la, mass: 3, com: [0.02, 0.1, 0.2], inertia: {xx: 0.1, yy: 0.12, zz: 0.09, xy: 0.01, xz: 0.02, yz: 0.005}}
    - {name: lb, mass: 2, com: [0.2, 0.03, 0.02], inertia: {xx: 0.03, yy: 0.1, zz: 0.09, xy: 0.004, xz: 0.002, yz: 0.001}}
    - {name: lc, mass: 1, com: [0.1, 0.02, 0.03], inertia: {xx: 0.01, yy: 0.02, zz: 0.02, xy: 0.001, xz: 0.002, yz: 0.001}}
    - {name: ld, mass: 0.7, com: [0.05, 0.01, 0], inertia: {xx: 0.004, yy: 0.005, zz: 0.006, xy: 0.001}}
    - {name: le, mass: 0.5, com: [0.05, 0, 0.02], inertia: {xx: 0.003, yy: 0.004, zz: 0.005, xz: 0.001}}
    - {name: lf, mass: 0.4, com: [0.03, 0.02, 0.01], inertia: {xx: 0.002, yy: 0.003, zz: 0.002, yz: 0.0005}}
  points: {tool: {link: lf, at: [0.1, 0.02, 0.03]}}
initial: {q: {a: 0.3, b: 0.4, c: 0.6, d: 0.5, ee: 0.9, f: 0.2}}
inverse: {samples: 41}
kinematics: {samples: 41}
"""


@pytest.fixture(autouse=True)
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Differences of three steps, of order six, are known far better than ``KNOWN``; the other two are runs for nothing."""
    monkeypatch.setattr("robodyn_cli.over.sensitivity.differences.LEVELS", 3)


def agree(text: str | Path, to: list[str], of: list[str], *overrides: str) -> None:
    """All derivatives are exact; they are central differences, as closely as these are known."""
    question = asked(text, to, of, *overrides)
    found, why = exact_slopes(question)
    assert not why and len(found) == len(to) * len(of), why
    others, proved = differences(question, range(len(to)), 1), 0
    for k, key in enumerate(to):
        for name, other in zip(of, others[k]):
            slope = found[name, k]
            size = max(abs(slope.value), 1e-3 * max(abs(found[name, j].value) for j in range(len(to))))
            assert slope.value == pytest.approx(other.value, rel=1e-8, abs=5.0 * other.error + 1e-9), (
                name,
                key,
            )
            proved += abs(slope.value - other.value) <= KNOWN * max(size, 1e-6)
    assert proved >= 0.7 * len(found)


# -- inverse ---------------------------------------------------------------------------------------------------
OF_TORQUES = ["peak_torque.crank", "rms_torque.crank", "joints.crank.energy", "joints.crank.torque_range.0",
              "reactions.largest.pin.peak_force", "reactions.largest.rod.peak_force"]  # fmt: skip


def test_torques_of_a_mechanism() -> None:
    to = ["robot.links.bar.mass", "robot.joints.rod.a", "parameters.w", "gravity.1", "forces.push.stiffness",
          "trajectory.duration", "robot.links.disc.inertia.zz"]  # fmt: skip
    agree("schema: 1\ncommand: inverse\n" + LED, to, OF_TORQUES, "actuated=[crank]")


CROWDED = """
schema: 1
command: inverse
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], friction: {coulomb: 3}}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.6, 0, 0]}, friction: {coulomb: 2}}
  links:
    - {name: A, mass: 2, com: [0.3, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: B, mass: 1, com: [0.2, 0, 0], com_frame: joint, inertia: {zz: 0.05}}
trajectory: {type: quintic, points: [{t: 0, q: {a: 0, b: 0}}, {t: 0.5, q: {a: 0.6, b: 0.5}, qd: {a: 0.01, b: -0.004}},
  {t: 1, q: {a: 0.1, b: 0.2}}]}
inverse: {samples: 41}
"""


def test_friction_that_turns_near_a_knot() -> None:
    """A cut where a joint turns back moves with the key: the lowest torque of b is there (by -0.004 rad/s it was
    6.9e-6, with an error of 2.9e-9)."""
    to = [
        "robot.links.A.mass",
        "trajectory.points.1.qd.a",
        "trajectory.points.1.qd.b",
        "trajectory.points.1.t",
    ]
    of = ["joints.b.torque_range.0", "peak_torque.b", "rms_torque.b", "peak_torque.a", "joints.a.peak_power"]
    agree(CROWDED, to, of)
    found, _ = exact_slopes(asked(CROWDED, to, of))
    for output, key, value in (
        ("joints.b.torque_range.0", 2, 0.80838928858),
        ("joints.a.peak_power", 3, -163.8391523),
    ):
        slope = found[output, key]
        assert abs(slope.value - value) <= slope.error < 1e-3 * abs(value)


def test_torques_of_more_actuators_than_freedoms() -> None:
    """Torques of least norm follow the pseudo-inverse of a matrix that changes too."""
    to, of = ["robot.links.bar.mass", "robot.joints.rod.a"], ["rms_torque.crank", "rms_torque.slide"]
    agree("schema: 1\ncommand: inverse\n" + LED, to, of, "actuated=[crank, slide]")


def test_torques_and_multipliers_of_least_norm_have_these_slopes() -> None:
    """Random Psi with a dependent row, and more actuators than freedoms, against differences of ``share``."""
    rng = np.random.default_rng(2)
    rows, psi_slope, weights = rng.normal(size=(2, 3, 7)), rng.normal(size=(2, 3, 7)), rng.normal(size=(1, 3))
    u, u_slope, columns = rng.normal(size=(2, 7)), rng.normal(size=(2, 7)), [0, 2, 3, 4, 6]

    def made(s: float) -> tuple[np.ndarray, np.ndarray]:
        psi = rows + s * psi_slope
        return np.concatenate([psi, (weights + s * weights[::-1]) @ psi], axis=1), u + s * u_slope

    psi, load = made(0.0)
    shared = share(psi, columns, {"load": load})
    assert not shared.unique_torques and not shared.unique_multipliers
    psi_change = (made(1e-6)[0] - made(-1e-6)[0]) / 2e-6
    dtau, dlam = share_change(psi, columns, shared, psi_change, u_slope)
    ends = [share(made(s)[0], columns, {"load": made(s)[1]}) for s in (1e-5, -1e-5)]
    np.testing.assert_allclose(dtau, (ends[0].tau - ends[1].tau) / 2e-5, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(dlam, (ends[0].multipliers - ends[1].multipliers) / 2e-5, rtol=1e-6, atol=1e-7)


def test_a_point_that_is_led_moves_the_joints() -> None:
    to = ["robot.joints.theta1.a", "robot.links.link1.mass", "trajectory.radius", "trajectory.center.1"]
    of = ["peak_torque.theta1", "rms_torque.theta2", "joints.theta2.peak_speed", "joints.theta1.energy_net"]
    agree(CONFIGS / "2r_circle.yaml", to, of, "inverse.samples=101")


@pytest.mark.parametrize("command", ["inverse", "kinematics"])
def test_a_frame_that_is_led_turns_the_joints(command: str) -> None:
    """Six hinges anyhow: the attitude's rows follow the rotation of the frame."""
    path = (
        "trajectory: {type: path, point: tool, law: quintic, start: {position: [0.5652, 0.4634, -0.1473], orientation: "
        "{rpy: [2.5403, 0.8394, 2.3394]}}, segments: [{type: line, to: [0.4852, 0.5634, -0.0873], duration: 2, "
        "orientation: {rpy: [2.8403, 0.6394, 2.5894]}}]}\n"
    )
    of = ["joints.a.peak_speed"]
    of += ["rms_torque.b", "joints.f.energy"] if command == "inverse" else ["points.tool.path_length"]
    to = [
        "robot.joints.b.origin.xyz.2",
        "robot.points.tool.at.1",
        "trajectory.segments.0.to.0",
        "trajectory.segments.0.duration",
    ]
    agree(f"schema: 1\ncommand: {command}\n{path}{WRIST}", to, of)


def test_the_peak_of_a_pendulum() -> None:
    """tau = m l^2 q-ddot + m g l sin q along q = A sin(w t), whose peak lies at a sample."""
    text = """
schema: 1
command: inverse
gravity: [9.81, 0, 0]
parameters: {A: 0.4}
robot:
  convention: standard
  joints: [{name: q, type: revolute, a: 1, alpha: 0, d: 0}]
  links: [{name: bob, mass: 2, com: [0.7, 0, 0], com_frame: joint, inertia: {zz: 0.0001}}]
trajectory: {type: joint, duration: 1, q: {q: "A*sin(0.5*pi*t)"}}
inverse: {samples: 201}
"""
    question = asked(
        text, ["parameters.A", "robot.links.bob.mass", "robot.links.bob.com.0"], ["joints.q.torque_range.1"]
    )
    found, _ = exact_slopes(question)
    w, A, m, c, I = 0.5 * math.pi, 0.4, 2.0, 0.7, 0.0001
    truth = [-(I + m * c * c) * w * w + m * 9.81 * c * math.cos(A),
             -c * c * w * w * A + 9.81 * c * math.sin(A), -2 * m * c * w * w * A + m * 9.81 * math.sin(A)]  # fmt: skip
    for k, y in enumerate(truth):
        slope = found["joints.q.torque_range.1", k]
        assert slope.value == pytest.approx(y, rel=1e-9)
        assert abs(slope.value - y) <= slope.error < 1e-3 * abs(y)


def test_drives_follow_their_own_numbers_too() -> None:
    of = ["drives.theta1.margin", "drives.theta1.shaft.peak_torque", "drives.theta1.gear_loss"]
    to = ["robot.links.link2.mass", "gravity.1"]
    agree(CONFIGS / "2r_drives.yaml", to, of, "inverse.samples=201", "expect={}")


def test_data_of_motors_change_with_their_keys() -> None:
    to, of = ["drives.theta1.coupling_inertia"], ["drives.theta1.inertia_ratio.1", "drives.theta1.margin"]
    agree(CONFIGS / "2r_drives.yaml", to, of, "inverse.samples=101", "expect={}", f"{to[0]}=1e-5")


def test_drives_of_mechanisms_feel_what_moves_with_them() -> None:
    drives = "drives={left: {motor: servo2p4_3000, gear: wave40_100, brake: brake9, mass_on: none},\
        right: {motor: servo1p27_3000, gear: wave32_100, brake: brake2, mass_on: none}}"
    of = ["drives.left.margin", "drives.left.limits.brake.use", "drives.right.inertia_ratio.1"]
    to = ["robot.joints.bend_left.a", "robot.links.crank_left.mass"]
    agree(CONFIGS / "mechanisms/five_bar_circle.yaml", to, of, drives, "inverse.samples=101", "expect={}")


def test_scenes_are_read_anew_for_what_changes_drives_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mass leaves motors and gears as they are: the scene is changed to see this, and whether the key is structure."""
    changed, read = AskedSlopes.changed, list[object]()
    monkeypatch.setattr(AskedSlopes, "changed", lambda *x: (read.append(x), changed(*x))[1])
    question = asked(CONFIGS / "2r_drives.yaml", ["robot.links.link2.mass"], ["drives.theta1.margin"])
    assert exact_slopes(question)[0]
    assert len(read) == 2


# -- kinematics ------------------------------------------------------------------------------------------------
def test_the_limits_of_a_crank_rocker() -> None:
    """The transmission angle's extremes, with crank and ground in line, by the law of cosines."""
    to = ["robot.joints.crank.a", "robot.joints.coupler.a"]
    question = asked(CONFIGS / "mechanisms/four_bar_kinematics.yaml", to, ["transmission_angle.smallest_deg"])
    found, _ = exact_slopes(question)
    a, g, b, c = 0.4, 1.0, 1.2, 0.9
    d = g - a
    cosine = (b * b + c * c - d * d) / (2 * b * c)
    outer = -math.degrees(1.0) / math.sqrt(1.0 - cosine**2)
    truth = [outer * d / (b * c), outer * (1.0 / c - cosine / b)]
    for k, y in enumerate(truth):
        assert found["transmission_angle.smallest_deg", k].value == pytest.approx(y, rel=1e-9)


def test_kinematics_of_a_sweep_and_of_prescribed_joints() -> None:
    to = ["kinematics.sweep.rate", "kinematics.sweep.stop", "robot.joints.crank.a", "robot.points.trace.at.1"]
    of = [
        "joints.coupler.peak_speed",
        "singular_ratio.smallest",
        "points.trace.path_length",
        "termination.time",
    ]
    agree(CONFIGS / "mechanisms/four_bar_kinematics.yaml", to, of, "kinematics.samples=61", "expect={}")
    text = LOADED.replace("torques: {crank: 5}", 'prescribed: {crank: "0.2 + w*t + 0.2*t^2"}')
    agree("schema: 1\ncommand: kinematics\n" + text, ["parameters.w", "robot.joints.rod.a"],
          ["joints.rod.peak_acceleration", "joints.slide.largest", "singular_ratio.smallest"], "kinematics.samples=41")  # fmt: skip


def test_times_of_peaks_have_slopes_and_those_of_a_grid_have_none() -> None:
    text = "schema: 1\ncommand: inverse\n" + LED
    key, name, g, step = "gravity.1", "joints.crank.peak_torque_time", -9.81, 1e-3

    def at(value: float) -> Scene:
        return load_scene_text(text, overrides=["actuated=[crank]", f"gravity.1={value!r}"])

    slope = sensitivity(at(g), [key], [name]).summary["sensitivities"][name][key]
    above, below = (
        inverse(at(g + way * step)).summary["joints"]["crank"]["peak_torque_time"] for way in (1, -1)
    )
    assert slope["method"] == "exact"
    assert abs(slope["derivative"] - (above - below) / (2.0 * step)) < slope["error"] + 1e-5
    assert is_time_of_sample("deploy", "criteria.multipliers") and not is_time_of_sample("inverse", name)


# -- statics ---------------------------------------------------------------------------------------------------
KEYS = [
    "robot.links.bar.mass",
    "robot.joints.rod.a",
    "forces.pull.stiffness",
    "robot.joints.crank.a",
    "gravity.1",
]
AT_REST = ["configuration.crank", "configuration.slide", "torques_of_joints.crank", "torques_of_joints.slide",
           "multipliers.pin.x", "reactions.largest.pin.peak_force", "reactions.largest.rod.peak_force"]  # fmt: skip


@pytest.mark.parametrize(
    ("keys", "settings"),
    [
        ([], ["statics.find=balance", "initial.hold=[]"]),
        (["initial.q.crank"], ["statics.find=balance", "torques.crank=5"]),
        ([], ["statics.find=balance", "torques={slide: '-40*(slide-1)'}", "prescribed={crank: '0.2 + 0.1*sin(w*t)'}"]),
        (["initial.q.crank"], ["statics.find=hold", "torques={crank: 5}", "actuated=[crank]"]),
        (["initial.q.crank"], ["statics.find=hold", "actuated=[crank, slide]"]),
    ],
)  # fmt: skip
def test_a_slider_crank_at_rest(keys: list[str], settings: list[str]) -> None:
    agree("schema: 1\ncommand: statics\n" + STILL, [*KEYS, *keys], AT_REST, *settings)


def test_a_hanging_mass_on_a_spring() -> None:
    """k q = m g: a closed form of the balance, whose error is stated."""
    text = """
schema: 1
command: statics
gravity: [0, 0, -9.81]
robot:
  joints: [{name: z, type: prismatic, parent: base, axis: [0, 0, 1], spring: {stiffness: 50, rest: 0.2}}]
  links: [{name: ball, mass: 2.0}]
initial: {q: {z: 0.1}}
statics: {find: balance}
"""
    to = ["robot.links.ball.mass", "robot.joints.z.spring.stiffness", "robot.joints.z.spring.rest"]
    found, _ = exact_slopes(asked(text, to, ["configuration.z"]))
    for k, y in enumerate([-9.81 / 50, 2.0 * 9.81 / 50**2, 1.0]):
        slope = found["configuration.z", k]
        assert abs(slope.value - y) <= slope.error <= 1e-9


def test_what_no_force_decides_has_no_exact_slope() -> None:
    text = "schema: 1\ncommand: statics\n" + SLIDER.replace("gravity: [0, -9.81, 0]", "gravity: [0, 0, 0]")
    question = asked(text, ["robot.joints.rod.a"], ["configuration.slide"], "torques={}", "initial.hold=[]")
    _, why = exact_slopes(question)
    assert "indifferent" in why[0]

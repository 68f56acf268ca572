"""The inverse command: the lecture's numbers, closed forms, what a result holds, what is refused."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.observe.places import place_outputs, quaternions
from robodyn_cli.results.result import Result
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.solve.extremes import integral, positive_integral, root_mean_square
from robodyn_cli.spatial.algebra import rotation_rpy
from robodyn_cli.torques.dynamics import ForwardDynamics, InverseDynamics
from robodyn_cli.torques.program import torque_terms
from robodyn_cli.works.inverse import inverse
from tests.numeric import assert_close, real
from tests.unit.arms import differences

CONFIGS = Path(__file__).parents[2] / "configs"
M, C1, C2, I, G = 12.456, 0.773, 0.583, 1.042, 9.81


def lecture(*overrides: str) -> Result:
    return inverse(load_scene(CONFIGS / "2r_circle.yaml", overrides))


def sums_to_tau(result: Result) -> None:
    terms = [v.data for v in result.group("torque_terms").values()]
    assert_close(sum(terms), result["tau"], 1e-15)


def test_the_lecture() -> None:
    result = lecture()
    tau, joints = result["tau"], result.summary["joints"]
    assert np.round([tau.min(axis=0), tau.max(axis=0)], 3).tolist() == [[71.868, 62.908], [168.285, 71.606]]
    assert round(joints["theta1"]["rms_torque"], 1) == 125.7
    # between two samples: by fifty times as many
    fine = inverse(load_scene(CONFIGS / "2r_circle.yaml", ["inverse.samples=50001"]))
    figures = joints["theta1"]
    peak = int(np.argmax(fine["tau"][:, 0]))
    assert tau[:, 0].max() < figures["peak_torque"] - 1e-5
    assert_close(figures["peak_torque"], fine["tau"][peak, 0], 1e-9)
    assert abs(figures["peak_torque_time"] - fine.time[peak]) < 2e-4
    assert figures["errors"]["peak_torque"] < 1e-9
    assert result.time.tolist() == np.linspace(0, 10, 1001).tolist()
    assert np.all(result["q"][:, 1] < 0.0)
    summary = result.summary
    assert summary["status"] == "ok" and summary["termination"]["time"] == 10.0
    assert summary["inverse_kinematics"] == "analytic" and summary["ik_residual"] < 1e-14
    assert summary["round_trip"] < 1e-13
    assert abs(summary["error_estimate"]["energy_balance"]) < 1e-11
    # the tip returns to where it started, so gravity gives back what it took
    assert abs(sum(j["energy_net"] for j in joints.values())) < 1e-10
    assert result["targets/tip"].shape == result["points/tip"].shape == (1001, 3)
    assert result["skeleton/link1"].shape == (1001, 2, 3)
    assert result.variables["tau"].units == "N m" and result.variables["tau"].names == ("theta1", "theta2")


def test_the_other_branch_needs_more() -> None:
    tau = lecture("trajectory.ik.branch=elbow_down")["tau"]
    assert tau[:, 0].min() > 209.5 and 241.5 < tau[:, 0].max() < 242.5


def test_torques_are_those_of_the_textbook() -> None:
    result = lecture()
    (q1, q2), (w1, w2), (a1, a2) = result["q"].T, result["qd"].T, result["qdd"].T
    m22 = I + M * C2**2
    m12 = m22 + M * C2 * np.cos(q2)
    m11 = I + M * C1**2 + M + m22 + 2 * M * C2 * np.cos(q2)
    s = M * C2 * np.sin(q2)
    second = M * G * C2 * np.cos(q1 + q2)
    expected = {
        "inertia": [m11 * a1 + m12 * a2, m12 * a1 + m22 * a2],
        "coriolis": [-s * (2 * w1 * w2 + w2**2), s * w1**2],
        "gravity": [M * G * (C1 + 1.0) * np.cos(q1) + second, second],
    }
    assert set(result.group("torque_terms")) == set(expected)
    for name, term in expected.items():
        assert_close(result[f"torque_terms/{name}"], np.stack(term, axis=1), 1e-14)
    sums_to_tau(result)
    kinetic = 0.5 * (m11 * w1**2 + 2 * m12 * w1 * w2 + m22 * w2**2)
    potential = M * G * ((C1 + 1.0) * np.sin(q1) + C2 * np.sin(q1 + q2))
    assert_close(result["energy/kinetic"], kinetic, 1e-13)
    assert_close(result["energy/total"], kinetic + potential, 1e-14)


@pytest.mark.parametrize(
    "path",
    [p for p in sorted(CONFIGS.glob("*.yaml")) if "command: inverse" in p.read_text()],
    ids=lambda p: p.stem,
)
def test_shipped_scenes(path: Path) -> None:
    result = inverse(load_scene(path), samples=401)
    assert result.summary["round_trip"] < 1e-12
    assert abs(result.summary["error_estimate"]["energy_balance_relative"]) < 1e-8
    assert len(result.time) == 401
    assert all(len(v.data) == 401 for v in result.variables.values() if v.dims[0] == "time")
    sums_to_tau(result)
    h = result.time[1]
    for path_name in result.group("points"):
        assert np.isfinite(result[f"points/{path_name}"]).all()
    assert_close(differences(result["q"], h), result["qd"][4:-4], 1e-7)
    assert_close(differences(result["qd"], h), result["qdd"][4:-4], 1e-6)


SLIDER = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - name: lift
      type: prismatic
      axis: [0, 0, 1]
      gear_ratio: 20
      rotor_inertia: 1e-3
      spring: {stiffness: 30, rest: 0.1}
      damper: {damping: 4}
      friction: {viscous: 0.5, coulomb: {positive: 2, negative: -3}}
    - {name: swing, type: revolute, axis: [0, 1, 0], friction: {coulomb: 0.2}}
  links:
    - {name: car, mass: 3}
    - {name: arm, mass: 2, com: [0.5, 0, 0], inertia: {yy: 0.1}}
  points: {tool: {link: arm, at: [1, 0, 0]}}
  frames: {hand: {link: arm, at: [1, 0, 0], rpy: [0, 0, 90 deg]}}
trajectory: {type: joint, duration: 4, q: {lift: "0.3*sin(2*t)", swing: "0.5*t"}}
"""


def test_forces_in_the_joints_carry_their_signs() -> None:
    result = inverse(load_scene_text(SLIDER))
    t = result.time
    q, v, a, angle = 0.3 * np.sin(2 * t), 0.6 * np.cos(2 * t), -1.2 * np.sin(2 * t), 0.5 * t
    passive = 30 * (q - 0.1) + 4 * v
    friction = 0.5 * v + np.where(v > 0, 2.0, -3.0)
    assert_close(result["torque_terms/passive"], np.stack([passive, 0 * t], axis=1), 1e-14)
    assert_close(result["torque_terms/friction"], np.stack([friction, 0.2 + 0 * t], axis=1), 1e-14)
    # the arm's mass is at height -0.5 sin(angle) above the car, turning at a constant rate
    force = 5 * (9.81 + a) + 2 * 0.5 * np.sin(angle) * 0.25 + 20**2 * 1e-3 * a
    torque = -2 * 0.5 * np.cos(angle) * (9.81 + a)
    assert_close(result["tau"], np.stack([force + passive + friction, torque + 0.2], axis=1), 1e-14)
    sums_to_tau(result)
    assert result.variables["tau"].units == "N or N m" and result.variables["q"].units == "m or rad"
    assert result.summary["joints"]["lift"]["units"]["torque"] == "N"
    assert result.summary["round_trip"] < 1e-13


@pytest.mark.parametrize("samples", (51, 101, 400))
@pytest.mark.parametrize("upward", (True, False))
def test_dry_friction_from_rest_to_rest_is_that_of_the_motion_beside(upward: bool, samples: int) -> None:
    m, F, T, d = 3.0, 30.0, 1.6, 0.4 if upward else -0.4
    slider = {"name": "lift", "type": "prismatic", "axis": [0, 0, 1], "friction": {"coulomb": F}}
    scene = {
        "schema": 1,
        "gravity": [0, 0, -9.81],
        "robot": {"joints": [slider], "links": [{"name": "car", "mass": m}]},
        "trajectory": {
            "type": "quintic",
            "points": [{"t": 0, "q": {"lift": 0.1}}, {"t": T, "q": {"lift": 0.1 + d}}],
        },
        "inverse": {"samples": samples},
    }
    figures = inverse(load_scene_text(yaml.safe_dump(scene))).summary["joints"]["lift"]
    level, a = m * 9.81 + math.copysign(F, d), m * d / T**2
    expected = {
        "peak_torque": max(abs(level + sign * a * 10.0 / math.sqrt(3.0)) for sign in (1.0, -1.0)),
        "rms_torque": math.sqrt(level**2 + a**2 * 120.0 / 7.0),
    }
    for name, value in expected.items():
        off, stated = abs(figures[name] - value), figures["errors"][name]
        assert off <= stated + 1e-14 * value and stated < 2e-5 * value, (name, off, stated)


def test_places_are_in_the_world() -> None:
    moved = SLIDER.replace("robot:\n", "robot:\n  base: {xyz: [1, 2, 3], rpy: [0, 0, 90 deg]}\n")
    result = inverse(load_scene_text(moved), samples=801)
    t = result.time
    q, angle = 0.3 * np.sin(2 * t), 0.5 * t
    tool = np.stack([1 + 0 * t, 2 + np.cos(angle), 3 + q - np.sin(angle)], axis=1)
    assert_close(result["points/tool"], tool, 1e-15)
    assert_close(result["frames/hand/position"], tool, 1e-15)
    twist = result["frames/hand/twist"]
    assert_close(differences(tool, t[1]), twist[4:-4, 3:], 1e-11)
    assert_close(twist[:, :3], np.tile([-0.5, 0, 0], (801, 1)), 1e-15)
    w, x, y, z = result["frames/hand/quaternion"].T
    # R = Rz(90) Ry(angle) Rz(90)
    for k in range(0, 801, 100):
        R = rotation_rpy([0, 0, np.pi / 2]) @ rotation_rpy([0, angle[k], 0]) @ rotation_rpy([0, 0, np.pi / 2])
        column = [2 * (x * y - w * z)[k], 1 - 2 * (x**2 + z**2)[k], 2 * (y * z + w * x)[k]]
        assert_close(column, real(R)[:, 1], 1e-14, scale=1.0)


def test_quaternions_of_any_rotation() -> None:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(300, 4))
    q[:4] = np.eye(4)  # half turns
    q /= np.linalg.norm(q, axis=1)[:, None]
    w, x, y, z = q.T
    R = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]).transpose(2, 0, 1)  # fmt: skip
    found = quaternions(R)
    assert_close(np.abs(np.einsum("ti,ti->t", found, q)), np.ones(300), 1e-14)
    assert found[0, 0] > 0.0
    assert np.all(np.einsum("ti,ti->t", found[1:], found[:-1]) >= 0.0)


def test_only_terms_that_the_scene_has() -> None:
    weightless = lecture("gravity=[0, 0, 0]")
    assert set(weightless.group("torque_terms")) == {"inertia", "coriolis"}
    # gravity across the plane of the arm loads no joint
    across = lecture("gravity=[0, 0, -9.81]")
    assert set(across.group("torque_terms")) == {"inertia", "coriolis"}
    assert_close(across["tau"], weightless["tau"], 1e-15)


def test_missing_inertia_is_named_where_it_counts() -> None:
    twisted = load_scene(
        CONFIGS / "2r_circle.yaml",
        [
            'trajectory={type: joint, duration: 1, q: {theta1: "t", theta2: "t"}}',
            "robot.joints.theta1.alpha=90 deg",
        ],
    )
    with pytest.raises(SceneError, match=r"inertia\.(xx|yy) of link2"):
        inverse(twisted)


def test_what_cannot_be_done_says_so() -> None:
    with pytest.raises(SceneError, match="'trajectory' is missing"):
        inverse(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    with pytest.raises(CapabilityError, match="closed loops"):
        InverseDynamics(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    with pytest.raises(SceneError, match="'trajectory' is missing"):
        inverse(load_scene(CONFIGS / "double_pendulum.yaml"))
    with pytest.raises(CapabilityError, match="lacks 'theta2'"):
        lecture("actuated=[theta1]")
    with pytest.raises(SceneError, match="'theta1', which carries 'tip', is prescribed"):
        lecture("prescribed={theta1: t}")
    with pytest.raises(CapabilityError, match="'prescribed'"):
        InverseDynamics(load_scene(CONFIGS / "2r_circle.yaml", ["prescribed={theta1: t}"]))


@pytest.mark.parametrize(
    ("reference", "path"), [("link2.end", "points/link2.end"), ("link2.com", "points/link2.com")]
)
def test_points_of_links_can_be_led(reference: str, path: str) -> None:
    result = lecture(f"trajectory.point={reference}", "trajectory.center=[0.9, 0.9]")
    assert result.summary["ik_residual"] < 1e-14
    assert_close(result[path], result["targets/" + reference], 1e-14)
    assert "points/tip" in result


def test_newton_in_the_command() -> None:
    by_newton = lecture("trajectory.ik.method=newton")
    assert by_newton.summary["inverse_kinematics"] == "newton"
    assert 0 < by_newton.summary["counters"]["ik_steps"] < 1000  # samples between those are solved at once
    assert_close(by_newton["tau"], lecture()["tau"], 1e-12)


# -- arrays -------------------------------------------------------------------------------------------------
def test_dynamics_on_arrays() -> None:
    scene = load_scene(CONFIGS / "seven_joint_arm.yaml")
    result = inverse(scene, samples=203)
    q, qd, qdd, tau = (result[x] for x in ("q", "qd", "qdd", "tau"))
    model = build_model(scene)
    for source in (scene, model, Problem(scene)):
        for order in ("C", "F"):
            arrays = [np.array(x, order=order) for x in (q, qd, qdd)]
            assert_close(InverseDynamics(source)(*arrays), tau, 1e-13)
    assert_close(ForwardDynamics(scene)(q, qd, tau), qdd, 1e-12)
    one = InverseDynamics(scene)(q[:1], qd[:1], qdd[:1])
    assert one.shape == (1, 7)
    assert_close(one, tau[:1], 1e-13)


def test_compiled_and_interpreted_agree() -> None:
    problem = Problem(load_scene_text(SLIDER))
    outputs: dict[str, Any] = {**torque_terms(problem), **place_outputs(problem), "fixed": [1.5, -2.0]}
    rng = np.random.default_rng(0)
    groups = {g: rng.normal(size=(5000, 2)) for g in ("q", "v", "a")}
    interpreted, compiled = (SampleFunction(outputs, MOTION_GROUPS, n) for n in (100, 10**9))
    assert not interpreted.compiled and compiled.compiled
    one, two = interpreted(**groups), compiled(**groups)
    assert one.keys() == two.keys() == outputs.keys()
    for name in outputs:
        assert_close(one[name], two[name], 1e-14)


# -- integrals ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("samples", [2, 3, 5, 6, 7, 30])
def test_quadrature_is_exact_for_polynomials(samples: int) -> None:
    t = np.linspace(0.0, 2.0, samples)
    p = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.3, -0.4, 0.2][: min(samples, 6)])
    exact = p.integ()(2.0)
    y = p(t)[:, None] * [1.0, -3.0]
    assert_close(integral(t, y)[0], [exact, -3.0 * exact], 1e-13)
    assert_close(positive_integral(t, y)[0] - positive_integral(t, -y)[0], [exact, -3.0 * exact], 1e-13)


def test_quadrature_of_a_wave() -> None:
    t = np.linspace(0.0, 10.0, 1001)
    y = np.sin(2 * t + 0.3)[:, None]
    exact = (np.cos(0.3) - np.cos(20.3)) / 2
    assert abs(integral(t, y)[0][0] - exact) < 1e-13
    roots = (np.arange(1, 7) * np.pi - 0.3) / 2  # up to 10 s
    edges = [0.0, *roots[roots < 10], 10.0]
    parts = [(np.cos(2 * a + 0.3) - np.cos(2 * b + 0.3)) / 2 for a, b in itertools.pairwise(edges)]
    assert abs(positive_integral(t, y)[0][0] - sum(x for x in parts if x > 0)) < 1e-12
    (rms,), _ = root_mean_square(t, y)
    assert abs(rms**2 - (0.5 - (np.sin(40.6) - np.sin(0.6)) / 80)) < 1e-12
    uneven = np.concatenate([t, t[:-1] + 0.003])
    uneven.sort()
    (value,), (error,) = root_mean_square(uneven, np.sin(2 * uneven + 0.3)[:, None])
    assert abs(value - rms) < min(1e-4, error)
    zero = np.zeros((9, 1))
    few = np.linspace(0.0, 0.8, 9)
    assert positive_integral(few, zero)[0][0] == positive_integral(few, zero - 1.0)[0][0] == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_quadrature_of_functions_that_jump(seed: int) -> None:
    """Waves with other coefficients between jumps, at random times and at samples: sums of the pieces' integrals."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 3.0, 481)
    h = t[1]
    places = np.sort(
        rng.choice(np.arange(8, 472, 8), size=3, replace=False) + rng.choice([0.0, rng.uniform(0, 0.99)], 3)
    )
    edges = [0.0, *(h * places), 3.0]
    # 100 stretches of 20 nodes: as many nodes in one stretch are the eigenvalues of a matrix of that size
    nodes, parts = np.polynomial.legendre.leggauss(20)
    x, whole = (
        ((2.0 * np.arange(100)[:, None] + 1.0 + nodes) / 100.0 - 1.0).ravel(),
        np.tile(parts / 100.0, 100),
    )
    waves = [(rng.normal(), rng.uniform(1, 4), rng.uniform(0, 6), 0.4 * rng.normal()) for _ in range(4)]
    y, exact, positive, square = np.empty(481), 0.0, 0.0, 0.0
    for (A, w, phase, c), (a, b) in zip(waves, itertools.pairwise(edges)):
        inside = (t > a) & (t <= b) if a > 0.0 else t <= b  # a sample at a jump is that of before
        y[inside] = A * np.sin(w * t[inside] + phase) + c
        fine = A * np.sin(w * (a + (b - a) * (x + 1) / 2) + phase) + c
        weights = whole * (b - a) / 2
        exact += weights @ fine
        positive += weights @ np.maximum(fine, 0.0)
        square += weights @ fine**2
    column = y[:, None] * [1.0, -1.0]
    assert_close(integral(t, column, places)[0], [exact, -exact], 1e-8)
    assert_close(
        positive_integral(t, column, places)[0], [positive, positive - exact], 1e-6
    )  # Gauss knows no kinks
    assert_close(root_mean_square(t, column, places)[0] ** 2 * 3.0, [square, square], 1e-8)
    thin = integral(t[::2], column[::2], 0.5 * places)[0]
    assert_close(thin, [exact, -exact], 1e-5)
    # without the jumps it is off by their size times a part of a step
    assert abs(integral(t, column)[0][0] - exact) > 1e-5

"""Mechanisms with loops led by the attitude of a spherical or floating joint: a Stewart platform by its platform."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.spatial import quaternion
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate
from robodyn_cli.works.statics import statics
from tests.numeric import assert_close
from tests.source import ROOT
from tests.unit.arms import differences

STEWART = ROOT / "configs/benchmarks/stewart_platform.yaml"
PLACE = ('"0.03*sin(2*t)"', '"0.02*(1 - cos(3*t))"', '"0.6 + 0.04*sin(t)"')
TURN = ('"0.1*sin(2*t)"', '"0.15*(1 - cos(t))"', '"0.2*sin(1.5*t)"')
ALIKE = "[x, x, x, x, x, x]"
SLIDES = ", ".join(f"slide{k}" for k in range(1, 7))
COMMON = (f"actuated=[{SLIDES}]", "torques={}", "parameters={}")
WAYS = {
    "formulas": f"{{type: joint, duration: 2, q: {{top: {{xyz: [{', '.join(PLACE)}], rpy: [{', '.join(TURN)}]}}}}}}",
    "way points": "{type: quintic, points: [{t: 0, q: {top: {xyz: [0, 0, 0.6], rpy: [0, 0, 0]}}},"
    " {t: 1, q: {top: {xyz: [0.05, 0.03, 0.64], rpy: [0.1, -0.2, 0.3]}}},"
    " {t: 2, q: {top: {xyz: [0, 0.05, 0.6], rpy: [0.2, 0.1, 0]}}}]}",
    "stops": "{type: s_curve, points: [{q: {top: {xyz: [0, 0, 0.6], rpy: [0, 0, 0]}}}, "
    "{q: {top: {xyz: [0.05, 0.03, 0.64], rpy: [0.1, -0.2, 0.3]}}, duration: 2}], "
    f"acceleration: {{top: {ALIKE.replace('x', '2')}}}, jerk: {{top: {ALIKE.replace('x', '20')}}}}}",
    "frame": f"{{type: cartesian, point: platform.origin, duration: 2, position: [{', '.join(PLACE)}], "
    f"orientation: {{rpy: [{', '.join(TURN)}]}}}}",
    "relative": f"{{type: cartesian, point: platform.origin, relative_to: shaken, duration: 2, "
    f"position: [{', '.join(PLACE)}], orientation: {{rpy: [{', '.join(TURN)}]}}}}",
}  # fmt: skip
SHAKEN = 'robot.points.shaken={link: base, at: [0, 0, 0], motion: ["0.02*sin(t)", 0, "0.01*t^2"]}'


def legs(result: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Lengths (T, 6) of the legs from the platform's pose, by the distances of their ends."""
    scene = load_scene(STEWART)
    feet = np.array([joint.origin.xyz for joint in scene.robot.joints if joint.name.startswith("cross")])
    balls = np.array([scene.robot.points[f"ball{k}"].at for k in range(1, 7)])
    columns = [names.index(f"top.{x}") for x in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    found = []
    for row in result[:, columns]:
        R = np.array(quaternion.rotation(row[3:]), dtype=float)
        found.append(np.linalg.norm(row[:3] + balls @ R.T - feet, axis=1))
    return np.array(found)


@pytest.mark.parametrize("way", WAYS)
def test_a_platform_leads_its_legs(way: str) -> None:
    rough = way in (
        "stops",
        "way points",
    )  # not smooth enough for differences, and as long as their points say
    samples = "inverse.samples=101" if rough else "inverse.samples=51"
    settings = [*COMMON, SHAKEN, f"trajectory={WAYS[way]}", samples, "command=inverse"]
    result = inverse(load_scene(STEWART, settings if rough else [*settings, "trajectory.duration=1"]))
    names = result.variables["q"].names
    slides = [names.index(f"slide{k}") for k in range(1, 7)]
    assert_close(result["q"][:, slides], legs(result["q"], names), 1e-12)
    h, rates = result.time[1] - result.time[0], result.variables["qd"].names
    single = [name for name in rates if name in names]
    q, qd = [names.index(x) for x in single], [rates.index(x) for x in single]
    if not rough:
        assert_close(differences(result["q"][:, q], h), result["qd"][4:-4, qd], 1e-8)
        assert_close(differences(result["qd"], h), result["qdd"][4:-4], 1e-6)
    # the same motion, led by the legs: the platform follows, with the same forces
    columns = ", ".join(["t", *(f"slide{k}" for k in range(1, 7))])
    rows = np.column_stack([result.time, result["q"][:, slides]]).tolist()
    by_legs = inverse(
        load_scene(STEWART, [*COMMON, f"trajectory={{type: table, columns: [{columns}], rows: {rows}}}",
                             samples])
    )  # fmt: skip
    assert_close(by_legs["q"], result["q"], 1e-7)
    inside, scale = slice(5, -5), np.abs(result["tau"]).max()
    assert_close(by_legs["tau"][inside] / scale, result["tau"][inside] / scale, 2e-4)


def test_a_simulation_and_the_kinematics_follow_the_platform() -> None:
    led = [*COMMON, f"trajectory={WAYS['formulas']}"]
    found = inverse(load_scene(STEWART, [*led, "inverse.samples=101"]))
    moved = kinematics(load_scene(STEWART, [*led, "kinematics.samples=101"]))
    assert_close(moved["q"], found["q"], 1e-12)
    run = simulate(
        load_scene(STEWART, [*led, "prescribed=trajectory", "simulate={duration: 1, samples: 51}"])
    )
    assert_close(run["q"], found["q"][:51], 1e-10)


# a rod on a ball joint carries a hinged arm: it stays turned while the arm moves or finds its balance
BALL = """schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: ball, type: spherical}
    - {name: hinge, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.4, 0, 0]}, spring: {stiffness: 30, rest: 0.3}}
  links:
    - {name: rod, mass: 2, com: [0.2, 0.02, 0], inertia: {xx: 0.01, yy: 0.03, zz: 0.04, xy: 0.002}}
    - {name: arm, mass: 1, com: [0.3, 0, 0.01], inertia: {xx: 0.01, yy: 0.02, zz: 0.02}}
initial: {q: {ball: {rpy: [0.2, 0.1, -0.4]}, hinge: 0.1}, hold: [ball]}
kinematics: {sweep: {joint: hinge, start: 0.1, stop: 1.1}, samples: 11}
"""


def test_a_ball_joint_is_held() -> None:
    scene = load_scene_text(BALL)
    ball = [scene.initial.q[f"ball.{x}"] for x in ("qw", "qx", "qy", "qz")]
    swept = kinematics(scene)
    assert_close(swept["q"][:, :4], np.tile(ball, (11, 1)), 1e-15)
    assert_close(swept["q"][:, 4], np.linspace(0.1, 1.1, 11), 1e-14)
    found = statics(scene)
    q = found["q"].ravel()
    assert_close(q[:4], ball, 1e-14)
    # by hand: the spring's torque is that of the weight about the hinge
    R = np.array(quaternion.rotation(np.array(ball)), dtype=float)
    c, s = np.cos(q[4]), np.sin(q[4])
    lever = R @ np.array([0.3 * c, 0.3 * s, 0.01])
    moment = np.cross(lever, [0.0, -9.81, 0.0]) @ R[:, 2]
    assert abs(moment - 30.0 * (q[4] - 0.3)) < 1e-9

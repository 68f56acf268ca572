"""Simulations whose prescribed joints follow the path of a point or a frame, or a path in the least time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robodyn_cli import load_scene_text
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, RobodynError, SceneError
from robodyn_cli.scene.types import Scene
from robodyn_cli.torques.dynamics import InverseDynamics
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate

# full inertias, offset centres of mass, a base that is tilted, and a load that swings below the hand
ARM = """
schema: 1
gravity: [0.3, -9.4, 1.1]
robot:
  joints:
    - {name: waist, type: revolute, axis: [0, 0, 1]}
    - {name: shoulder, type: revolute, axis: [0, 1, 0], origin: {xyz: [0, 0.05, 0.4]}}
    - {name: elbow, type: revolute, axis: [0, 1, 0], origin: {xyz: [0.5, -0.02, 0]}}
    - {name: swing, type: revolute, axis: [1, 2, 0.5], origin: {xyz: [0.4, 0, 0]}}
  links:
    - {name: post, mass: 3, com: [0.02, 0.01, 0.2], inertia: {xx: 0.05, yy: 0.06, zz: 0.03, xy: 0.002, xz: 0.003, yz: -0.001}}
    - {name: upper, mass: 2, com: [0.2, 0.03, 0.01], inertia: {xx: 0.01, yy: 0.05, zz: 0.045, xy: 0.001, xz: -0.002, yz: 0.001}}
    - {name: lower, mass: 1.5, com: [0.18, -0.02, 0.01], inertia: {xx: 0.008, yy: 0.03, zz: 0.028, xy: 0.001, xz: 0.001, yz: 0.0}}
    - {name: load, mass: 0.7, com: [0.05, 0.04, -0.2], inertia: {xx: 0.004, yy: 0.005, zz: 0.002, xy: 0.0, xz: 0.0003, yz: 0.0}}
  points:
    hand: {link: lower, at: [0.4, 0, 0]}
"""
JOINTS = "waist: 0.2, shoulder: 0.3, elbow: 0.8"
CIRCLE = (
    "type: circle, point: hand, center: [0.65, 0.1, 0.2], normal: [0.3, -0.2, 1], radius: 0.12, duration: 1.5"
)


def scene_of(trajectory: str, initial: str, duration: float = 1.5, rest: str = "") -> Scene:
    return load_scene_text(
        f"{ARM}trajectory: {{{trajectory}}}\nprescribed: trajectory\ninitial: {{{initial}}}\n"
        f"simulate: {{duration: {duration}, samples: 61}}\n{rest}",
        "arm.yaml",
    )


def test_a_point_stays_on_its_path_while_another_joint_swings() -> None:
    scene = scene_of(CIRCLE, f"q: {{{JOINTS}, swing: 0.4}}, qd: {{swing: -1}}")
    found = simulate(scene)
    assert found.status == "ok"
    asked = scene.trajectory.target(found["time"].ravel(), {})
    assert found["points/hand"] == pytest.approx(asked.p, abs=1e-9)
    # the joint that nobody leads needs no torque, the others those of inverse dynamics
    bare = dataclasses.replace(scene, prescribed={}, trajectory=None)
    tau = InverseDynamics(bare)(found["q"], found["qd"], found["qdd"])
    assert np.abs(tau[:, 3]).max() < 1e-9
    assert np.ptp(found["q"][:, 3]) > 0.3
    # energy: work of the led joints is all that comes in
    assert found.summary["energy_drift_relative"] < 1e-9


def test_the_hand_of_the_simulation_is_that_of_kinematics() -> None:
    led = "type: path, point: hand, start: {position: [0.6, 0.15, 0.2]}, law: trapezoid, speed: 0.5, acceleration: 2, "
    led += "segments: [{type: line, to: [0.7, -0.1, 0.25]}, {type: line, to: [0.6, -0.2, 0.1], dwell: 0.1}]"
    scene = scene_of(led, f"q: {{{JOINTS}, swing: 0.0}}", 1.0)
    found = simulate(scene)
    asked = scene.trajectory.target(found["time"].ravel(), {})
    assert found["points/hand"] == pytest.approx(asked.p, abs=1e-9)
    # kinematics follows the path itself, of all joints
    whole = kinematics(scene)
    at_end = dict(zip(whole.variables["q"].names, whole["q"][-1]))
    assert at_end["swing"] == 0.0


@pytest.mark.parametrize(
    "path",
    [
        "points: [{q: {waist: 0, shoulder: 0.3, elbow: 0.8, swing: 0}}, {q: {waist: 0.6, shoulder: 0.1, elbow: 1.1, swing: 0.3}}]",
        f"path: {{{CIRCLE}}}",
    ],
)
def test_a_path_in_the_least_time_keeps_to_its_limits(path: str) -> None:
    effort = {"waist": 20.0, "shoulder": 60.0, "elbow": 25.0, "swing": 12.0}
    limits = f"effort: {effort}".replace("'", "")
    led = f"type: fastest, {path}, {limits}, intervals: 60"
    scene = scene_of(led, f"q: {{{JOINTS}, swing: 0.0}}", 0.2)
    found = simulate(scene)
    bare = dataclasses.replace(scene, prescribed={}, trajectory=None)
    tau = InverseDynamics(bare)(found["q"], found["qd"], found["qdd"])
    use = np.abs(tau) / np.array(list(effort.values()))
    assert use.max() <= 1.0 + 1e-5
    assert np.mean(use.max(axis=1) > 0.9) > 0.8


def test_a_path_with_a_corner_in_the_joints_is_refused() -> None:
    corner = "type: cartesian, point: hand, position: [0.6 + 0.1*abs(t - 0.5), 0.1 - 0.1*t, 0.2], duration: 1"
    with pytest.raises(RobodynError, match=r"not smooth at t = 0\.5"):
        simulate(scene_of(corner, f"q: {{{JOINTS}, swing: 0.0}}", 1.0))


def test_commands_without_time_say_what_can_follow_a_path() -> None:
    with pytest.raises(CapabilityError, match="allowed: simulate, deploy, inverse, kinematics"):
        _ = Problem(scene_of(CIRCLE, f"q: {{{JOINTS}, swing: 0.0}}")).psi


def test_loops_follow_tables_only() -> None:
    coupler = "couplers: [{name: belt, terms: {waist: 1, swing: -1}}]\n"
    with pytest.raises(SceneError, match="follow the result of `inverse` or `kinematics` as a table"):
        scene_of(CIRCLE, f"q: {{{JOINTS}, swing: 0.0}}", rest=coupler)

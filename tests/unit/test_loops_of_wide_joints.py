"""Closed loops of mechanisms with universal, spherical and floating joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.ready.prepare import passive_coordinates, prepare
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.works.deploy.deploy import deploy
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate

CONFIGS = Path(__file__).parents[2] / "configs"
LINK = "mass: 1.5, com: [0.2, 0.05, -0.1], inertia: {xx: 0.02, yy: 0.05, zz: 0.06, xy: 0.004, xz: -0.003, yz: 0.002}"

BODY = """
schema: 1
gravity: [1, -2, -9.81]
robot:
  joints: [{{name: j, {joint}}}]
  links: [{{name: body, {link}}}]
  points: {{tip: {{link: body, at: [0.4, 0.1, 0.2]}}, foot: {{link: base, at: [0.1, 0.2, 0.3]}}}}
{loops}
initial: {{q: {{j: {q}}}, qd: {{j: {v}}}}}
simulate: {{duration: 1, samples: 51, rtol: 1e-11, error_estimate: false}}
"""
PLACE = "origin: {xyz: [0.1, 0.2, 0.3]}"
# kind of joint, its state, the loop that makes it of a floating one, and the floating joint's state
HELD = {
    "spherical": (
        "type: spherical", "{rotation_vector: [0.2, 0.3, 0.4]}", "[1, -2, 0.5]",
        "type: spherical", "rotation_vector: [0.2, 0.3, 0.4]", "[0, 0, 0, 1, -2, 0.5]",
    ),
    "universal": (
        "type: universal, axis: [0, 0, 1], axis2: [1, 0, 0]", "[0, 0]", "[1, 2]",
        "type: universal, axis: [0, 0, 1], axis2: [1, 0, 0]", "rpy: [0, 0, 0]", "[0, 0, 0, 2, 0, 1]",
    ),
    "cylindrical": (
        "type: cylindrical, axis: [0, 0, 1]", "[0, 0.2]", "[3, 0.5]",
        "type: cylindrical, axis: [0, 0, 1]", "rpy: [0, 0, 0]", "[0, 0, 0.5, 0, 0, 3]",
    ),
    "planar": (
        "type: planar, axis: [0, 0, 1], axis2: [1, 0, 0]", "[0, 0, 0]", "[1, 0.5, 3]",
        "type: planar, axis: [0, 0, 1]", "rpy: [0, 0, 0]", "[1, 0.5, 0, 0, 0, 3]",
    ),
    "revolute": (
        "type: revolute, axis: [0, 0, 1]", "0", "3",
        "type: revolute, axis: [0, 0, 1]", "rpy: [0, 0, 0]", "[0, 0, 0, 0, 0, 3]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", HELD)
def test_a_floating_body_held_by_a_loop_moves_as_on_that_joint(kind: str) -> None:
    joint, q, v, loop, attitude, rates = HELD[kind]
    shift = 0.2 if kind == "cylindrical" else 0.0
    tree = BODY.format(joint=f"{joint}, {PLACE}", link=LINK, loops="", q=q, v=v)
    loops = f"loops: [{{name: held, {loop}, between: [foot, body.origin]}}]"
    free = f"{{xyz: [0.1, 0.2, {0.3 + shift}], {attitude}}}"
    closed = BODY.format(joint="type: floating", link=LINK, loops=loops, q=free, v=rates)
    one, other = simulate(load_scene_text(tree)), simulate(load_scene_text(closed))
    np.testing.assert_allclose(other["points/tip"], one["points/tip"], atol=2e-9)
    np.testing.assert_allclose(np.ptp(other["energy/total"]), 0.0, atol=1e-8)
    assert other.summary["constraint_residual"]["position"] < 1e-14
    assert np.abs(np.linalg.norm(other["q"][:, 3:], axis=1) - 1.0).max() < 1e-14


RSSR = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {{name: crank, type: revolute, axis: [0, 0, 1]}}
{ball}
    - {{name: rocker, type: revolute, parent: base, link: rocker, origin: {{xyz: [1.0, 0.4, 0]}}, axis: [1, 0, 0]}}
  links:
    - {{name: crank, mass: 1, com: [0.1, 0, 0], inertia: {{xx: 0.001, yy: 0.01, zz: 0.01}}}}
    - {{name: coupler, mass: 0.7, com: [0.4, 0.02, 0], inertia: {{xx: 0.002, yy: 0.03, zz: 0.04, xy: 0.001}}}}
    - {{name: rocker, mass: 1.2, com: [0, 0.02, 0.3], inertia: {{xx: 0.05, yy: 0.05, zz: 0.002}}}}
{massless}
  points: {{pin: {{link: rocker, at: [0, 0, 0.6]}}, eye: {{link: coupler, at: [1.1, 0, 0]}}}}
loops: [{{name: ball2, type: spherical, between: [eye, pin]}}]
initial: {{q: {{crank: 0.3{more}}}, hold: [crank]}}
torques: {{crank: 0.5}}
simulate: {{duration: 1.5, samples: 31, error_estimate: false}}
"""
PIN = "origin: {xyz: [0.3, 0, 0]}"
BALL = f"    - {{name: ball, type: spherical, parent: crank, link: coupler, {PIN}}}"
TURNS = f"""    - {{name: z, type: revolute, parent: crank, link: m1, {PIN}, axis: [0, 0, 1]}}
    - {{name: y, type: revolute, parent: m1, link: m2, axis: [0, 1, 0]}}
    - {{name: x, type: revolute, parent: m2, link: coupler, axis: [1, 0, 0]}}"""
MASSLESS = "    - {name: m1, mass: 0}\n    - {name: m2, mass: 0}"


def test_spatial_four_bar_with_balls_is_that_with_three_turns_each() -> None:
    """The coupler may spin about its own line: a further freedom, and the start closes from no value of the ball."""
    one = load_scene_text(RSSR.format(ball=BALL, massless="", more=""))
    setup = prepare(one)
    q = dict(zip(setup.problem.model.q_names, setup.assembled.q.tolist()))
    assert setup.assembled.position_residual < 1e-14
    w, x, y, z = (q[f"ball.q{c}"] for c in "wxyz")
    assert np.hypot(np.hypot(w, x), np.hypot(y, z)) == pytest.approx(1.0, abs=1e-15)
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    pitch = np.arcsin(2 * (w * y - z * x))
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    ball = f", ball: [{w!r}, {x!r}, {y!r}, {z!r}], rocker: {q['rocker']!r}"
    turns = f", z: {float(yaw)!r}, y: {float(pitch)!r}, x: {float(roll)!r}, rocker: {q['rocker']!r}"
    first = simulate(load_scene_text(RSSR.format(ball=BALL, massless="", more=ball)))
    second = simulate(load_scene_text(RSSR.format(ball=TURNS, massless=MASSLESS, more=turns)))
    for path in ("points/eye", "energy/total", "energy/work"):
        np.testing.assert_allclose(first[path], second[path], atol=1e-8)
    np.testing.assert_allclose(first["q"][:, 0], second["q"][:, 0], atol=1e-8)
    assert first.summary["energy_drift"] < 1e-9
    assert first.summary["constraint_residual"]["position"] < 1e-14


def test_stewart_platform_closes_from_a_rough_start() -> None:
    path = CONFIGS / "benchmarks" / "stewart_platform.yaml"
    setup = prepare(load_scene(path))
    model = setup.problem.model
    assert (model.nq, model.nv, len(setup.problem.constraints.rows)) == (25, 24, 18)
    assert setup.assembled.position_residual < 1e-14 and not setup.assembled.redundant
    assert len(passive_coordinates(setup.problem)) == 18
    rough = ["initial.q.top={xyz: [0.05, 0, 0.5], rpy: [5 deg, -10 deg, 8 deg]}", "initial.hold=[top]"]
    moved = prepare(load_scene(path, rough))
    assert moved.assembled.position_residual < 1e-13
    np.testing.assert_allclose(moved.assembled.q[:3], [0.05, 0.0, 0.5], atol=1e-15)
    lengths = moved.assembled.q[[model.q_names.index(f"slide{k}") for k in range(1, 7)]]
    held = moved.problem.model.points
    q = moved.assembled.q[3:7]
    from robodyn_cli.spatial import quaternion

    R = np.array(quaternion.rotation(q), dtype=float)
    scene = load_scene(path)
    for k, length in enumerate(lengths, start=1):
        joint = next(j for j in scene.robot.joints if j.name == f"cross{k}")
        assert joint.origin is not None
        ball = np.array([0.05, 0.0, 0.5]) + R @ np.array(held[f"ball{k}"].p, dtype=float)
        assert abs(length) == pytest.approx(np.linalg.norm(ball - joint.origin.xyz), abs=1e-12)


FOUR_BAR = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {{name: theta1, type: revolute, parent: base, link: crank, axis: [0, 0, 1]}}
    - {{name: phi2, {middle}, parent: crank, link: coupler, origin: {{xyz: [1, 0, 0]}}, axis: [0, 0, 1]}}
    - {{name: phi1, {last}, parent: base, link: follower, origin: {{xyz: [2.5, 0, 0]}}, axis: [0, 0, 1]}}
  links:
    - {{name: crank, mass: 1, com: [0.5, 0, 0], inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}}}
    - {{name: coupler, mass: 1.6, com: [0.8, 0, 0], inertia: {{xx: 0.2, yy: 0.2, zz: 0.4}}}}
    - {{name: follower, mass: 1.6, com: [0.8, 0, 0], inertia: {{xx: 0.2, yy: 0.2, zz: 0.4}}}}
  points: {{pin2: {{link: coupler, at: [1.6, 0, 0]}}, pin1: {{link: follower, at: [1.6, 0, 0]}}}}
loops: [{{name: pin, type: revolute, between: [pin2, pin1]}}]
initial: {{q: {{theta1: 0.4, phi2: 0.5, phi1: {start}}}, hold: [theta1]}}
torques: {{theta1: 2 - 0.1*theta1}}
simulate: {{duration: 10, samples: 201}}
"""


def test_deployment_with_other_joints_in_the_place_of_pins() -> None:
    """A screw without lead is a pin, and a sliding pin whose loop keeps it in its plane does not slide."""
    pin = deploy(load_scene_text(FOUR_BAR.format(middle="type: revolute", last="type: revolute", start="2")))
    other = deploy(
        load_scene_text(
            FOUR_BAR.format(middle="type: helical, pitch: 0", last="type: cylindrical", start="[2, 0]")
        )
    )
    one, two = pin.summary["lock"], other.summary["lock"]
    assert one["kind"] == two["kind"] == "dead_point"
    assert two["time"] == pytest.approx(one["time"], abs=1e-8)
    assert two["angles"]["phi1.theta"] == pytest.approx(one["angles"]["phi1"], abs=1e-8)
    assert two["angles"]["phi1.d"] == pytest.approx(0.0, abs=1e-12) and "phi1.d" not in two["angles_deg"]


def test_inverse_dynamics_of_a_loop_with_a_ball() -> None:
    text = RSSR.format(ball=f"    - {{name: cross, type: universal, parent: crank, link: coupler, {PIN}, "
                       "axis: [0, 0, 1], axis2: [0, 1, 0]}", massless="", more="")  # fmt: skip
    text += "trajectory: {type: joint, duration: 2, q: {crank: 0.3 + 0.2*sin(2*t)}}\n"
    lead = inverse(load_scene_text(text.replace(", hold: [crank]", "")))
    ball = lead["points/eye"]
    assert np.abs(ball - lead["points/pin"]).max() < 1e-12
    power = (lead["tau"] * lead["qd"]).sum(axis=1)
    energy = lead["energy/total"]
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(lead.time))])
    np.testing.assert_allclose(energy - energy[0], work, atol=5e-6 * np.ptp(energy) + 1e-9)

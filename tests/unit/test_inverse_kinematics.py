"""Inverse kinematics: closed form and Newton, wherever the arm stands, and what cannot be followed."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from robodyn_cli.algorithms.kinematics import point_jacobian, poses, transforms
from robodyn_cli.errors import CapabilityError, GeometryError, SceneError, SingularConfigurationError
from robodyn_cli.model.model import FixedFrame
from robodyn_cli.spatial.algebra import identity, rotation_rpy, zeros
from robodyn_cli.trajectories.circle import CircleTrajectory
from tests.numeric import assert_close, real
from tests.unit.arms import SEVEN, SEVEN_GUESS, STANDARD_2R, differences, follow, forward, miss

TIMES = np.linspace(0.0, 10.0, 1001)
CIRCLE = "{type: circle, point: tip, center: [0.9, 0.7], radius: 0.25, duration: 10, ik: {%s}}"
# the closed form, and Newton's method, on the same branch
BOTH = ("branch: elbow_up", "method: newton, branch: elbow_up")
each_ik = pytest.mark.parametrize("ik", BOTH)


def cartesian(position: str, ik: str, point: str = "tip", duration: float = 1.0) -> str:
    return f"{{type: cartesian, point: {point}, position: {position}, duration: {duration}, ik: {{{ik}}}}}"


def check_rates(motion, times, tolerance=1e-9):
    """Check qd and qdd against differences of q and qd; accelerations on the scale of the rates at least."""
    h = times[1] - times[0]
    assert_close(differences(motion.q, h), motion.qd[4:-4], tolerance)
    assert_close(
        differences(motion.qd, h), motion.qdd[4:-4], tolerance, scale=max(np.abs(motion.qdd).max(), 1e-3)
    )


# -- planar 2R in closed form -------------------------------------------------------------------------------
@pytest.mark.parametrize(("branch", "sign"), [("elbow_up", -1.0), ("elbow_down", 1.0)])
def test_both_branches_are_the_textbook_solution(branch: str, sign: float) -> None:
    found, model, s = follow(STANDARD_2R, CIRCLE % f"branch: {branch}", TIMES)
    x, y = s.trajectory.target(TIMES, {}).p.T
    q2 = sign * np.arccos((x**2 + y**2 - 1.0 - 0.64) / 1.6)
    q1 = np.arctan2(y, x) - np.arctan2(0.8 * np.sin(q2), 1.0 + 0.8 * np.cos(q2))
    assert found.method == "analytic"
    assert_close(found.motion.q, np.stack([q1, q2], axis=1), 1e-14)
    assert miss(found, model, s, TIMES) < 1e-15
    check_rates(found.motion, TIMES)


def test_both_conventions_are_the_same_arm() -> None:
    modified = """\
  convention: modified
  joints:
    - {name: q1, type: revolute, a: 0, alpha: 0, d: 0}
    - {name: q2, type: revolute, a: 1.0, alpha: 0, d: 0}
  links: [{name: l1}, {name: l2}]
  points: {tip: {link: l2, at: [0.8, 0, 0]}}
"""
    one, *_ = follow(STANDARD_2R, CIRCLE % "branch: elbow_up", TIMES)
    two, *_ = follow(modified, CIRCLE % "branch: elbow_up", TIMES)
    assert two.method == "analytic"
    for name in ("q", "qd", "qdd"):
        assert_close(getattr(two.motion, name), getattr(one.motion, name), 1e-14)


# offsets, links bent out of the x axes, an axis turned over, joints at different heights, a mount of its own
ARMS = {
    "offsets": """\
  convention: standard
  joints:
    - {name: q1, type: revolute, a: 1.0, alpha: 0, d: 0.1, offset: 0.4}
    - {name: q2, type: revolute, a: 0.8, alpha: 0, d: -0.3, offset: -2.5}
  links: [{name: l1}, {name: l2}]
  points: {tip: {link: l2, at: end}}
""",
    "turned over": """\
  convention: standard
  joints:
    - {name: q1, type: revolute, a: 1.0, alpha: 180 deg, d: 0}
    - {name: q2, type: revolute, a: 0.8, alpha: 0, d: 0.2}
  links: [{name: l1}, {name: l2}]
  points: {tip: {link: l2, at: [-0.1, 0.3, 0.05]}}
""",
    "by axes": """\
  joints:
    - {name: q1, type: revolute, axis: [0, 0, -1], origin: {xyz: [0.1, 0, 0.2], rpy: [0, 0, 0.3]}}
    - {name: q2, type: revolute, axis: [0, 0, 2], origin: {xyz: [0.6, 0.7, 0.1], rpy: [0, 0, 1]}, offset: 0.2}
    - {name: weld, type: fixed, origin: {xyz: [0.5, -0.4, 0], rpy: [0.3, 0, 0]}}
  links: [{name: l1}, {name: l2}, {name: l3}]
  points: {tip: {link: l3, at: [0.1, 0.1, 0]}}
""",
}


@pytest.mark.parametrize("branch", ["elbow_up", "elbow_down"])
@pytest.mark.parametrize("arm", ARMS)
def test_closed_form_on_other_arms(arm: str, branch: str) -> None:
    found, model, s = follow(ARMS[arm], CIRCLE % f"branch: {branch}", TIMES)
    assert found.method == "analytic"
    assert miss(found, model, s, TIMES) < 1e-14
    check_rates(found.motion, TIMES)
    # the branch as the lecture means it: the side on which the elbow lies, seen against the first axis
    elbow = forward(with_point(model), "elbow", found.motion.q)
    tip = forward(model, "tip", found.motion.q)
    base = forward(with_point(model, "base"), "base", found.motion.q)
    axis = np.array(model.bodies[0].X_tree.E, dtype=float)[2]
    side = np.cross(elbow - base, tip - elbow) @ axis
    assert np.all(np.sign(side) == (-1.0 if branch == "elbow_up" else 1.0))


def with_point(model, name="elbow"):
    """Return the model with the origin of its second (or first) joint as a point."""
    frame = FixedFrame(1 if name == "elbow" else 0, zeros(3), identity())
    return dataclasses.replace(model, points={**model.points, name: frame})


@pytest.mark.parametrize("seed", range(4))
def test_a_moved_base_changes_nothing_but_the_target(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz, rpy = rng.normal(size=3), rng.uniform(-3, 3, 3)
    base = f"  base: {{xyz: {xyz.tolist()}, rpy: {rpy.tolist()}}}\n"
    level, *_ = follow(STANDARD_2R, CIRCLE % "branch: elbow_up", TIMES)
    R = real(rotation_rpy(rpy.tolist()))
    center, normal, u = R @ [0.9, 0.7, 0.0] + xyz, R[:, 2], R[:, 0]
    # the circle starts where its u axis points: find the phase of the arm's own x axis
    eu, ev = CircleTrajectory("circle", "tip", (0, 0, 0), 1.0, 1.0, normal=tuple(normal)).axes()
    start = float(np.arctan2(u @ ev, u @ eu))
    text = (
        f"{{type: circle, point: tip, center: {center.tolist()}, radius: 0.25, duration: 10, "
        f"start: {start!r}, normal: {normal.tolist()}, ik: {{branch: elbow_up, tolerance: 1e-11}}}}"
    )
    found, model, s = follow(STANDARD_2R + base, text, TIMES)
    assert found.method == "analytic"
    for name in ("q", "qd", "qdd"):
        assert_close(getattr(found.motion, name), getattr(level.motion, name), 1e-13)
    assert miss(found, model, s, TIMES) < 1e-13


def test_two_coordinates_place_a_point_on_a_tilted_arm() -> None:
    found, model, s = follow(
        STANDARD_2R + "  base: {rpy: [40 deg, 10 deg, 0], xyz: [0.1, 0, 2]}\n",
        "{type: circle, point: tip, center: [0.9, 0.6], radius: 0.2, duration: 10, ik: {branch: elbow_down}}",
        TIMES,
    )
    assert found.method == "analytic" and miss(found, model, s, TIMES) < 1e-14
    check_rates(found.motion, TIMES)


def test_newton_agrees_with_the_closed_form() -> None:
    one, *_ = follow(STANDARD_2R, CIRCLE % "branch: elbow_down", TIMES)
    for ik in ("method: newton, branch: elbow_down", "method: newton, guess: {q1: -0.5, q2: 1.5}"):
        two, *_ = follow(STANDARD_2R, CIRCLE % ik, TIMES)
        assert two.method == "newton"
        for name in ("q", "qd", "qdd"):
            assert_close(getattr(two.motion, name), getattr(one.motion, name), 1e-13)


@pytest.mark.parametrize("samples", [2, 3, 7, 40, 1001])
def test_turns_are_counted_however_few_the_samples(samples: int) -> None:
    path = "{type: circle, point: tip, center: [0.1, 0], radius: 1.0, duration: 4, turns: 25, ik: {%s}}"
    times = np.linspace(0.0, 4.0, samples)
    for ik in BOTH:
        if "newton" in ik and samples not in (3, 40):
            continue
        found, model, s = follow(STANDARD_2R, path % ik, times)
        q = found.motion.q
        assert abs(q[-1, 0] - q[0, 0] - 50 * np.pi) < 1e-9 and abs(q[-1, 1] - q[0, 1]) < 1e-9
        assert -np.pi < q[0, 0] <= np.pi and miss(found, model, s, times) < 1e-12


def test_a_guess_chooses_branch_and_turn() -> None:
    up, *_ = follow(STANDARD_2R, CIRCLE % "branch: elbow_up", TIMES)
    found, *_ = follow(STANDARD_2R, CIRCLE % "guess: {q1: 7.5, q2: -7}", TIMES)
    assert found.method == "analytic"
    assert_close(found.motion.q, up.motion.q + np.array([2 * np.pi, -2 * np.pi]), 1e-14)
    start, *_ = follow(STANDARD_2R, CIRCLE % "", TIMES, "initial: {q: {q1: 0, q2: -1}}")
    assert_close(start.motion.q, up.motion.q, 1e-14)


# -- what cannot be followed --------------------------------------------------------------------------------
@each_ik
def test_a_target_out_of_reach_is_named(ik: str) -> None:
    path = (
        "{type: circle, point: tip, center: [1.3, 0.7], radius: 0.6, duration: 10, start: 180 deg, ik: {%s}}"
    )
    with pytest.raises(GeometryError) as caught:
        follow(STANDARD_2R, path % ik, TIMES)

    def short(t: Any) -> Any:
        phi = np.pi + 0.2 * np.pi * t
        return np.hypot(1.3 + 0.6 * np.cos(phi), 0.7 + 0.6 * np.sin(phi)) - 1.8

    # the circle reaches farthest where it leads away from the base
    worst = 10.0 * (0.5 + np.arctan2(0.7, 1.3) / (2.0 * np.pi))
    first = brentq(short, worst - 3.0, worst, xtol=1e-14)
    details = caught.value.details
    assert caught.value.exit_code == 5 and "'tip'" in caught.value.message
    assert abs(details["time"] - first) < 1e-6 and details["distance"] < 1e-6
    assert abs(details["worst_time"] - worst) < 0.1
    assert abs(details["worst_distance"] - short(worst)) < 1e-3
    assert f"at t = {first:.5f} s and later: at worst, at t = 5." in caught.value.message


@each_ik
def test_a_target_out_of_reach_is_so_at_a_time_of_the_motion(ik: str) -> None:
    """Whatever samples are looked at: the same message; Newton's method says the same time."""
    path = (
        "{type: circle, point: tip, center: [1.3, 0.7], radius: 0.6, duration: 10, start: 180 deg, ik: {%s}}"
    )
    told = set()
    for samples in (11, 97, 1001, 2500):
        with pytest.raises(GeometryError) as caught:
            follow(STANDARD_2R, path % ik, np.linspace(0.0, 10.0, samples))
        told.add(caught.value.message.partition(" and later" if "newton" in ik else "\n")[0])
    assert len(told) == 1, told


def test_too_near_to_the_base_is_out_of_reach_too() -> None:
    with pytest.raises(GeometryError) as caught:
        follow(
            STANDARD_2R,
            cartesian('["1 - t", 0]', "branch: elbow_up"),
            np.linspace(0, 1, 101),
        )
    assert abs(caught.value.details["time"] - 0.8) < 1e-8
    assert abs(caught.value.details["worst_distance"] - 0.2) < 1e-12


@each_ik
def test_a_planar_arm_cannot_leave_its_plane(ik: str) -> None:
    with pytest.raises(GeometryError) as caught:
        follow(
            STANDARD_2R,
            cartesian('[1, 0.5, "max(0, t - 0.5)"]', ik),
            np.linspace(0, 1, 101),
        )
    assert abs(caught.value.details["time"] - 0.5) < 1e-6
    assert abs(caught.value.details["worst_distance"] - 0.5) < 1e-6


EQUAL = STANDARD_2R.replace("a: 0.8", "a: 1.0")


@pytest.mark.parametrize("shift", ["0", "0.0037"], ids=["at a sample", "between samples"])
@each_ik
def test_through_the_base_is_singular(ik: str, shift: str) -> None:
    # the tip of an arm with equal links runs straight through the first joint: the links fold up there
    with pytest.raises(SingularConfigurationError) as caught:
        follow(
            EQUAL,
            cartesian(f'["0.5 + {shift} - t", 0]', ik),
            np.linspace(0, 1, 101),
        )
    assert caught.value.exit_code == 4
    assert abs(caught.value.details["time"] - 0.5 - float(shift)) < 1e-4


@each_ik
def test_touching_the_limit_of_the_workspace_is_singular(ik: str) -> None:
    # stretched out at t = 0.5 + 0.0037, between two samples
    with pytest.raises((SingularConfigurationError, GeometryError)) as caught:
        follow(
            EQUAL,
            cartesian('["2 - (t-0.5037)^2", 0]', ik),
            np.linspace(0, 1, 101),
        )
    assert abs(caught.value.details["time"] - 0.5037) < 5e-3


def test_leaving_the_reach_between_two_samples_is_seen() -> None:
    for ik in BOTH:
        with pytest.raises(GeometryError) as caught:
            follow(
                EQUAL,
                cartesian('["2 + 1e-6 - (t-0.505)^2", 0]', ik),
                np.linspace(0, 1, 101),
            )
        assert abs(caught.value.details["time"] - 0.505) < 2e-3
        assert caught.value.details["worst_distance"] <= 1.0001e-6


def test_a_choice_is_asked_for() -> None:
    with pytest.raises(SceneError, match=r"ik\.branch.*ik\.guess"):
        follow(STANDARD_2R, CIRCLE % "", TIMES)
    with pytest.raises(SceneError, match="stretched out"):
        follow(STANDARD_2R, CIRCLE % "guess: {q1: 0.3, q2: 0}", TIMES)
    with pytest.raises(SceneError, match=r"trajectory\.ik\.guess"):
        follow(SEVEN, "{type: circle, point: tip, center: [0.4, 0, 0.5], radius: 0.1, duration: 1}", TIMES)
    with pytest.raises(SceneError, match="lacks joint 'q2'"):
        follow(STANDARD_2R, CIRCLE % "", TIMES, "initial: {q: {q1: 0.1}}")


def test_options_that_do_not_fit_are_refused() -> None:
    path = "{type: circle, point: tip, center: [0.4, 0, 0.5], radius: 0.1, duration: 1, ik: {%s}}"
    with pytest.raises(CapabilityError, match="analytic fits only planar 2R"):
        follow(SEVEN, path % f"method: analytic, guess: {SEVEN_GUESS}", TIMES)
    with pytest.raises(SceneError, match="only for"):
        follow(SEVEN, path % f"branch: elbow_up, guess: {SEVEN_GUESS}", TIMES)
    fixed = STANDARD_2R.replace("points: {", "points: {post: {link: base}, ")
    with pytest.raises(SceneError, match="fixed to the base"):
        follow(fixed, (CIRCLE % "branch: elbow_up").replace("point: tip", "point: post"), TIMES)


# -- any chain, by Newton -----------------------------------------------------------------------------------
RING = (
    "{type: circle, point: tip, center: [0.45, 0.1, 0.6], radius: 0.15, normal: [0.3, 0.2, 1], duration: 10, "
    f"ik: {{guess: {SEVEN_GUESS}}}}}"
)


def jacobians(model, point, q):
    """Position Jacobians (T, 3, n) by plain geometry on numbers."""
    frame, out = model.points[point], []
    for row in q:
        x = [float(v) for v in row]
        pose = poses(model, transforms(model, x))
        J, _ = point_jacobian(model, x, pose, frame.body, pose[frame.body].point(frame.p))
        out.append(model.base.E.T @ J)
    return real(np.array(out))


def test_a_redundant_arm_moves_with_least_rates() -> None:
    found, model, s = follow(SEVEN, RING, TIMES)
    motion = found.motion
    assert miss(found, model, s, TIMES) < 1e-13
    check_rates(motion, TIMES, 1e-10)
    few = slice(None, None, 50)
    J, target = jacobians(model, "tip", motion.q[few]), s.trajectory.target(TIMES[few], {})
    least = np.einsum("tnm,tm->tn", np.linalg.pinv(J), target.pd)
    assert_close(motion.qd[few], least, 1e-12)
    assert abs(np.abs(motion.q[:, 6] - 0.1).max()) < 1e-15  # the last joint does not move the point


def test_self_motion_does_not_depend_on_the_samples() -> None:
    fine, *_ = follow(SEVEN, RING, np.linspace(0, 10, 2001))
    for samples in (11, 101, 1001):
        found, *_ = follow(SEVEN, RING, np.linspace(0, 10, samples))
        step = 2000 // (samples - 1)
        assert_close(found.motion.q, fine.motion.q[::step], 2e-8)


def test_planar_3r_with_two_coordinates() -> None:
    robot = """\
  convention: standard
  joints:
    - {name: q1, type: revolute, a: 0.5, alpha: 0, d: 0}
    - {name: q2, type: revolute, a: 0.4, alpha: 0, d: 0}
    - {name: q3, type: revolute, a: 0.3, alpha: 0, d: 0}
  links: [{name: l1}, {name: l2}, {name: l3}]
"""
    for size, center in (("2", "[0.6, 0.3]"), ("3", "[0.6, 0.3, 0]")):
        path = f"{{type: circle, point: l3.end, center: {center}, radius: 0.2, duration: 10}}"
        found, model, s = follow(robot, path, TIMES, "initial: {q: {q1: 0.1, q2: 0.5, q3: 0.5}}")
        assert found.method == "newton" and miss(found, model, s, TIMES) < 1e-13, size
        check_rates(found.motion, TIMES, 1e-10)
    with pytest.raises(GeometryError) as caught:
        path = "{type: circle, point: l3.end, center: [0.9, 0.3], radius: 0.4, duration: 10, start: 180 deg}"
        follow(robot, path, TIMES, "initial: {q: {q1: 0.1, q2: 0.5, q3: 0.5}}")

    def reach(t: float) -> float:
        return float(np.hypot(0.9 - 0.4 * np.cos(0.2 * np.pi * t), 0.3 - 0.4 * np.sin(0.2 * np.pi * t)) - 1.2)

    assert abs(caught.value.details["time"] - brentq(reach, 3.0, 4.5)) < 1e-5
    assert abs(caught.value.details["worst_distance"] - np.hypot(0.9, 0.3) + 0.8) < 1e-3


def test_a_gantry_just_follows() -> None:
    robot = """\
  joints:
    - {name: x, type: prismatic, axis: [1, 0, 0], origin: {xyz: [0, 0, 1]}}
    - {name: y, type: prismatic, axis: [0, 1, 0], offset: 0.1}
    - {name: z, type: prismatic, axis: [0, 0, -1]}
  links: [{name: l1}, {name: l2}, {name: l3}]
  points: {tool: {link: l3, at: [0, 0, -0.2]}}
"""
    path = cartesian('["t", "sin(t)", "0.3*cos(2*t)"]', "guess: {x: 0, y: 0, z: 0}", "tool", 5)
    t = np.linspace(0, 5, 301)
    found, *_ = follow(robot, path, t)
    q = np.stack([t, np.sin(t) - 0.1, 0.8 - 0.3 * np.cos(2 * t)], axis=1)
    qdd = np.stack([0 * t, -np.sin(t), 1.2 * np.cos(2 * t)], axis=1)
    assert_close(found.motion.q, q, 1e-14)
    assert_close(found.motion.qdd, qdd, 1e-14)


def test_a_cylindrical_robot() -> None:
    robot = """\
  convention: standard
  base: {xyz: [0.2, -0.1, 0.05], rpy: [0, 0, 30 deg]}
  joints:
    - {name: turn, type: revolute, a: 0, alpha: 0, d: 0.2}
    - {name: lift, type: prismatic, a: 0, alpha: -90 deg, theta: 0}
    - {name: reach, type: prismatic, a: 0, alpha: 0, theta: 0, offset: 0.1}
  links: [{name: l1}, {name: l2}, {name: l3}]
"""
    path = (
        "{type: circle, point: l3.end, center: [0.5, 0.4, 0.6], radius: 0.2, normal: [1, 1, 0], "
        "duration: 10, ik: {guess: {turn: 0, lift: 0.3, reach: 0.4}}}"
    )
    found, model, s = follow(robot, path, TIMES)
    assert miss(found, model, s, TIMES) < 1e-14
    p = s.trajectory.target(TIMES, {}).p - [0.2, -0.1, 0.05]
    assert_close(found.motion.q[:, 1], p[:, 2] - 0.2, 1e-13)
    assert_close(found.motion.q[:, 2], np.hypot(p[:, 0], p[:, 1]) - 0.1, 1e-13)
    check_rates(found.motion, TIMES, 1e-10)


def test_branch_is_kept_where_another_is_near() -> None:
    # close to the limit of the workspace the two branches almost meet
    radius = float(1.8 - np.hypot(0.9, 0.7) - 2e-5)
    path = CIRCLE.replace("0.25", repr(radius))
    found, model, s = follow(STANDARD_2R, path % "method: newton, branch: elbow_up", TIMES)
    assert np.all(found.motion.q[:, 1] < 0.0) and miss(found, model, s, TIMES) < 1e-12
    closed, *_ = follow(STANDARD_2R, path % "branch: elbow_up", TIMES)
    assert_close(found.motion.q, closed.motion.q, 1e-10)


def test_a_stretched_out_start_is_no_obstacle() -> None:
    path = CIRCLE.replace("[0.9, 0.7]", "[1.2, 0]") % "method: newton, guess: {q1: 0, q2: 0}"
    found, model, s = follow(STANDARD_2R, path, TIMES)
    assert miss(found, model, s, TIMES) < 1e-13

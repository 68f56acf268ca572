"""Dry friction and gear losses of joints that a path leaves at rest: never the sign of rounding."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.torques.rest import _listed, _periods
from robodyn_cli.works.inverse import inverse

LOSSES = (
    "friction: {coulomb: 3, viscous: 0.1}",
    "friction: {coulomb: {positive: 2, negative: -3}}",
    "gear: {efficiency: 0.8}",
)


def arm(seed: int) -> str:
    """An arm on a turntable whose tip follows an arc about the turntable's axis: only the first joint moves."""
    rng = np.random.default_rng(seed)
    loss = LOSSES[seed % 3]
    a, b = rng.uniform(0.3, 0.9, 2)
    h = rng.uniform(0.2, 0.6)
    q2, q3 = rng.uniform(0.2, 1.0), rng.uniform(0.4, 1.5)
    reach = a * np.cos(q2) + b * np.cos(q2 + q3)
    height = h - a * np.sin(q2) - b * np.sin(q2 + q3)
    swing = rng.uniform(0.3, 1.2)
    return f"""
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {{name: q1, type: revolute, axis: [0, 0, 1], {loss}}}
    - {{name: q2, type: revolute, origin: {{xyz: [0, 0, {h}]}}, axis: [0, 1, 0], {loss}}}
    - {{name: q3, type: revolute, origin: {{xyz: [{a}, 0, 0]}}, axis: [0, 1, 0], {loss}}}
  links:
    - {{name: l1, mass: 3, com: [0, 0, 0.1], inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}}}
    - {{name: l2, mass: 2, com: [0.2, 0, 0], inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}}}
    - {{name: l3, mass: 1, com: [0.2, 0, 0], inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}}}
  points: {{tip: {{link: l3, at: [{b}, 0, 0]}}}}
parameters: {{R: {reach}, H: {height}, S: {swing}}}
trajectory:
  type: cartesian
  point: tip
  duration: 2
  position: ["R*cos(S*sin(t))", "R*sin(S*sin(t))", "H"]
  ik: {{guess: {{q1: 0, q2: {q2}, q3: {q3}}}}}
"""


@pytest.mark.parametrize("seed", range(9))
def test_joints_that_the_path_leaves_at_rest_have_no_friction(seed: int) -> None:
    found = inverse(load_scene_text(arm(seed)))
    term = found["torque_terms/gear" if seed % 3 == 2 else "torque_terms/friction"]
    assert np.abs(term[:, 0]).max() > 0.05
    assert np.abs(term[:, 1:]).max() == 0.0
    assert np.abs(found["qd"][:, 1:]).max() == 0.0
    (said,) = [text for text in found.summary["warnings"] if "not determined" in text]
    assert said.startswith("q2, q3 stand still from 0 to 2 s: there ") and "q1" not in said
    assert said.endswith("without losses of gears" if seed % 3 == 2 else "without dry friction")


def test_a_slow_joint_is_no_joint_at_rest() -> None:
    """1e-8 rad/s beside 1 rad/s is what the scene asks for, and has the friction of its direction."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], friction: {coulomb: 1}}
    - {name: b, type: revolute, axis: [0, 1, 0], friction: {coulomb: 1}}
  links:
    - {name: l1, mass: 1, com: [0, 0, 0], inertia: {xx: 1, yy: 1, zz: 1}}
    - {name: l2, mass: 1, com: [0, 0, 0], inertia: {xx: 1, yy: 1, zz: 1}}
trajectory: {type: joint, duration: 1, q: {a: "t", b: "-1e-8*t"}}
"""
    found = inverse(load_scene_text(text))
    assert np.abs(found["torque_terms/friction"] - [1.0, -1.0]).max() == 0.0
    assert "warnings" not in found.summary


def test_a_table_that_holds_a_joint_leaves_it_at_rest() -> None:
    """The splines of a constant column have slopes of rounding."""
    times = np.linspace(0.0, 1.0, 41)
    rows = ", ".join(f"[{t}, {np.sin(t)}, {0.1 + 0.2}]" for t in times)
    text = f"""
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {{name: a, type: revolute, axis: [0, 0, 1]}}
    - {{name: b, type: revolute, axis: [0, 1, 0], friction: {{coulomb: 1}}}}
  links:
    - {{name: l1, mass: 1, com: [0, 0, 0], inertia: {{xx: 1, yy: 1, zz: 1}}}}
    - {{name: l2, mass: 1, com: [0.2, 0, 0], inertia: {{xx: 1, yy: 1, zz: 1}}}}
trajectory: {{type: table, columns: [t, a, b], rows: [{rows}]}}
"""
    found = inverse(load_scene_text(text))
    friction = found["torque_terms/friction"] if "torque_terms/friction" in found else np.zeros(1)
    assert np.abs(friction).max() == 0.0


def test_periods_at_rest_are_told_with_their_ends() -> None:
    """Two samples in a row are no period; a line names the first three."""
    still = np.array([1, 1, 1, 0, 1, 1, 0, 0, 1, 1, 1, 1], dtype=bool)
    assert _periods(np.arange(12.0), still) == [(0.0, 2.0), (8.0, 11.0)]
    assert _periods(np.arange(12.0), np.zeros(12, dtype=bool)) == []
    assert _listed([(0.0, 2.0)]) == "from 0 to 2 s"
    assert _listed([(float(k), k + 0.5) for k in range(5)]).endswith("from 2 to 2.5 s and 2 more times")


def test_friction_at_the_ends_of_pieces_is_that_of_the_piece() -> None:
    """From rest to rest and back: at its ends a way has rates of zero, and its friction all the same."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: j, type: revolute, axis: [0, 0, 1], friction: {coulomb: 3}}]
  links: [{name: l, mass: 1, com: [0.3, 0, 0], com_frame: joint, inertia: {zz: 0.1}}]
trajectory: {type: s_curve, speed: {j: 1}, acceleration: {j: 4}, jerk: {j: 40}, points: [{q: {j: 0}}, {q: {j: 1}}, {q: {j: 0}}]}
"""
    for samples in (11, 400):
        figures = inverse(load_scene_text(text), samples=samples).summary["joints"]["j"]
        assert figures["peak_torque"] == pytest.approx(3.0 + 4.0 * 0.19, abs=1e-9)
        assert figures["errors"]["peak_torque"] < 1e-6 and figures["errors"]["rms_torque"] < 1e-6

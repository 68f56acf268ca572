"""Joints with several coordinates in scenes: how values are written, what they become, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.scene import load_scene_text
from robodyn_cli.scene.types import Scene

BODY = "mass: 1, com: [0.1, 0, 0], inertia: {xx: 0.1, yy: 0.2, zz: 0.25}"


def scene(joint: str, rest: str = "") -> Scene:
    return load_scene_text(
        f"""
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{{name: j, {joint}}}]
  links: [{{name: body, {BODY}}}]
{rest}
"""
    )


def initial(joint: str, q: str) -> dict[str, float]:
    return dict(scene(joint, f"initial: {{q: {{j: {q}}}}}").initial.q)


HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("joint", "text", "expected"),
    [
        ("type: helical, axis: [0, 0, 1], pitch: 0.1", "30 deg", {"j": math.pi / 6}),
        ("type: cylindrical, axis: [0, 0, 1]", "[90 deg, 2]", {"j.theta": math.pi / 2, "j.d": 2.0}),
        ("type: cylindrical, axis: [0, 0, 1]", "{d: 1}", {"j.d": 1.0}),
        ("type: universal", "{theta2: 0.5, theta1: 1}", {"j.theta1": 1.0, "j.theta2": 0.5}),
        ("type: planar", "[1, 2, 0.5]", {"j.x": 1.0, "j.y": 2.0, "j.theta": 0.5}),
        ("type: spherical", "{rpy: [0, 0, 90 deg]}", {"j.qw": HALF, "j.qx": 0.0, "j.qy": 0.0, "j.qz": HALF}),
        ("type: spherical", "{rotation_vector: [pi, 0, 0]}", {"j.qw": 0.0, "j.qx": 1.0, "j.qy": 0.0, "j.qz": 0.0}),
        ("type: spherical", "[0.7071, 0, 0.7071, 0]", {"j.qw": HALF, "j.qx": 0.0, "j.qy": HALF, "j.qz": 0.0}),
        ("type: spherical", "{qw: 0, qx: 0, qy: 1, qz: 0}", {"j.qw": 0.0, "j.qx": 0.0, "j.qy": 1.0, "j.qz": 0.0}),
        (
            "type: floating", "{xyz: [1, 2, 3], quaternion: [1, 0, 0, 0]}",
            {"j.x": 1.0, "j.y": 2.0, "j.z": 3.0, "j.qw": 1.0, "j.qx": 0.0, "j.qy": 0.0, "j.qz": 0.0},
        ),
    ],
)  # fmt: skip
def test_positions_by_column(joint: str, text: str, expected: dict[str, float]) -> None:
    found = initial(joint, text)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=1e-15)


BAD = [
    ("type: helical, axis: [0, 0, 1]", "0", "'pitch' is missing"),
    ("type: helical, axis: [0, 0, 1], pitch: 0.1, offset: 1", "0", "takes no 'offset'"),
    ("type: revolute, axis: [0, 0, 1], pitch: 0.1", "0", "helical joints only"),
    ("type: spherical, axis: [0, 0, 1]", "[1, 0, 0, 0]", "has no axis"),
    ("type: cylindrical", "[0, 0]", "needs an 'axis'"),
    ("type: universal, a: 1", "[0, 0]", "D-H parameters describe revolute, prismatic and fixed joints"),
    ("type: universal, axis: [0, 0, 1], axis2: [0, 1, 1]", "[0, 0]", "at right angles"),
    ("type: revolute, axis: [0, 0, 1], axis2: [1, 0, 0]", "0", "universal and planar joints only"),
    ("type: planar, gear_ratio: 3", "[0, 0, 0]", "'gear_ratio' belongs to one of its coordinates"),
    ("type: planar, spring: {stiffness: 3}", "[0, 0, 0]", "'spring' belongs to one of its coordinates"),
    (
        "type: planar",
        "1",
        "'j' is planar and has 3 coordinates here; allowed: a list or a map of x, y, theta",
    ),
    ("type: planar", "[1, 2]", "has 2 entries; needed: 3, x, y, theta"),
    ("type: planar", "{x: 1, z: 2}", "unknown coordinate 'z'"),
    ("type: planar", "[1 deg, 0, 0]", "'deg' does not fit"),
    ("type: spherical", "[1, 1, 0, 0]", "length 1.41421; needed: length 1"),
    ("type: spherical", "[1, 0, 0]", "needed: 4, qw, qx, qy, qz"),
    ("type: spherical", "{qw: 1}", "lacks qx, qy, qz"),
    ("type: spherical", "{rpy: [0, 0, 0], quaternion: [1, 0, 0, 0]}", "gives the attitude twice"),
    ("type: spherical", "{rpy: [0, 0]}", "3 entries"),
    (
        "type: floating",
        "{xyz: [0, 0, 0]}",
        "lacks the attitude; needed: one of quaternion, rpy, rotation_vector",
    ),
    ("type: floating", "{rpy: [0, 0, 0]}", "lacks x, y, z"),
]


@pytest.mark.parametrize(("joint", "text", "message"), BAD)
def test_refused(joint: str, text: str, message: str) -> None:
    with pytest.raises(SceneError) as caught:
        initial(joint, text)
    assert message in caught.value.message
    assert caught.value.details["line"] and "j" in caught.value.message


@pytest.mark.parametrize(
    ("rest", "message"),
    [
        ("torques: {j: {wx: q.j.qe}}", "unknown name 'q.j.qe' (did you mean"),
        ("torques: {j: {wx: qd.j.qw}}", "unknown name 'qd.j.qw'"),
        ("torques: {j: [1, 2]}", "has 2 entries; needed: 3, wx, wy, wz"),
        ("torques: {j: 3}", "is spherical and has 3 coordinates here"),
        ("prescribed: {j: {rpy: [t, 0]}}", "allowed: 3 entries"),
        ("initial: {q: {j: [1, 0, 0, 0]}, qd: {j: {rpy: [0, 0, 0]}}}", "unknown coordinate 'rpy'"),
        ("trajectory: {type: joint, duration: 1, q: {}}", "joint 'j' is missing"),
        ("trajectory: {type: quintic, points: [{t: 0, q: {j: [1, 0, 0, 0]}}, {t: 1, q: {j: [1, 1, 0, 0]}}]}",
         "the quaternion (w, x, y, z) has length 1.41421"),
    ],
)  # fmt: skip
def test_refused_of_spherical_joints(rest: str, message: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene("type: spherical", rest)
    assert message in caught.value.message


def test_formulas_know_columns() -> None:
    found = scene("type: spherical", "torques: {j: [-q.j.qx, 2*qd.j.wz, 0]}")
    assert set(found.torques) == {"j.wx", "j.wy", "j.wz"}
    assert found.torques["j.wx"].names == {"q.j.qx"} and found.torques["j.wy"].names == {"qd.j.wz"}


def test_second_axis_makes_the_frame() -> None:
    for text, z, x in (
        ("axis: [0, 0, 2], axis2: [1, 1, 0]", (0, 0, 1), (HALF, HALF, 0)),
        ("axis: [1, 0, 0]", (1, 0, 0), (0, 1, 0)),
        ("", (0, 0, 1), (1, 0, 0)),
    ):
        comma = ", " if text else ""
        model = build_model(scene(f"type: universal{comma}{text}"))
        E = np.array(model.bodies[0].X_tree.E, dtype=float)
        np.testing.assert_allclose(E[2], z, atol=1e-15)
        np.testing.assert_allclose(E[0], x, atol=1e-15)


def test_names_and_units_of_columns() -> None:
    model = build_model(scene("type: floating"))
    assert model.q_names == ("j.x", "j.y", "j.z", "j.qw", "j.qx", "j.qy", "j.qz")
    assert model.v_names == ("j.vx", "j.vy", "j.vz", "j.wx", "j.wy", "j.wz")
    assert model.q_units == ("m",) * 3 + ("1",) * 4 and model.v_units == ("m",) * 3 + ("rad",) * 3


def test_steps_on_the_manifold_go_through_the_joints() -> None:
    model = build_model(
        load_scene_text(
            f"""
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {{name: a, type: planar}}
    - {{name: b, type: spherical}}
    - {{name: c, type: floating}}
  links: [{{name: l1, {BODY}}}, {{name: l2, {BODY}}}, {{name: l3, {BODY}}}]
"""
        )
    )
    manifold = Manifold(model)
    rng = np.random.default_rng(3)
    q = manifold.integrate(manifold.neutral(), rng.normal(size=12))
    assert q.shape == (14,) and manifold.columns(4) == range(3, 7) and manifold.columns(1) == range(1, 2)
    step: Any = 0.5 * rng.normal(size=12)
    there = manifold.integrate(q, step)
    np.testing.assert_allclose(manifold.difference(q, there), step, atol=1e-14)
    np.testing.assert_allclose(manifold.normalise(1.0 * there), there, atol=1e-15)
    for part in (slice(3, 7), slice(10, 14)):
        assert np.linalg.norm(there[part]) == pytest.approx(1.0, abs=1e-15)

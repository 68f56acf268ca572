"""Motion of spherical and floating joints by formulas: rates against differences, torques against energy."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.errors import NumericalError
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.spatial import quaternion
from robodyn_cli.works.inverse import inverse

SCENE = """
schema: 1
gravity: [1, 2, -9.81]
robot:
  joints: [{{name: j, {joint}}}]
  links: [{{name: b, mass: 2, com: [0.1, -0.2, 0.3], inertia: {{xx: 0.1, yy: 0.2, zz: 0.25, xy: 0.02, yz: 0.01}}}}]
trajectory: {{type: joint, duration: 2, q: {{j: {motion}}}}}
inverse: {{samples: 2001}}
"""
FORMS = {
    "rpy": "rpy: [sin(t), 0.4*t, t^2]",
    "rotation_vector": "rotation_vector: [t, 0.3*sin(2*t), -t^2]",
    "quaternion": "quaternion: [1 + t, sin(t), -t^2, 0.5]",
}


def derivative(y: np.ndarray, h: float) -> np.ndarray:
    """Central differences of order 6 at samples 3 to -3."""
    pairs = [(y[3 + k : len(y) - 3 + k] - y[3 - k : len(y) - 3 - k]) for k in (1, 2, 3)]
    return (45 * pairs[0] - 9 * pairs[1] + pairs[2]) / (60 * h)


def angular_velocity(q: np.ndarray, h: float) -> np.ndarray:
    rates = derivative(q, h)
    return np.array(
        [np.array(quaternion.angular_velocity(x, y), dtype=float) for x, y in zip(q[3:-3], rates)]
    )


@pytest.mark.parametrize("form", FORMS)
def test_spherical(form: str) -> None:
    result = inverse(load_scene_text(SCENE.format(joint="type: spherical", motion="{" + FORMS[form] + "}")))
    h = result.time[1]
    np.testing.assert_allclose(np.linalg.norm(result["q"], axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(result["qd"][3:-3], angular_velocity(result["q"], h), atol=1e-9)
    np.testing.assert_allclose(result["qdd"][3:-3], derivative(result["qd"], h), atol=1e-8)
    assert result.summary["round_trip"] < 1e-13
    power = (result["tau"] * result["qd"]).sum(axis=1)
    np.testing.assert_allclose(power[3:-3], derivative(result["energy/total"], h), atol=2e-8)


def test_floating() -> None:
    motion = "{xyz: [t, sin(t), 0.1*t^2], " + FORMS["rpy"] + "}"
    result = inverse(load_scene_text(SCENE.format(joint="type: floating", motion=motion)))
    t, h = result.time, result.time[1]
    np.testing.assert_allclose(result["q"][:, :3], np.column_stack([t, np.sin(t), 0.1 * t**2]), atol=1e-15)
    R = np.array([np.array(quaternion.rotation(q), dtype=float) for q in result["q"][:, 3:]])
    velocity = np.einsum("tij,tj->ti", R, result["qd"][:, :3])
    np.testing.assert_allclose(velocity, np.column_stack([1 + 0 * t, np.cos(t), 0.2 * t]), atol=1e-14)
    np.testing.assert_allclose(result["qdd"][3:-3], derivative(result["qd"], h), atol=1e-8)
    power = (result["tau"] * result["qd"]).sum(axis=1)
    np.testing.assert_allclose(power[3:-3], derivative(result["energy/total"], h), atol=2e-8)
    # the base force of a free body is what its centre of mass needs, whatever it turns about
    assert result.variables["tau"].column_units == ("N",) * 3 + ("N m",) * 3
    assert result.variables["q"].names[3] == "j.qw" and result.variables["q"].dims == ("time", "position")


def test_smooth_through_no_rotation() -> None:
    """A rotation vector that passes zero: quotients of vanishing lengths must not show."""
    scene = load_scene_text(SCENE.format(joint="type: spherical", motion="{rotation_vector: [t - 1, 0, 0]}"))
    result = inverse(scene)
    np.testing.assert_allclose(result["qd"], [[1.0, 0.0, 0.0]] * 2001, atol=1e-14)
    np.testing.assert_allclose(result["qdd"], 0.0, atol=1e-13)


def test_a_formula_without_value_names_the_attitude() -> None:
    scene = load_scene_text(SCENE.format(joint="type: spherical", motion="{rpy: [sqrt(t), 0, 0]}"))
    with pytest.raises(NumericalError) as caught:
        inverse(scene)
    assert "j.rpy = [sqrt(t), 0.0, 0.0] has no finite rate at t = 0 s" in caught.value.message


def test_other_joints_with_several_coordinates_by_way_points_and_tables() -> None:
    joint = "type: cylindrical, axis: [0, 0, 1]"
    text = SCENE.format(joint=joint, motion="[sin(t), 0.1*t]")
    head = text[: text.index("trajectory")]
    points = (
        "{t: 0, q: {j: [0, 0]}}, {t: 1, q: {j: {theta: 90 deg, d: 0.2}}, qd: {j: [0, 0]}, qdd: {j: [0, 0]}}"
    )
    result = inverse(load_scene_text(head + f"trajectory: {{type: quintic, points: [{points}]}}"))
    np.testing.assert_allclose(result["q"][-1], [np.pi / 2, 0.2], atol=1e-14)
    rows = ", ".join(f"[{t / 10}, {t / 5}, {t / 20}]" for t in range(7))
    table = f"trajectory: {{type: table, columns: [t, j.theta, j.d], rows: [{rows}]}}"
    result = inverse(load_scene_text(head + table))
    np.testing.assert_allclose(result["qd"][-1], [2.0, 0.5], atol=1e-10)
    assert result.variables["q"].column_units == ("rad", "m") and result.variables["q"].units == "rad or m"

"""The rotation vector between two attitudes, half turns included, where the sine of the angle tells nothing."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.solve.point_kinematics import what_is_left
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array


def rotation(u: Array) -> Array:
    """Rodrigues' formula, for rotation vectors other than 0."""
    angle = np.linalg.norm(u)
    x, y, z = u / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + 2.0 * np.sin(0.5 * angle) ** 2 * K @ K


@pytest.mark.parametrize("angle", [1e-14, 1e-9, 1e-4, 0.3, 1.5, 3.0, np.pi - 1e-6, np.pi - 1e-9])
def test_the_logarithm_undoes_the_rotation_by_any_angle(angle: float) -> None:
    axes = np.random.default_rng(3).normal(size=(200, 3))
    u = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    found = quaternion.logarithm(np.array([rotation(x) for x in u]))
    np.testing.assert_allclose(found, u, rtol=0, atol=1e-15 * (1.0 + 10.0 * angle))


def test_a_half_turn_is_an_angle_of_pi_about_its_axis() -> None:
    for axis in np.vstack([np.eye(3), np.random.default_rng(4).normal(size=(50, 3))]):
        n = axis / np.linalg.norm(axis)
        found = quaternion.logarithm(2.0 * np.outer(n, n) - np.eye(3))
        assert np.linalg.norm(found) == pytest.approx(np.pi, abs=1e-14)
        assert abs(found @ n) == pytest.approx(np.pi, abs=1e-14)


def test_no_turn_has_the_logarithm_zero() -> None:
    assert quaternion.logarithm(np.eye(3)).tolist() == [0.0, 0.0, 0.0]


def test_a_pose_half_a_turn_away_is_not_there() -> None:
    wanted = np.concatenate([[1.0, 2.0, 3.0], np.eye(3).ravel()])
    found = np.concatenate([[1.0, 2.0, 3.0], np.diag([1.0, -1.0, -1.0]).ravel()])
    left = what_is_left(wanted, found, True)
    assert np.linalg.norm(left) == pytest.approx(np.pi) and abs(left[3]) == pytest.approx(np.pi)


def test_the_turn_left_is_in_the_axes_of_the_world() -> None:
    rng = np.random.default_rng(5)
    B, u = rotation(rng.normal(size=3)), rng.normal(size=3)
    wanted, found = (np.concatenate([np.zeros(3), R.ravel()]) for R in (rotation(u) @ B, B))
    np.testing.assert_allclose(what_is_left(wanted, found, True)[3:], u, atol=1e-14)

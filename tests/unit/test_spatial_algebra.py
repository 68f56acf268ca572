"""Vectors, rotations and transforms against numpy."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from robodyn_cli.expr.graph import Expr, Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.spatial import algebra as al
from robodyn_cli.spatial.algebra import Transform, matrix, vector
from tests.dense import motion_transform, tilde
from tests.numeric import assert_close, real
from tests.random_models import random_rotation


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def random_transform(rng: np.random.Generator) -> Transform:
    return Transform(matrix(random_rotation(rng).tolist()), vector(rng.normal(size=3).tolist()))


def test_vector_and_matrix_hold_floats_and_expressions() -> None:
    x = Graph().symbol("x", "x")
    v = vector([1, 2.5, x, np.float64(3.0)])
    assert v.dtype == object and [type(e) for e in v[:2]] == [float, float] and v[2] is x
    assert matrix([[1, x], [0, 2]]).shape == (2, 2)
    assert al.zeros(2, 3).tolist() == [[0.0] * 3] * 2
    assert al.identity(2).tolist() == [[1.0, 0.0], [0.0, 1.0]]


def test_products(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(2, 3))
    assert_close(al.cross(a, b), np.cross(a, b), 1e-15)
    assert_close(al.skew(a), tilde(a), 0.0)
    assert_close(real(al.skew(a)) @ b, np.cross(a, b), 1e-15)
    assert_close(al.dot(a, b), a @ b, 1e-15)
    assert al.dot([], []) == 0.0


@pytest.mark.parametrize("shape", [(3, 3), (4, 2), (2, 5)])
def test_congruence(rng: np.random.Generator, shape: tuple[int, int]) -> None:
    A, B = rng.normal(size=shape), rng.normal(size=(shape[0], shape[0]))
    B = B + B.T
    got = al.congruence(matrix(A.tolist()), matrix(B.tolist()))
    assert_close(got, A.T @ B @ A, 1e-14)
    assert np.array_equal(got, got.T)


def test_zeros_remove_terms_and_ones_cost_nothing() -> None:
    x, y = Graph().symbols(["x", "y"], "x")
    turned = al.rotation_about(2, math.pi / 2) @ vector([x, y, 0.0])
    assert turned[1] is x and turned[2] == 0.0 and turned[0].op == "neg" and turned[0].args == (y,)


@pytest.mark.parametrize(
    ("x", "expected"),
    [(1e-16, 0.0), (-1e-16, 0.0), (1.0 + 4e-16, 1.0), (1.0 - 4e-16, 1.0), (-1.0 + 4e-16, -1.0), (0.5, 0.5)],
)
def test_snap(x: float, expected: float) -> None:
    assert al.snap(x) == expected


@pytest.mark.parametrize("x", [1e-14, 1.0 - 1e-14, -1.0 - 1e-14, 0.7, math.pi])
def test_snap_leaves_what_is_not_rounding(x: float) -> None:
    assert al.snap(x) == x


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("angle", [0.3, -2.0, math.pi, -math.pi / 2, 2 * math.pi, 0.0, 1])
def test_rotation_about(axis: int, angle: float) -> None:
    R = al.rotation_about(axis, angle)
    unit = np.eye(3)[axis]
    # Rodrigues' formula
    expected = np.eye(3) + math.sin(angle) * tilde(unit) + (1 - math.cos(angle)) * tilde(unit) @ tilde(unit)
    assert_close(R, expected, 1e-15)
    if abs(math.sin(2 * angle)) < 1e-14:
        assert set(real(R).ravel()) <= {0.0, 1.0, -1.0}, "a quarter turn is a permutation, exactly"


def test_rotation_about_a_symbolic_angle() -> None:
    x = Graph().symbol("x", "x")
    for axis in range(3):
        R = al.rotation_about(axis, x)
        assert sum(isinstance(e, Expr) for e in R.ravel()) == 4
        assert_close(evaluate(list(R.ravel()), {"x": [0.7]}), al.rotation_about(axis, 0.7).ravel(), 1e-15)


def test_rotation_rpy(rng: np.random.Generator) -> None:
    from scipy.spatial.transform import Rotation

    for _ in range(5):
        rpy = rng.uniform(-3, 3, 3)
        assert_close(al.rotation_rpy(rpy.tolist()), Rotation.from_euler("xyz", rpy).as_matrix(), 1e-14)


@pytest.mark.parametrize("axis", [v for v in itertools.product((-2.0, 0.0, 2.0), repeat=3) if any(v)])
def test_rotation_to_z(axis: tuple[float, float, float]) -> None:
    R = real(al.rotation_to_z(axis))
    assert_close(R @ [0.0, 0.0, 1.0], np.array(axis) / np.linalg.norm(axis), 1e-15)
    assert_close(R.T @ R, np.eye(3), 1e-15)
    assert np.linalg.det(R) > 0.0
    if sum(x != 0.0 for x in axis) == 1:
        assert set(R.ravel()) <= {0.0, 1.0, -1.0}


def test_rotation_to_z_of_any_axis(rng: np.random.Generator) -> None:
    for scale in (1e-9, 1.0, 1e9):
        axis = rng.normal(size=3) * scale
        R = real(al.rotation_to_z(axis.tolist()))
        assert_close(R[:, 2], axis / np.linalg.norm(axis), 1e-15)
        assert_close(R.T @ R, np.eye(3), 1e-15)
    assert al.rotation_to_z((0.0, 0.0, 3.0)).tolist() == np.eye(3).tolist()
    with pytest.raises(ValueError, match="axis is zero"):
        al.rotation_to_z((0.0, 0.0, 0.0))


def test_transform_composition_and_inverse(rng: np.random.Generator) -> None:
    first, second = random_transform(rng), random_transform(rng)
    both = second @ first
    assert_close(motion_transform(both), motion_transform(second) @ motion_transform(first), 1e-14)
    assert_close(motion_transform(first.inverse()), np.linalg.inv(motion_transform(first)), 1e-14)
    for way in (first @ first.inverse(), first.inverse() @ first, Transform.identity()):
        assert_close(motion_transform(way), np.eye(6), 1e-15)
    one = Transform.identity()
    assert_close(motion_transform(one @ first @ one), motion_transform(first), 0.0)


def test_transform_of_points(rng: np.random.Generator) -> None:
    X, p = random_transform(rng), vector(rng.normal(size=3).tolist())
    E, r = real(X.E), real(X.r)
    # the same point, in A and in B coordinates
    assert_close(E @ (real(X.point(p)) - r), p, 1e-15)
    assert_close(X.inverse().point(X.point(p)), p, 1e-15)


def test_transform_from_pose(rng: np.random.Generator) -> None:
    R, p = random_rotation(rng), rng.normal(size=3)
    X = Transform.from_pose(matrix(R.tolist()), vector(p.tolist()))
    # the frame's own origin and x axis, in A coordinates
    assert_close(X.point(vector([0.0, 0.0, 0.0])), p, 0.0)
    assert_close(real(X.point(vector([1.0, 0.0, 0.0]))) - p, R[:, 0], 1e-15)


def test_force_to_parent_is_the_transposed_motion_transform(rng: np.random.Generator) -> None:
    X, n, f = random_transform(rng), rng.normal(size=3), rng.normal(size=3)
    moment, force = X.force_to_parent(vector(n.tolist()), vector(f.tolist()))
    assert_close([*moment, *force], motion_transform(X).T @ np.concatenate([n, f]), 1e-15)


def test_is_finite_vector() -> None:
    assert al.is_finite_vector([0.0, -1e300])
    assert not al.is_finite_vector([0.0, math.nan]) and not al.is_finite_vector([math.inf])

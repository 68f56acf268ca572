"""Vectors, rotations and transforms against numpy."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from robodyn_cli.expr.graph import Expr, Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.spatial import algebra as al
from robodyn_cli.spatial.algebra import Transform, Twist, Wrench, matrix, vector
from robodyn_cli.spatial.inertia import RigidInertia
from tests.dense import motion_transform, star, tilde, twist, velocity_product, wrench
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


@pytest.mark.parametrize("tilt", [10.0**-k for k in range(1, 17)])
def test_rotation_to_z_near_a_coordinate_axis(tilt: float) -> None:
    """cos(1e-8) is 1 in doubles, sin(1e-8) is not 0."""
    for k, sign in itertools.product(range(3), (1.0, -1.0)):
        axis = np.array([tilt, -0.5 * tilt, 0.0])
        axis[k] = sign
        R = real(al.rotation_to_z(axis.tolist()))
        assert_close(R.T @ R, np.eye(3), 1e-15)
        assert_close(R[:, 2], axis / np.linalg.norm(axis), 1e-15)


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


def same(found: Twist | Wrench, expected: np.ndarray, tolerance: float = 1e-14) -> None:
    assert_close(found.components, expected, tolerance)


def test_a_twist_in_the_child_frame_is_that_of_the_motion_transform(rng: np.random.Generator) -> None:
    X, m = random_transform(rng), rng.normal(size=6)
    same(twist(m).to_child(X), motion_transform(X) @ m)
    same(twist(m).to_child(X).to_child(X.inverse()), m)


def test_a_wrench_in_the_parent_frame_is_that_of_the_transposed_motion_transform(
    rng: np.random.Generator,
) -> None:
    """X^T for the way up; X* = X^-T for the way down, through the inverse transform."""
    X, f = random_transform(rng), rng.normal(size=6)
    same(wrench(f).to_parent(X), motion_transform(X).T @ f)
    same(wrench(f).to_parent(X.inverse()), np.linalg.inv(motion_transform(X)).T @ f)


def test_transport_goes_through_a_chain_of_frames_in_one_step(rng: np.random.Generator) -> None:
    first, second, m, f = random_transform(rng), random_transform(rng), rng.normal(size=6), rng.normal(size=6)
    same(twist(m).to_child(second @ first), real(twist(m).to_child(first).to_child(second).components))
    same(wrench(f).to_parent(second @ first), real(wrench(f).to_parent(second).to_parent(first).components))


def test_transport_keeps_power(rng: np.random.Generator) -> None:
    X, m, f = random_transform(rng), twist(rng.normal(size=6)), wrench(rng.normal(size=6))
    assert_close(f.dot(m.to_child(X)), f.to_parent(X).dot(m), 1e-14, 10.0)
    assert_close(f.dot(m), real(f.components) @ real(m.components), 1e-15, 10.0)


def test_a_shift_and_a_turn_are_those_of_velocities_and_moments(rng: np.random.Generator) -> None:
    (w, v, p), R = rng.normal(size=(3, 3)), random_rotation(rng)
    m, f = twist(np.array([*w, *v])), wrench(np.array([*w, *v]))
    same(m.shifted(vector(p.tolist())), np.array([*w, *(v + np.cross(w, p))]))
    same(f.shifted(vector(p.tolist())), np.array([*(w + np.cross(p, v)), *v]))
    turned = np.array([*(R @ w), *(R @ v)])
    same(m.rotated(matrix(R.tolist())), turned)
    same(f.rotated(matrix(R.tolist())), turned)


def test_sums_and_differences(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(2, 6))
    same(twist(a) + twist(b), a + b, 0.0)
    same(twist(a) - twist(b), a - b, 0.0)
    same(wrench(a) + wrench(b), a + b, 0.0)
    same(wrench(a) - wrench(b), a - b, 0.0)
    same(-wrench(a), -a, 0.0)
    same(Twist.zero() + twist(a), a, 0.0)
    same(Wrench.zero() + wrench(a), a, 0.0)


def test_projection_and_span_of_a_subspace(rng: np.random.Generator) -> None:
    S, f, rates = rng.normal(size=(6, 3)), rng.normal(size=6), rng.normal(size=3)
    assert_close(wrench(f).project(matrix(S.tolist())), S.T @ f, 1e-14, 10.0)
    same(Twist.along(matrix(S.tolist()), vector(rates.tolist())), S @ rates)
    same(Wrench.along(matrix(S.tolist()), vector(rates.tolist())), S @ rates)
    assert [real(s.components).tolist() for s in al.columns(matrix(S.tolist()))] == S.T.tolist()


def test_cross_products_are_the_dense_ones(rng: np.random.Generator) -> None:
    v, m = rng.normal(size=(2, 6))
    same(twist(v).cross(twist(m)), velocity_product(v) @ m)


def test_cross_products_keep_jacobi(rng: np.random.Generator) -> None:
    """v x v = 0, and Jacobi's identity."""
    v, m, u = (twist(rng.normal(size=6)) for _ in range(3))
    same(v.cross(v), np.zeros(6))
    jacobi = v.cross(m.cross(u)) + m.cross(u.cross(v)) + u.cross(v.cross(m))
    assert_close(jacobi.components, np.zeros(6), 1e-14, 20.0)


def test_cross_products_are_rates_of_transport(rng: np.random.Generator) -> None:
    """In a frame that moves with velocity v, what is fixed outside changes by -v x m, and -v x* f."""
    v, m, f = rng.normal(size=(3, 6))
    h = 1e-4

    def moved(t: float) -> Transform:
        w = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]]) * t
        R = np.eye(3) + w + w @ w / 2 + w @ w @ w / 6
        return Transform(
            matrix(R.T.tolist()), vector((t * v[3:] + np.cross(v[:3], v[3:]) * t * t / 2).tolist())
        )

    def rate(at: Callable[[float], Twist | Wrench]) -> np.ndarray:
        return (real(at(h).components) - real(at(-h).components)) / (2 * h)

    assert_close(rate(lambda t: twist(m).to_child(moved(t))), -velocity_product(v) @ m, 1e-7, 10.0)
    back = rate(lambda t: wrench(f).to_parent(moved(t).inverse()))
    assert_close(back, -star(v) @ f, 1e-7, 10.0)


def test_expressions_give_the_numbers_and_zeros_stay_numbers(rng: np.random.Generator) -> None:
    X, values = random_transform(rng), rng.normal(size=6)
    symbols = vector(Graph().symbols([f"x{k}" for k in range(6)], "x"))
    m, f = Twist(symbols[:3], symbols[3:]), Wrench(symbols[:3], symbols[3:])
    inputs = {"x": values.tolist()}
    for found, expected in [
        (m.to_child(X), twist(values).to_child(X)),
        (f.to_parent(X), wrench(values).to_parent(X)),
        (m.cross(m + m.to_child(X)), twist(values).cross(twist(values) + twist(values).to_child(X))),
    ]:
        same(expected, np.array(evaluate(list(found.components), inputs)))
    pure = Wrench(symbols[:3], al.zeros(3)).to_parent(X)
    assert pure.f.tolist() == [0.0, 0.0, 0.0], "a pure moment has no force in any frame"


def test_wrenches_side_by_side_are_those_of_each(rng: np.random.Generator) -> None:
    """Forces of a body, their way to the parent and their parts along a subspace, numbers and expressions mixed."""
    symbols = Graph().symbols([f"x{k}" for k in range(6)], "q")
    S = matrix(rng.normal(size=(6, 3)).tolist())
    S[2, 1], S[4, 0] = symbols[0], 0.0
    inertia = RigidInertia(
        symbols[1], vector(rng.normal(size=3).tolist()), matrix(rng.normal(size=(3, 3)).tolist())
    )
    X = random_transform(rng)
    own = [inertia @ Twist(S[:3, k], S[3:, k]) for k in range(3)]
    together = Wrench.beside([inertia @ Twist.of(S[:, :2]), own[2]])
    for k, one in enumerate(own):
        for single, every in ((one, together), (one.to_parent(X), together.to_parent(X))):
            assert [*single.n, *single.f] == [*every.n[:, k], *every.f[:, k]]
        assert list(one.project(S)) == list(together.project(S)[:, k])
    assert together.project(S[:, :0]).size == 0

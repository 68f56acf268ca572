"""Inertias of rigid and articulated bodies against dense 6x6 arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.spatial.algebra import Transform, Twist, matrix, vector
from robodyn_cli.spatial.inertia import (
    ArticulatedInertia,
    RigidInertia,
    parallel_axis,
)
from tests.dense import articulated, motion_transform, spatial_inertia, twist
from tests.numeric import assert_close, real
from tests.random_models import random_inertia, random_rotation

seeds = pytest.mark.parametrize("seed", range(5))


def random_transform(rng: np.random.Generator) -> Transform:
    return Transform(matrix(random_rotation(rng).tolist()), vector(rng.normal(size=3).tolist()))


def random_body(rng: np.random.Generator) -> RigidInertia:
    m, c, I = random_inertia(rng)
    return RigidInertia.from_com(float(m), vector(c.tolist()), matrix(I.tolist()))


def random_articulated(rng: np.random.Generator) -> tuple[ArticulatedInertia, np.ndarray]:
    """A positive definite 6x6 without the structure of a rigid body."""
    L = rng.normal(size=(6, 6))
    S = L @ L.T
    A, H, M = (matrix(x.tolist()) for x in (S[:3, :3], S[:3, 3:], S[3:, 3:]))
    return ArticulatedInertia(A, H, M), S


@seeds
def test_parallel_axes(seed: int) -> None:
    """The inertia about the origin is the sum over the points of the body."""
    rng = np.random.default_rng(seed)
    points, weights = rng.normal(size=(6, 3)), rng.uniform(0.1, 1, 6)

    def about(o: np.ndarray) -> np.ndarray:
        r = points - o
        return sum(w * (x @ x * np.eye(3) - np.outer(x, x)) for w, x in zip(weights, r))

    m, c = weights.sum(), weights @ points / weights.sum()
    body = RigidInertia.from_com(float(m), vector(c.tolist()), matrix(about(c).tolist()))
    assert_close(body.I, about(np.zeros(3)), 1e-14)
    assert_close(body.h, weights @ points, 1e-14)
    assert_close(parallel_axis(body.h, vector(c.tolist())), m * (c @ c * np.eye(3) - np.outer(c, c)), 1e-14)


@seeds
def test_rigid_inertia_in_the_parent_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    body, X = random_body(rng), random_transform(rng)
    dense = motion_transform(X)
    assert_close(spatial_inertia(body.to_parent(X)), dense.T @ spatial_inertia(body) @ dense, 1e-14)
    back = body.to_parent(X).to_parent(X.inverse())
    assert_close(spatial_inertia(back), spatial_inertia(body), 1e-13)
    other = random_body(rng)
    assert_close(spatial_inertia(body + other), spatial_inertia(body) + spatial_inertia(other), 1e-15)
    assert_close(spatial_inertia(RigidInertia.zero() + body), spatial_inertia(body), 0.0)
    assert_close(np.linalg.eigvalsh(spatial_inertia(body.to_parent(X))).min() > 0, True, 0.0)


@seeds
def test_momentum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    body, v = random_body(rng), rng.normal(size=6)
    assert_close((body @ twist(v)).components, spatial_inertia(body) @ v, 1e-14)


@seeds
def test_articulated_from_rigid_and_sum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    body = random_body(rng)
    rigid = ArticulatedInertia.from_rigid(body)
    assert_close(articulated(rigid), spatial_inertia(body), 0.0)
    other, S = random_articulated(rng)
    assert_close(articulated(rigid + other), spatial_inertia(body) + S, 1e-15)


@seeds
def test_articulated_inertia_of_a_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inertia, S = random_articulated(rng)
    s = rng.normal(size=6)
    assert_close((inertia @ twist(s)).components, S @ s, 1e-14)


@seeds
def test_articulated_downdate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inertia, S = random_articulated(rng)
    U = rng.normal(size=6)
    V = U / 3.7
    got = inertia.downdate(vector(U.tolist()), vector(V.tolist()))
    assert_close(articulated(got), S - np.outer(U, V), 1e-14)


@seeds
def test_articulated_in_the_parent_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inertia, S = random_articulated(rng)
    X = random_transform(rng)
    dense = motion_transform(X)
    got = inertia.to_parent(X)
    assert_close(articulated(got), dense.T @ S @ dense, 1e-14)
    assert np.array_equal(got.A, got.A.T) and np.array_equal(got.M, got.M.T)
    # a rigid body seen as an articulated one moves alike
    body = random_body(rng)
    moved = ArticulatedInertia.from_rigid(body).to_parent(X)
    assert_close(articulated(moved), spatial_inertia(body.to_parent(X)), 1e-14)


def test_expressions_give_the_same() -> None:
    rng = np.random.default_rng(3)
    m, c, I = random_inertia(rng)
    graph = Graph()
    C = vector(graph.symbols(["x", "y", "z"], "c"))
    J = [
        [graph.symbol(f"I{min(i, j)}{max(i, j)}", "I", 3 * min(i, j) + max(i, j)) for j in range(3)]
        for i in range(3)
    ]
    mass = graph.symbol("m", "m")
    X = random_transform(rng)
    inputs = {"c": c.tolist(), "I": I.ravel().tolist(), "m": [float(m)]}
    body = RigidInertia.from_com(float(m), vector(c.tolist()), matrix(I.tolist()))
    symbolic = RigidInertia.from_com(mass, C, matrix(J)).to_parent(X)
    moved = ArticulatedInertia.from_rigid(RigidInertia.from_com(mass, C, matrix(J))).to_parent(X)
    for e, number in [
        (symbolic.I, body.to_parent(X).I),
        (symbolic.h, body.to_parent(X).h),
        (moved.A, body.to_parent(X).I),
    ]:
        assert_close(evaluate(list(np.ravel(e)), inputs), np.ravel(number), 1e-13)


def test_momentum_of_a_turning_point_mass() -> None:
    """By hand: 2 kg at (3, 0, 0), turning with 5 rad/s about z: p = (0, 30, 0), L = 90."""
    body = RigidInertia.from_com(2.0, vector([3.0, 0.0, 0.0]), matrix(np.zeros((3, 3)).tolist()))
    momentum = body @ Twist(vector([0.0, 0.0, 5.0]), vector([0.0, 0.0, 0.0]))
    assert real(momentum.f).tolist() == [0.0, 30.0, 0.0] and real(momentum.n).tolist() == [0.0, 0.0, 90.0]

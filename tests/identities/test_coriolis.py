"""The Coriolis matrix: right velocity terms, M-dot - 2 C skew-symmetric, entries of Christoffel."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from robodyn_cli.algorithms.composite import VelocityInertia, coriolis, crba
from robodyn_cli.algorithms.kinematics import transforms, velocities
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.expr.calculus import directional, jacobian
from robodyn_cli.expr.graph import Expr
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.model.model import Model
from tests.dense import motion_transform, spatial_inertia, star, twist, velocity_product
from tests.identities.trees import State, flat, symbols, trees
from tests.numeric import assert_close, examples, first_derivative, real
from tests.random_models import random_tree


def scale_of(model: Model, s: State) -> float:
    """Size of what cancels in C: inertia times rates."""
    return float(np.abs(real(crba(model, s.q))).max() * np.abs(s.qd).sum())


@examples(40)
@given(trees())
def test_velocity_and_gravity_terms(model: Model) -> None:
    s, still = State.random(model), [0.0] * model.nv
    C, G = real(coriolis(model, s.q, s.qd)), real(rnea(model, s.q, still, still, model.gravity))
    scale = float((np.abs(C) @ np.abs(s.qd)).max())
    both = rnea(model, s.q, s.qd, still, model.gravity)
    assert_close(C @ s.qd + G, both, 1e-13, scale + np.abs(G).max())
    assert_close(C @ s.qd, rnea(model, s.q, s.qd, still), 1e-13, scale)


@examples(25)
@given(trees())
def test_rate_of_the_mass_matrix_by_differences(model: Model) -> None:
    s = State.random(model)
    M_dot = first_derivative(lambda t: crba(model, s.q + t * s.qd), s.step)
    C = real(coriolis(model, s.q, s.qd))
    assert_close(C + C.T, M_dot, 1e-11, scale_of(model, s))


@examples(12)
@given(trees(7))
def test_rate_of_the_mass_matrix_by_the_graph(model: Model) -> None:
    s = State.random(model)
    q, qd, _, _ = symbols(model)
    rate = directional(flat(crba(model, q)), q, qd)
    M_dot = real(evaluate(rate, s.inputs)).reshape(model.nv, model.nv)
    skew = M_dot - 2.0 * real(coriolis(model, s.q, s.qd))
    assert_close(skew, -skew.T, 1e-13, scale_of(model, s))


@examples(8)
@given(trees(5))
def test_entries_are_those_of_christoffel(model: Model) -> None:
    s, n = State.random(model), model.nv
    q, _, _, _ = symbols(model)
    gradient = np.zeros((n * n, n))
    for e, row in enumerate(jacobian(flat(crba(model, q)), q)):
        for k, value in zip(row, evaluate(list(row.values()), s.inputs)):
            gradient[e, k] = value
    D = gradient.reshape(n, n, n)  # D_ijk = d M_ij / d q_k
    symbols_ = (D + np.einsum("ikj->ijk", D) - np.einsum("jki->ijk", D)) / 2
    assert_close(coriolis(model, s.q, s.qd), symbols_ @ s.qd, 1e-13, scale_of(model, s))


@examples(12)
@given(trees(8))
def test_graph_gives_the_same_numbers(model: Model) -> None:
    s = State.random(model)
    q, qd, _, _ = symbols(model)
    got = evaluate(flat(coriolis(model, q, qd)), s.inputs)
    assert_close(got, flat(coriolis(model, s.q, s.qd)), 1e-13, scale_of(model, s))


@examples(20)
@given(trees())
def test_linear_in_the_rates(model: Model) -> None:
    s, t = State.random(model), State.random(model, 1)
    both = coriolis(model, s.q, 2.0 * s.qd - 3.0 * t.qd)
    parts = 2.0 * real(coriolis(model, s.q, s.qd)) - 3.0 * real(coriolis(model, s.q, t.qd))
    assert_close(both, parts, 1e-12, scale_of(model, s) + scale_of(model, t))


def test_bodies_that_do_not_share_a_branch_do_not_couple() -> None:
    model = random_tree(8, 11, branching=1.0)
    q, qd, _, _ = symbols(model)
    C = coriolis(model, q, qd)
    apart = 0
    for i, a in enumerate(model.bodies):
        for j, b in enumerate(model.bodies):
            if i not in model.path_to(j) and j not in model.path_to(i):
                assert not isinstance(C[a.v, b.v], Expr) and C[a.v, b.v] == 0.0
                apart += 1
    assert apart > 10


@examples(15)
@given(trees(6))
def test_body_matrix_is_that_of_the_paper(model: Model) -> None:
    """B = (v x* I - I v x + (I v) x-bar*) / 2 (Echeandia and Wensing 2021), in dense 6x6 arithmetic."""
    s = State.random(model)
    X = transforms(model, s.q)
    velocity = velocities(model, X, s.q, s.qd)
    for k, body in enumerate(model.bodies):
        v = np.concatenate([real(velocity[k].w), real(velocity[k].v)])
        I = spatial_inertia(body.inertia)
        B = (star(v) @ I - I @ velocity_product(v) + _bar_star(I @ v)) / 2
        own = VelocityInertia.of_body(body.inertia, velocity[k])
        assert_close(_dense(own), B, 1e-13)
        dense_X = motion_transform(X[k])
        assert_close(_dense(own.to_parent(X[k])), dense_X.T @ B @ dense_X, 1e-13)
        motion = np.random.default_rng(k).normal(size=6)
        assert_close((own @ twist(motion)).components, B @ motion, 1e-13)
        assert_close(own.transposed(twist(motion)).components, B.T @ motion, 1e-13)


def _bar_star(f: np.ndarray) -> np.ndarray:
    """The matrix with (f x-bar*) m = m x* f for every motion m."""
    return np.stack([star(e) @ f for e in np.eye(6)], axis=1)


def _dense(B: VelocityInertia) -> np.ndarray:
    return np.stack([real((B @ twist(e)).components) for e in np.eye(6)], axis=1)

"""RNEA, CRBA and ABA are three readings of one equation: M qdd + h = tau."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given

from robodyn_cli.algorithms.aba import ArticulatedFactor, aba, invert_symmetric
from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.kinematics import slice_q, slice_v, transforms
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Expr
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.spatial.algebra import Twist, Wrench, cross, matrix, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia
from tests.identities.trees import State, condition, flat, symbols, torque_scale, trees
from tests.numeric import EPS, assert_close, examples, real
from tests.random_models import random_tree


@examples(40)
@given(trees())
def test_forward_dynamics_inverts_inverse_dynamics(model: Model) -> None:
    s = State.random(model)
    tau = rnea(model, s.q, s.qd, s.qdd, model.gravity)
    M = real(crba(model, s.q))
    tolerance, scale = 100 * EPS * condition(M), torque_scale(model, s)
    size = np.linalg.norm(M, 2)
    assert_close(
        aba(model, s.q, s.qd, tau, model.gravity), s.qdd, tolerance, scale / size + np.abs(s.qdd).max()
    )
    # and the other way round, on the scale of the torques
    qdd = aba(model, s.q, s.qd, s.tau, model.gravity)
    assert_close(rnea(model, s.q, s.qd, qdd, model.gravity), s.tau, tolerance, scale + np.abs(s.tau).max())


def cross_force(v: Twist, f: Wrench) -> Wrench:
    """v x* f, the rate of a force f that is fixed in a body with the velocity v (equation 2.32)."""
    return Wrench(cross(v.w, f.n) + cross(v.v, f.f), cross(v.w, f.f))


def by_the_book(model: Model, s: State) -> list[float]:
    """Inverse dynamics with spatial accelerations, line by line as in table 5.1 of Featherstone (2008)."""
    X = transforms(model, s.q)
    v, a = {BASE: Twist.zero()}, {BASE: Twist(zeros(3), -model.gravity)}
    f: dict[int, Wrench] = {}
    S = [b.joint.S(slice_q(b, s.q)) for b in model.bodies]
    for i, b in enumerate(model.bodies):
        qd, qdd = slice_v(b, s.qd), slice_v(b, s.qdd)
        v_J, c_J = Twist.along(S[i], qd), Twist.along(b.joint.S_rate(slice_q(b, s.q), qd), qd)
        v[i] = v[b.parent].to_child(X[i]) + v_J
        a[i] = a[b.parent].to_child(X[i]) + Twist.along(S[i], qdd) + c_J + v[i].cross(v_J)
        f[i] = b.inertia @ a[i] + cross_force(v[i], b.inertia @ v[i])
    tau = [0.0] * model.nv
    for i in reversed(range(len(model.bodies))):
        b = model.bodies[i]
        for j, x in enumerate(f[i].project(S[i])):
            tau[b.v + j] = float(x) + b.armature * s.qdd[b.v + j]
        if b.parent != BASE:
            f[b.parent] = f[b.parent] + f[i].to_parent(X[i])
    return tau


@examples(40)
@given(trees())
def test_inverse_dynamics_is_the_recursion_of_the_book(model: Model) -> None:
    s = State.random(model)
    tau = rnea(model, s.q, s.qd, s.qdd, model.gravity)
    assert_close(tau, by_the_book(model, s), 1e-13, torque_scale(model, s))


@examples(40)
@given(trees())
def test_mass_matrix_and_bias_make_up_inverse_dynamics(model: Model) -> None:
    s = State.random(model)
    M, h = crba(model, s.q), rnea(model, s.q, s.qd, [0.0] * model.nv, model.gravity)
    tau = rnea(model, s.q, s.qd, s.qdd, model.gravity)
    assert_close(real(M) @ s.qdd + real(h), tau, 1e-13, torque_scale(model, s))
    for j in range(model.nv):
        unit = [float(k == j) for k in range(model.nv)]
        assert_close(rnea(model, s.q, [0.0] * model.nv, unit), M[:, j], 1e-13, np.abs(real(M)).max())


@examples(40)
@given(trees())
def test_articulated_factor_solves_with_the_mass_matrix(model: Model) -> None:
    s = State.random(model)
    M, factor = real(crba(model, s.q)), ArticulatedFactor(model, s.q)
    inverse = np.stack([real(factor.solve(row)) for row in np.eye(model.nv)], axis=1)
    assert_close(inverse @ M, np.eye(model.nv), 100 * EPS * condition(M))
    assert_close(inverse, inverse.T, 100 * EPS * condition(M))


@examples(40)
@given(trees())
def test_mass_matrix_is_symmetric_and_positive_definite(model: Model) -> None:
    M = crba(model, State.random(model).q)
    for i in range(model.nv):
        for j in range(model.nv):
            assert M[i, j] == M[j, i]
    assert np.linalg.eigvalsh(real(M)).min() > 0.0
    for body in model.bodies:
        assert M[body.v, body.v] > body.armature


@examples(20)
@given(trees(6))
def test_rotors_add_to_the_diagonal_only(model: Model) -> None:
    s = State.random(model)
    bare = dataclasses.replace(
        model, bodies=tuple(dataclasses.replace(b, armature=0.0) for b in model.bodies)
    )
    rotors = np.zeros(model.nv)
    for body in model.bodies:
        rotors[body.v] = body.armature
    assert_close(real(crba(model, s.q)) - real(crba(bare, s.q)), np.diag(rotors), 1e-13, 1.0 + rotors.max())
    with_, without = (rnea(m, s.q, s.qd, s.qdd, m.gravity) for m in (model, bare))
    assert_close(real(with_) - real(without), rotors * s.qdd, 1e-13, torque_scale(model, s))


@examples(15)
@given(trees(8))
def test_graph_gives_the_same_numbers(model: Model) -> None:
    s = State.random(model)
    q, qd, qdd, tau = symbols(model)
    M = real(crba(model, s.q))
    torque = torque_scale(model, s)
    rate = (torque + np.abs(s.tau).max()) / np.linalg.norm(M, 2) * max(1.0, condition(M) / 100)
    pairs = [
        (rnea(model, q, qd, qdd, model.gravity), rnea(model, s.q, s.qd, s.qdd, model.gravity), torque),
        (rnea(model, q, qd, qdd), rnea(model, s.q, s.qd, s.qdd), torque),
        (crba(model, q), crba(model, s.q), np.abs(M).max()),
        (aba(model, q, qd, tau, model.gravity), aba(model, s.q, s.qd, s.tau, model.gravity), rate),
    ]
    for graph, numbers, scale in pairs:
        assert_close(evaluate(flat(graph), s.inputs), flat(numbers), 1e-13, scale)


@examples(10)
@given(trees(5))
def test_constants_may_be_symbols(model: Model) -> None:
    """Mass properties, rotors and gravity as parameters: same torques, and linear in each of them."""
    s = State.random(model)
    values: list[float] = []

    def symbol(x: float) -> Expr:
        values.append(float(x))
        return model.graph.symbol(f"p{len(values) - 1}", "p", len(values) - 1)

    bodies = []
    for b in model.bodies:
        upper = {(i, j): symbol(b.inertia.I[i, j]) for i in range(3) for j in range(i, 3)}
        I = matrix([[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])
        inertia = RigidInertia(symbol(b.inertia.m), vector([symbol(x) for x in b.inertia.h]), I)
        bodies.append(dataclasses.replace(b, inertia=inertia, armature=symbol(b.armature)))
    properties = len(values)
    gravity = vector([symbol(x) for x in model.gravity])
    free = dataclasses.replace(model, bodies=tuple(bodies))
    tau = rnea(free, s.q.tolist(), s.qd.tolist(), s.qdd.tolist(), gravity)
    expected = rnea(model, s.q, s.qd, s.qdd, model.gravity)
    assert_close(evaluate(flat(tau), {"p": values}), expected, 1e-13, torque_scale(model, s))
    p = model.graph.symbols([f"p{k}" for k in range(properties)], "p")
    regressor = directional(flat(tau), p, values[:properties])
    assert_close(evaluate(regressor, {"p": values}), expected, 1e-13, torque_scale(model, s))


def test_graph_takes_many_samples_at_once() -> None:
    model = random_tree(4, 5)
    q, qd, qdd, _ = symbols(model)
    tau = rnea(model, q, qd, qdd, model.gravity)
    states = [State.random(model, k) for k in range(5)]
    inputs = {k: np.stack([getattr(s, k) for s in states], axis=1) for k in ("q", "qd", "qdd")}
    got = np.stack([np.broadcast_to(x, 5) for x in evaluate(flat(tau), inputs)], axis=1)
    for row, s in zip(got, states):
        assert_close(row, rnea(model, s.q, s.qd, s.qdd, model.gravity), 1e-13, torque_scale(model, s))


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_small_symmetric_inverse(n: int) -> None:
    A = np.random.default_rng(n).normal(size=(n, n))
    D = A @ A.T + n * np.eye(n)
    assert_close(real(invert_symmetric(matrix(D.tolist()))) @ D, np.eye(n), 1e-13)


def test_a_joint_that_moves_nothing_is_an_error_on_numbers() -> None:
    model = random_tree(2, 0, armature=False)
    empty = dataclasses.replace(model.bodies[1], inertia=RigidInertia.zero())
    model = dataclasses.replace(model, bodies=(model.bodies[0], empty))
    with pytest.raises(ZeroDivisionError):
        aba(model, [0.1, 0.2], [0.0, 0.0], [0.0, 0.0])

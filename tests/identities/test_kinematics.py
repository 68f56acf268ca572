"""Velocities and accelerations are the derivatives of poses, Jacobians those of points."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robodyn_cli.algorithms.kinematics import (
    motions,
    point_jacobian,
    poses,
    transforms,
    velocities,
)
from robodyn_cli.expr.calculus import directional, jacobian
from robodyn_cli.expr.functions import sin
from robodyn_cli.expr.graph import Expr
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.spatial.algebra import cross, identity, vector
from tests.identities.trees import State, flat, symbols, trees
from tests.numeric import assert_close, examples, first_derivative, real, second_derivative, vee

POINT = vector([0.3, -0.2, 0.5])


def along(model: Model, s: State, t: float) -> np.ndarray:
    return s.q + t * s.qd + t * t / 2 * s.qdd


def time_step(s: State) -> float:
    return 0.03 / max(1.0, float(np.abs(s.qd).sum()), float(np.sqrt(np.abs(s.qdd).sum())))


@examples(25)
@given(trees())
def test_velocities_and_accelerations_by_differences(model: Model) -> None:
    s = State.random(model)
    h = time_step(s)
    X = transforms(model, s.q)
    velocity = velocities(model, X, s.q, s.qd)
    motion = motions(model, X, s.q, s.qd, s.qdd, model.gravity)
    pose = poses(model, X)
    size = 1.0 + float(np.abs(s.qd).sum())
    for k in range(len(model.bodies)):

        def where(t: float, k: int = k) -> np.ndarray:
            P = poses(model, transforms(model, along(model, s, t)))[k]
            return np.column_stack([real(P.R), real(P.p), real(P.point(POINT))])

        R = real(pose[k].R)
        first, second = R.T @ first_derivative(where, h), R.T @ second_derivative(where, h)
        w = vee(first[:, :3])
        assert_close(velocity[k].w, w, 1e-10, size)
        assert_close(velocity[k].v, first[:, 3], 1e-10, size)
        assert_close(motion[k].w, w, 1e-10, size)
        # R'' = R (wd~ + w~ w~)
        assert_close(motion[k].wd, vee(second[:, :3]), 1e-8, size**2)
        assert_close(motion[k].rate_matrix(), second[:, :3], 1e-8, size**2)
        felt = -R.T @ real(model.gravity)
        assert_close(motion[k].a, second[:, 3] + felt, 1e-8, size**2)
        assert_close(motion[k].acceleration_of(POINT), second[:, 4] + felt, 1e-8, size**2)


@examples(8)
@given(trees(6), st.integers(0, 99))
def test_velocities_and_accelerations_by_the_graph(model: Model, seed: int) -> None:
    """Along q_k(t) = a sin(w t + p), with exact derivatives in t."""
    rng = np.random.default_rng(seed)
    t = model.graph.symbol("t", "t")
    n, at = model.nq, {"t": [0.37]}
    a, w, p = rng.uniform(0.5, 2, n), rng.uniform(0.5, 3, n), rng.uniform(0, 6, n)
    q = [float(a[k]) * sin(float(w[k]) * t + float(p[k])) for k in range(n)]

    def rate(outputs: list[Any]) -> list[Any]:
        return directional(outputs, [t], [1.0])

    def number(outputs: Any) -> np.ndarray:
        array = np.asarray(outputs, dtype=object)
        return real(evaluate(flat(array), at)).reshape(array.shape)

    qd, qdd = rate(q), rate(rate(q))
    pose = poses(model, transforms(model, q))
    state = [number(x) for x in (q, qd, qdd)]
    X = transforms(model, state[0])
    motion = motions(model, X, *state, model.gravity)
    velocity = velocities(model, X, state[0], state[1])
    size = 1.0 + float(np.abs(state[1]).sum())
    for k in range(len(model.bodies)):
        spots = [*flat(pose[k].R), *pose[k].p, *pose[k].point(POINT)]
        first = rate(spots)
        R = number(spots)[:9].reshape(3, 3)
        d1, d2 = number(first), number(rate(first))
        # one W = R^T R-dot says both that it is skew and that its vector is w
        W = R.T @ d1[:9].reshape(3, 3)
        assert_close(W, -W.T, 1e-13, size)
        assert_close(velocity[k].w, vee(W), 1e-13, size)
        assert_close(motion[k].w, vee(W), 1e-13, size)
        assert_close(velocity[k].v, R.T @ d1[9:12], 1e-13, size)
        assert_close(motion[k].rate_matrix(), R.T @ d2[:9].reshape(3, 3), 1e-12, size**2)
        assert_close(motion[k].wd, vee(R.T @ d2[:9].reshape(3, 3)), 1e-12, size**2)
        felt = R.T @ real(model.gravity)
        assert_close(motion[k].a, R.T @ d2[9:12] - felt, 1e-12, size**2)
        assert_close(motion[k].acceleration_of(POINT), R.T @ d2[12:] - felt, 1e-12, size**2)


@examples(20)
@given(trees(8), st.integers(0, 10**6))
def test_point_jacobian_by_differences(model: Model, seed: int) -> None:
    s = State.random(model)
    body = seed % len(model.bodies)
    root = [BASE, *model.path_to(body)][seed % (len(model.path_to(body)) + 1)]

    def where(q: Any) -> np.ndarray:
        P = poses(model, transforms(model, q), root)[body]
        return np.column_stack([real(P.R), real(P.point(POINT))])

    pose = poses(model, transforms(model, s.q), root)
    linear, angular = point_jacobian(model, s.q, pose, body, pose[body].point(POINT), root)
    moving = set(model.path_to(body)) - set(model.path_to(root) if root != BASE else [])
    for k, b in enumerate(model.bodies):
        unit = np.eye(model.nv)[b.v]
        slope = first_derivative(lambda t, u=unit: where(s.q + t * u), 0.05)
        assert_close(linear[:, b.v], slope[:, 3], 1e-12, 1.0 + np.abs(slope).max())
        W = slope[:, :3] @ where(s.q)[:, :3].T
        assert_close(angular[:, b.v], vee(W), 1e-12, 1.0)
        assert (k in moving) == bool(
            np.any(real(linear[:, b.v]) != 0.0) or np.any(real(angular[:, b.v]) != 0.0)
        )


@examples(10)
@given(trees(8), st.integers(0, 10**6))
def test_point_jacobian_by_the_graph(model: Model, seed: int) -> None:
    s = State.random(model)
    body = seed % len(model.bodies)
    root = [BASE, *model.path_to(body)][seed % (len(model.path_to(body)) + 1)]
    q, *_ = symbols(model)
    pose = poses(model, transforms(model, q), root)
    point = pose[body].point(POINT)
    linear, angular = point_jacobian(model, q, pose, body, point, root)
    rows = jacobian(list(point), q)
    still = set(range(model.nv)) - {model.bodies[k].v for k in model.path_to(body)}
    for i in range(3):
        for j in range(model.nq):
            if j in still:
                assert not isinstance(linear[i, j], Expr) and linear[i, j] == 0.0 and j not in rows[i]
            got, expected = evaluate([linear[i, j], rows[i].get(j, 0.0)], s.inputs)
            assert_close(got, expected, 1e-13, 1.0 + abs(float(expected)))
    # J qd is the velocity of the point; relative to the base it agrees with the recursion
    if root == BASE:
        X = transforms(model, s.q)
        v = velocities(model, X, s.q, s.qd)[body]
        R = real(poses(model, X)[body].R)
        J = real(evaluate([*flat(linear), *flat(angular)], s.inputs)).reshape(2, 3, model.nv)
        scale = 1.0 + float(np.abs(s.qd).sum())
        assert_close(J[0] @ s.qd, R @ real(v.v + cross(v.w, POINT)), 1e-13, scale)
        assert_close(J[1] @ s.qd, R @ real(v.w), 1e-13, scale)


@examples(20)
@given(trees())
def test_poses_are_products_of_transforms(model: Model) -> None:
    s = State.random(model)
    X = transforms(model, s.q)
    pose = poses(model, X)
    for k in range(len(model.bodies)):
        path = model.path_to(k)
        total = X[path[0]]
        for i in path[1:]:
            total = X[i] @ total
        assert_close(pose[k].R, total.E.T, 1e-14, 1.0)
        assert_close(pose[k].p, total.r, 1e-14, 1.0 + np.abs(real(total.r)).max())
        R = real(pose[k].R)
        assert_close(R @ R.T, np.eye(3), 1e-13)
        assert np.linalg.det(R) > 0.0
        frame = FixedFrame(k, POINT, identity())
        assert_close(pose[frame.body].point(frame.p), R @ real(POINT) + real(pose[k].p), 1e-14, 10.0)
        for root in path:
            below = poses(model, X, root)
            assert_close(pose[root].point(below[k].p), pose[k].p, 1e-13, 10.0)
            assert_close(real(pose[root].R) @ real(below[k].R), R, 1e-13)
            assert not set(below) & (set(path[: path.index(root)]) | {BASE})


@examples(10)
@given(trees(8))
def test_graph_gives_the_same_numbers(model: Model) -> None:
    s = State.random(model)
    q, qd, qdd, _ = symbols(model)
    size = 1.0 + float(np.abs(s.qd).sum())

    def everything(q: Any, qd: Any, qdd: Any) -> tuple[list[Any], list[Any]]:
        X = transforms(model, q)
        pose = poses(model, X)
        v, m = velocities(model, X, q, qd), motions(model, X, q, qd, qdd, model.gravity)
        low = [x for k in range(len(X)) for x in (*flat(pose[k].R), *pose[k].p)]
        return low, [x for k in range(len(X)) for x in (*v[k].w, *v[k].v, *m[k].w, *m[k].wd, *m[k].a)]

    for graph, numbers, scale in zip(everything(q, qd, qdd), everything(s.q, s.qd, s.qdd), (10.0, size**2)):
        assert_close(evaluate(graph, s.inputs), numbers, 1e-13, scale)


def test_common_ancestor_and_paths() -> None:
    from tests.random_models import random_tree

    for seed in range(10):
        model = random_tree(9, seed, branching=0.6)
        for a in range(9):
            assert model.path_to(a)[-1] == a
            assert model.bodies[model.path_to(a)[0]].parent == BASE
            for b in range(9):
                shared = [k for k in model.path_to(a) if k in model.path_to(b)]
                assert model.common_ancestor(a, b) == (shared[-1] if shared else BASE)

"""The algorithms on joints with several freedoms.

A universal, cylindrical or polar joint is two joints of one freedom with a massless body between them, in
the same coordinates: every quantity must agree. A spherical joint has nq != nv: the identities must hold.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from robodyn_cli.algorithms.aba import ArticulatedFactor, aba
from robodyn_cli.algorithms.composite import coriolis, crba
from robodyn_cli.algorithms.energy import gravity_energy, kinetic_energy
from robodyn_cli.algorithms.kinematics import (
    motions,
    point_jacobian,
    poses,
    slice_q,
    slice_v,
    transforms,
    velocities,
)
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.spatial.algebra import Transform, cross, rotation_to_z, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia
from tests.identities.trees import condition, flat
from tests.numeric import EPS, assert_close, real, vee
from tests.random_models import random_tree
from tests.wide_joints import wide_joints

N = 7
POINT = vector([0.3, -0.2, 0.5])
TURN_X = rotation_to_z((1.0, 0.0, 0.0))  # axes whose z is the old x


def wide(seed: int, kinds: tuple[str, ...]) -> Model:
    """A random tree whose every other joint is replaced by one of ``kinds``."""
    rng = np.random.default_rng(seed)
    model = random_tree(N, seed, armature=False)
    bodies, q, v = [], 0, 0
    for k, body in enumerate(model.bodies):
        joint = wide_joints[kinds[int(rng.integers(len(kinds)))]] if k % 2 == 0 else body.joint
        bodies.append(dataclasses.replace(body, joint=joint, q=q, v=v))
        q, v = q + joint.nq, v + joint.nv
    return dataclasses.replace(model, bodies=tuple(bodies), nq=q, nv=v)


def split(model: Model) -> Model:
    """The same mechanism with joints of one freedom only, in the same coordinates."""
    bodies: list[Body] = []
    at = {BASE: BASE}
    correction = {BASE: Transform.identity()}  # from the new body's frame to the old one's
    for k, body in enumerate(model.bodies):
        X_tree = body.X_tree @ correction[body.parent]
        second = Transform.identity()
        parts: list[tuple[str, Transform]] = [(body.joint.type, X_tree)]
        if body.joint.type in ("universal", "polar"):
            second = Transform(TURN_X.T, zeros(3))
            kind = "revolute" if body.joint.type == "universal" else "prismatic"
            parts = [("revolute", X_tree), (kind, second)]
        elif body.joint.type == "cylindrical":
            parts = [("revolute", X_tree), ("prismatic", Transform.identity())]
        parent = at[body.parent]
        for i, (kind, X) in enumerate(parts):
            last = i == len(parts) - 1
            inertia = body.inertia.to_parent(second.inverse()) if last else RigidInertia.zero()
            new = Body(f"{k}.{i}", f"{k}.{i}", joint_types[kind], parent, X, inertia, body.q + i, body.v + i)
            parent = len(bodies)
            bodies.append(new)
        at[k] = parent
        correction[k] = second.inverse()
    return dataclasses.replace(model, bodies=tuple(bodies))


def wide_state(model: Model, seed: int) -> tuple[Any, ...]:
    rng = np.random.default_rng(seed)
    q: list[float] = [0.0] * model.nq
    for b in model.bodies:
        start = vector(b.joint.neutral())
        q[b.q : b.q + b.joint.nq] = b.joint.integrate(start, vector(rng.normal(size=b.joint.nv).tolist()))
    return q, *(rng.normal(size=model.nv) * s for s in (1.5, 4.0, 20.0))


@pytest.mark.parametrize("seed", range(6))
def test_two_freedoms_are_two_joints(seed: int) -> None:
    model = wide(seed, ("universal", "cylindrical", "polar"))
    narrow = split(model)
    assert len(narrow.bodies) == model.nv > N
    q, qd, qdd, tau = wide_state(model, seed)
    g = model.gravity
    pairs = [
        lambda m: rnea(m, q, qd, qdd, g),
        lambda m: crba(m, q),
        lambda m: coriolis(m, q, qd),
        lambda m: [kinetic_energy(m, q, qd), gravity_energy(m, q, g)],
    ]
    for compute in pairs:
        assert_close(compute(model), compute(narrow), 1e-13)
    tolerance = 100 * EPS * condition(crba(model, q))
    assert_close(aba(model, q, qd, tau, g), aba(narrow, q, qd, tau, g), tolerance)
    assert_close(
        ArticulatedFactor(model, q).solve(tau), np.linalg.solve(real(crba(model, q)), tau), tolerance
    )


@pytest.mark.parametrize("kinds", [("spherical",), ("universal", "polar", "spherical")])
@pytest.mark.parametrize("seed", range(4))
def test_identities(seed: int, kinds: tuple[str, ...]) -> None:
    model = wide(seed, kinds)
    q, qd, qdd, tau = wide_state(model, seed)
    still = [0.0] * model.nv
    M, C = real(crba(model, q)), real(coriolis(model, q, qd))
    G = real(rnea(model, q, still, still, model.gravity))
    assert_close(M, M.T, 0.0)
    assert np.linalg.eigvalsh(M).min() > 0.0
    assert_close(M @ qdd + C @ qd + G, rnea(model, q, qd, qdd, model.gravity), 1e-13)
    assert_close(kinetic_energy(model, q, qd), 0.5 * qd @ M @ qd, 1e-13)
    tolerance = 100 * EPS * condition(M)
    assert_close(
        rnea(model, q, qd, aba(model, q, qd, tau, model.gravity), model.gravity), tau, tolerance, 100.0
    )


@pytest.mark.parametrize("kinds", [("spherical",), ("universal", "polar", "spherical")])
@pytest.mark.parametrize("seed", range(4))
def test_rates_by_the_graph(seed: int, kinds: tuple[str, ...]) -> None:
    """With q-dot = velocity_map(q, v): of M, of the energy, and of poses."""
    model = wide(seed, kinds)
    q, qd, qdd, _ = wide_state(model, seed)
    inputs = {"q": list(q), "qd": qd.tolist(), "qdd": qdd.tolist()}
    Q = model.graph.symbols([f"q{k}" for k in range(model.nq)], "q")
    V = model.graph.symbols([f"qd{k}" for k in range(model.nv)], "qd")
    A = model.graph.symbols([f"qdd{k}" for k in range(model.nv)], "qdd")
    Q_dot: list[Any] = [0.0] * model.nq
    for b in model.bodies:
        Q_dot[b.q : b.q + b.joint.nq] = b.joint.velocity_map(slice_q(b, Q), slice_v(b, V))
    rate = lambda outputs: directional(outputs, [*Q, *V], [*Q_dot, *A])  # noqa: E731
    number = lambda outputs: real(evaluate(outputs, inputs))  # noqa: E731

    M_dot = number(rate(flat(crba(model, Q)))).reshape(model.nv, model.nv)
    C = real(coriolis(model, q, qd))
    assert_close(C + C.T, M_dot, 1e-13, float(np.abs(real(crba(model, q))).max() * np.abs(qd).sum()))
    energy = kinetic_energy(model, Q, V) + gravity_energy(model, Q, model.gravity)
    tau = real(rnea(model, q, qd, qdd, model.gravity))
    assert_close(number(rate([energy]))[0], tau @ qd, 1e-12, float(np.abs(tau) @ np.abs(qd)))

    pose = poses(model, transforms(model, Q))
    X = transforms(model, q)
    here = poses(model, X)
    velocity, motion = velocities(model, X, q, qd), motions(model, X, q, qd, qdd)
    size = 1.0 + float(np.abs(qd).sum()) ** 2
    for k in range(N):
        spots = [*flat(pose[k].R), *pose[k].p, *pose[k].point(POINT)]
        first = rate(spots)
        R = number(spots)[:9].reshape(3, 3)
        d1, d2 = number(first), number(rate(first))
        assert_close(velocity[k].w, vee(R.T @ d1[:9].reshape(3, 3)), 1e-13, size)
        assert_close(velocity[k].v, R.T @ d1[9:12], 1e-13, size)
        assert_close(motion[k].wd, vee(R.T @ d2[:9].reshape(3, 3)), 1e-12, size)
        assert_close(motion[k].a, R.T @ d2[9:12], 1e-12, size)
        assert_close(motion[k].acceleration_of(POINT), R.T @ d2[12:], 1e-12, size)
        linear, angular = point_jacobian(model, q, here, k, here[k].point(POINT))
        assert_close(real(linear) @ qd, d1[12:], 1e-13, size)
        assert_close(R.T @ real(angular) @ qd, velocity[k].w, 1e-13, size)
        assert_close(R @ real(velocity[k].v + cross(velocity[k].w, POINT)), d1[12:], 1e-13, size)

"""Every joint of the registry against the checklist in ``joints/base.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.algorithms.rnea import joint_torque
from robodyn_cli.expr.graph import Expr, Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import BASE, Body
from robodyn_cli.spatial.algebra import Transform, matrix, rotation_about, vector
from robodyn_cli.spatial.inertia import ArticulatedInertia, RigidInertia
from tests.dense import twist, wrench
from tests.numeric import assert_close, first_derivative, real, vee
from tests.random_models import random_inertia
from tests.wide_joints import wide_joints

SAMPLES = range(5)
STEP = 0.02

# a joint of the tests stands in for what no registered one has: lever arms in S
JOINTS = {**joint_types, **wide_joints}
registered = pytest.mark.parametrize("name", sorted(JOINTS))
sampled = pytest.mark.parametrize("seed", SAMPLES)


def state(joint: Joint, seed: int) -> tuple[Any, Any, np.ndarray]:
    """A position on the joint's manifold, a velocity, and a generator for more."""
    rng = np.random.default_rng(seed)
    q = joint.integrate(vector(joint.neutral()), vector(rng.normal(size=joint.nv).tolist()))
    return q, vector(rng.normal(size=joint.nv).tolist()), rng


def pose(joint: Joint, q: Any) -> np.ndarray:
    """Axes and origin of the body frame in the frame before the joint, (3, 4)."""
    X = joint.transform(q)
    return np.column_stack([real(X.E).T, real(X.r)])


def body_velocity(joint: Joint, q: Any, v: Any) -> np.ndarray:
    """Angular and linear velocity (6,) in body coordinates when q moves with v: from poses alone."""
    rate = first_derivative(lambda t: pose(joint, joint.integrate(q, vector([t * x for x in v]))), STEP)
    R = pose(joint, q)[:, :3]
    return np.concatenate([vee(R.T @ rate[:, :3]), R.T @ rate[:, 3]])


@registered
def test_sizes_and_names(name: str) -> None:
    joint = JOINTS[name]
    assert joint.type == name
    assert joint.nv <= joint.nq and joint.nv <= 6
    assert len(joint.units) == joint.nq and len(joint.v_units) == joint.nv
    assert joint.quasi == (joint.units != joint.v_units)
    if joint.nv > 1 and name in joint_types:
        assert len(set(joint.names)) == joint.nq and len(set(joint.v_names)) == joint.nv
    assert len(joint.neutral()) == joint.nq
    q, v, _ = state(joint, 0)
    assert np.shape(q) == (joint.nq,)
    assert np.shape(joint.S(q)) == (6, joint.nv)
    assert np.shape(joint.S_rate(q, v)) == (6, joint.nv)
    assert np.shape(joint.velocity_map(q, v)) == (joint.nq,)
    if joint.nv:
        assert np.linalg.matrix_rank(real(joint.S(q))) == joint.nv


@registered
def test_neutral_position_is_the_identity(name: str) -> None:
    joint = JOINTS[name]
    assert_close(pose(joint, vector(joint.neutral())), np.eye(4)[:3], 1e-15)


@registered
@sampled
def test_transform_is_a_rigid_motion(name: str, seed: int) -> None:
    joint = JOINTS[name]
    E = real(joint.transform(state(joint, seed)[0]).E)
    assert_close(E @ E.T, np.eye(3), 1e-15)
    assert np.linalg.det(E) > 0.0


@registered
@sampled
def test_subspace_is_the_rate_of_the_transform(name: str, seed: int) -> None:
    """Check 1 and 2: S v is the velocity of the body frame, in body coordinates, angular rows first."""
    joint = JOINTS[name]
    q, v, _ = state(joint, seed)
    assert_close(real(joint.S(q)) @ real(v), body_velocity(joint, q, v), 1e-11, 1.0 + np.abs(real(v)).sum())


@registered
@sampled
def test_rate_is_that_of_the_subspace(name: str, seed: int) -> None:
    """Check 3: with v held constant, the components of the body's velocity change by S-dot v."""
    joint = JOINTS[name]
    q, v, _ = state(joint, seed)
    move = lambda t: joint.integrate(q, vector([t * x for x in v]))  # noqa: E731
    scale = 1.0 + float(np.abs(real(v)).sum()) ** 2
    assert_close(joint.S_rate(q, v), first_derivative(lambda t: joint.S(move(t)), STEP), 1e-11, scale)
    changed = first_derivative(lambda t: body_velocity(joint, move(t), v), STEP)
    assert_close(real(joint.S_rate(q, v)) @ real(v), changed, 1e-9, scale)


@registered
@sampled
def test_velocity_map_is_the_rate_of_the_position(name: str, seed: int) -> None:
    """Check 4."""
    joint = JOINTS[name]
    q, v, _ = state(joint, seed)
    rate = first_derivative(lambda t: joint.integrate(q, vector([t * x for x in v])), STEP)
    assert_close(joint.velocity_map(q, v), rate, 1e-11, 1.0 + np.abs(real(v)).sum())


@registered
@sampled
def test_integrate_and_difference_undo_each_other(name: str, seed: int) -> None:
    """Check 5, and that steps along one velocity add up."""
    joint = JOINTS[name]
    q, v, _ = state(joint, seed)
    if joint.quasi:  # less than half a turn: beyond it the way back is shorter
        v = vector([x * min(1.0, 3.0 / float(np.linalg.norm(real(v)))) for x in v])
    part = lambda t: vector([t * x for x in v])  # noqa: E731
    there = joint.integrate(q, v)
    assert_close(joint.difference(q, there), v, 1e-14, 2.0)
    assert_close(pose(joint, joint.integrate(q, joint.difference(q, there))), pose(joint, there), 1e-14, 2.0)
    assert_close(joint.difference(there, q), part(-1.0), 1e-14, 2.0)
    assert_close(joint.integrate(q, part(0.0)), q, 1e-15)
    assert_close(
        pose(joint, joint.integrate(joint.integrate(q, part(0.3)), part(0.7))), pose(joint, there), 1e-14, 2.0
    )


@registered
@sampled
def test_normalise_keeps_what_is_on_the_manifold(name: str, seed: int) -> None:
    joint = JOINTS[name]
    q, _, rng = state(joint, seed)
    assert_close(joint.normalise(q), q, 1e-15)
    disturbed = vector([float(x) for x in real(q) * (1.0 + 1e-6 * rng.normal())])
    once = joint.normalise(disturbed)
    assert_close(joint.normalise(once), once, 1e-15)
    E = real(joint.transform(once).E)
    assert_close(E @ E.T, np.eye(3), 1e-14)


@registered
@sampled
def test_power_of_the_torque_is_that_of_the_wrench(name: str, seed: int) -> None:
    """tau.v = n.w + f.v with the velocity taken from poses."""
    joint = JOINTS[name]
    q, v, rng = state(joint, seed)
    f = rng.normal(size=6)
    body = Body("b", "j", joint, BASE, Transform.identity(), RigidInertia.zero(), 0, 0)
    tau = real(joint_torque(body, q, wrench(f)))
    moved = body_velocity(joint, q, v)
    assert_close(tau @ real(v), f @ moved, 1e-11, 10.0 * (1.0 + np.abs(moved).max()))


@registered
@sampled
def test_inertia_counted_to_the_parent_is_neither_moved_nor_changed_by_the_joint(
    name: str, seed: int
) -> None:
    """Check 6: I' S = 0, and from the parent I' looks the same at every position."""
    joint = JOINTS[name]
    q, _, rng = state(joint, seed)
    m, c, I = random_inertia(rng)
    whole = RigidInertia.from_com(m, vector(c.tolist()), matrix(I.tolist()))
    parts = joint.divided(whole)
    if parts is None:
        assert joint.parent_inertia(whole) is None
        return
    stays, _ = parts
    total = parts[0] + parts[1]
    assert total.m == whole.m and (total.h == whole.h).all() and (total.I == whole.I).all()
    assert stays.m == 0.0 or not any(stays.I.flat)
    for moved in (parts[1], joint.parent_inertia(whole)):
        assert moved is not None
        inertia = ArticulatedInertia.from_rigid(moved)
        for column in real(joint.S(q)).T:
            assert_close(
                (inertia @ twist(column)).components, np.zeros(6), 1e-14, scale=float(np.abs(I).max())
            )
        here, neutral = (moved.to_parent(joint.transform(x)) for x in (q, vector(joint.neutral())))
        assert_close(here.m, neutral.m, 1e-14)
        assert_close(here.h, neutral.h, 1e-14, scale=1.0)
        assert_close(here.I, neutral.I, 1e-14, scale=1.0)


@registered
@sampled
def test_angle_is_that_of_the_turn_about_z(name: str, seed: int) -> None:
    """Check 8, beyond full turns too; a joint without an angle turns about more axes than z."""
    joint = JOINTS[name]
    _, v, _ = state(joint, seed)
    far = joint.integrate(vector(joint.neutral()), vector([9.0 * x for x in v]))
    angle = joint.angle(far)
    E = real(joint.transform(far).E)
    if angle is None:
        assert np.abs(E[:, 2] - [0.0, 0.0, 1.0]).max() > 1e-3, (
            "it keeps its z axis: ``angle`` can say how it turns"
        )
        return
    assert_close(E.T, real(rotation_about(2, float(angle))), 1e-14)
    assert angle == 0.0 or any(float(angle) == float(x) for x in far), (
        "the angle is a coordinate, without end"
    )


@registered
@sampled
def test_dh_variable_says_how_the_joint_moves(name: str, seed: int) -> None:
    """Check 9, the D-H variable: theta turns about z by q, d slides along z by q."""
    joint = JOINTS[name]
    q, _, _ = state(joint, seed)
    X = joint.transform(q)
    turn = float(q[0]) if joint.dh_variable == "theta" else 0.0
    slide = float(q[0]) if joint.dh_variable == "d" else 0.0
    found = np.allclose(real(X.E).T, real(rotation_about(2, turn))) and np.allclose(real(X.r), [0, 0, slide])
    assert found == bool(joint.dh_variable or joint.nv == 0)


@registered
@sampled
def test_expressions_give_the_same_and_keep_structural_zeros(name: str, seed: int) -> None:
    joint = JOINTS[name]
    q, v, _ = state(joint, seed)
    graph = Graph()
    Q = vector(graph.symbols([f"q{k}" for k in range(joint.nq)], "q"))
    V = vector(graph.symbols([f"v{k}" for k in range(joint.nv)], "v"))
    inputs = {"q": list(q), "v": list(v)}
    for symbolic, number in [
        (joint.transform(Q).E, joint.transform(q).E),
        (joint.transform(Q).r, joint.transform(q).r),
        (joint.S(Q), joint.S(q)),
        (joint.S_rate(Q, V), joint.S_rate(q, v)),
        (joint.velocity_map(Q, V), joint.velocity_map(q, v)),
        (joint.integrate(Q, V), joint.integrate(q, v)),
        (joint.normalise(Q), joint.normalise(q)),
        (joint.difference(vector(joint.neutral()), Q), joint.difference(vector(joint.neutral()), q)),
    ]:
        got = evaluate(list(np.ravel(symbolic)), inputs)
        assert_close(got, list(np.ravel(number)), 1e-14, 10.0)
        for e in np.ravel(symbolic):
            assert isinstance(e, (Expr, float)), "an entry is neither an expression nor a float"

"""The functions of a model against Pinocchio: random trees with rotors, full inertias and mixed joints."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np
import pytest

from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.over.crosscheck.engines import InPinocchio
from robodyn_cli.spatial.algebra import Array, matrix, vector
from robodyn_cli.torques.dynamics import open_problem
from robodyn_cli.works.functions.model import ModelFunctions
from tests.identities.trees import State
from tests.numeric import assert_close, first_derivative
from tests.oracle.test_joint_kinds import tree as tree_of_kinds
from tests.random_models import random_rotation, random_tree, shuffled

pin = pytest.importorskip("pinocchio")
STATES = 3
# Pinocchio has no derivatives of composite joints, which stand for the last two here
WITH_DERIVATIVES = [(), ("helical",), ("spherical",), ("floating",), ("spherical", "floating", "helical")]
KINDS = [*WITH_DERIVATIVES, ("universal",), ("cylindrical", "planar")]
kinds_and_seeds = pytest.mark.parametrize(
    ("kinds", "seed"), [(kinds, seed) for kinds in KINDS for seed in range(2)], ids=str
)


def model_of(kinds: tuple[str, ...], seed: int) -> Model:
    """A tree with these joints among revolute and prismatic ones, and a frame on its last body."""
    rng = np.random.default_rng([seed, 17])
    if kinds:
        model, _ = tree_of_kinds(kinds, seed, n=5)
        rotors = [tuple(rng.uniform(0, 0.2, body.joint.nv)) for body in model.bodies]
        bodies = tuple(dataclasses.replace(b, armature=r) for b, r in zip(model.bodies, rotors))
        model = dataclasses.replace(model, bodies=bodies)
    else:
        model = shuffled(random_tree(7, seed), seed)
    v_names = tuple(f"v{k}" for k in range(model.nv))
    frame = FixedFrame(
        len(model.bodies) - 1, vector(rng.normal(size=3).tolist()), matrix(random_rotation(rng).tolist())
    )
    return dataclasses.replace(
        model, q_names=tuple(f"q{k}" for k in range(model.nq)), v_names=v_names, v_units=("rad",) * model.nv,
        frames={"tool": frame, "ground": dataclasses.replace(frame, body=BASE)},
    )  # fmt: skip


class Case:
    """A model, its functions, the same in Pinocchio, and states."""

    def __init__(self, kinds: tuple[str, ...], seed: int) -> None:
        self.model = model_of(kinds, seed)
        self.functions = ModelFunctions(open_problem(self.model, "a tree"))
        self.pin = InPinocchio(self.model)
        self.manifold = Manifold(self.model)
        states = [State.random(self.model, k) for k in range(STATES)]
        neutral = self.manifold.neutral()
        self.q = np.array([self.manifold.integrate(neutral, s.qd) for s in states])
        self.v, self.a, self.tau = (np.array([getattr(s, n) for s in states]) for n in ("qd", "qdd", "tau"))

    def square(self, x: Array) -> Array:
        """Return a matrix (nv, nv) of Pinocchio in our order."""
        return self.pin.in_our_order(self.pin.in_our_order(np.array(x)).T).T


# functions are built once: the tests of one tree ask for the same ones
case_of = lru_cache(Case)


@kinds_and_seeds
def test_matrices_and_kinematics(kinds: tuple[str, ...], seed: int) -> None:
    c = case_of(kinds, seed)
    f, p = c.functions, c.pin
    M, G, cv = f.mass_matrix(c.q), f.gravity(c.q), f.coriolis_torques(c.q, c.v)
    tau, qdd = f.inverse_dynamics(c.q, c.v, c.a), f.forward_dynamics(c.q, c.v, c.tau)
    J, (position, rotation) = f.jacobian("tool", c.q), f.forward_kinematics("tool", c.q)
    com = f.centre_of_mass(c.q)
    rest = np.zeros(c.model.nv)
    for k in range(STATES):
        q, v = c.q[k], c.v[k]
        p.bring(q, v)
        mass, place = p.mass_matrix(), p.places([c.model.frames["tool"]])
        assert_close(M[k], mass, 1e-12)
        assert_close(G[k], p.torques(q, rest, rest), 1e-12)
        scale = float(np.abs(p.torques(q, v, c.a[k])).max())
        assert_close(cv[k], p.torques(q, v, rest) - p.torques(q, rest, rest), 1e-12, scale)
        assert_close(tau[k], p.torques(q, v, c.a[k]), 1e-12)
        assert_close(qdd[k], p.free_accelerations(q, v, c.tau[k]), 1e-14 * np.linalg.cond(M[k]) + 1e-12)
        assert_close(position[k], place.p[0], 1e-12)
        assert_close(rotation[k], place.R[0], 1e-12)
        assert_close(J[k], place.J[0], 1e-12)
        assert_close(com[k], pin.centerOfMass(p.model, p.data, p._to(q)[0]), 1e-12)
    assert not f.jacobian("ground", c.q).any()


@kinds_and_seeds
def test_coriolis_matrix(kinds: tuple[str, ...], seed: int) -> None:
    """C qd are the velocity terms; M-dot = C + C^T along the motion, so that M-dot - 2 C is skew."""
    c = case_of(kinds, seed)
    f = c.functions
    C = f.coriolis(c.q, c.v)
    scale = float(np.abs(f.mass_matrix(c.q)).max() * np.abs(c.v).sum(axis=1).max())
    assert_close(np.einsum("tij,tj->ti", C, c.v), f.coriolis_torques(c.q, c.v), 1e-12, scale * 10)
    for q, v, own in zip(c.q, c.v, C):
        rate = first_derivative(lambda t, q=q, v=v: f.mass_matrix(c.manifold.integrate(q, t * v)), 0.01)
        assert_close(own + own.T, rate, 1e-9, scale)
    if all(len(body.joint.units) == 1 for body in c.model.bodies):
        p = c.pin
        for q, v, own in zip(c.q, c.v, C):
            theirs = c.square(pin.computeCoriolisMatrix(p.model, p.data, *p._to(q, v)))
            assert_close(own, theirs, 1e-12, scale)


@pytest.mark.parametrize("kinds", WITH_DERIVATIVES, ids=str)
@pytest.mark.parametrize("seed", range(2))
def test_derivatives(kinds: tuple[str, ...], seed: int) -> None:
    c = case_of(kinds, seed)
    p = c.pin
    of_tau = c.functions.inverse_dynamics_derivatives(c.q, c.v, c.a)
    of_a = c.functions.forward_dynamics_derivatives(c.q, c.v, c.tau)
    for k in range(STATES):
        dq, dv, M = pin.computeRNEADerivatives(p.model, p.data, *p._to(c.q[k], c.v[k], c.a[k]))
        assert_close(of_tau.dq[k], c.square(dq), 1e-12)
        assert_close(of_tau.dqd[k], c.square(dv), 1e-12)
        M = np.triu(M) + np.triu(M, 1).T
        assert_close(of_tau.dqdd[k], c.square(M), 1e-12)
        pin.computeABADerivatives(p.model, p.data, *p._to(c.q[k], c.v[k], c.tau[k]))
        tolerance = 1e-13 * np.linalg.cond(M) + 1e-12
        inverse = np.triu(p.data.Minv) + np.triu(p.data.Minv, 1).T
        for own, theirs in zip((of_a.dq, of_a.dqd, of_a.dtau), (p.data.ddq_dq, p.data.ddq_dv, inverse)):
            assert_close(own[k], c.square(theirs), tolerance)


@kinds_and_seeds
def test_derivatives_are_those_of_the_functions(kinds: tuple[str, ...], seed: int) -> None:
    """By differences of order 8 along the joints' manifolds, for every kind of joint."""
    c = case_of(kinds, seed)
    f, q, v, a, tau = c.functions, c.q[0], c.v[0], c.a[0], c.tau[0]
    of_tau, of_a = f.inverse_dynamics_derivatives(q, v, a), f.forward_dynamics_derivatives(q, v, tau)
    accelerations = f.forward_dynamics(q, v, tau)
    for k, unit in enumerate(np.eye(c.model.nv)):
        for function, x, found, size in (
            (f.inverse_dynamics, a, of_tau, np.abs(f.inverse_dynamics(q, v, a)).max()),
            (f.forward_dynamics, tau, of_a, np.abs(accelerations).max()),
        ):
            by_q = first_derivative(
                lambda t, g=function, x=x, u=unit: g(c.manifold.integrate(q, t * u), v, x), 0.01
            )
            by_v = first_derivative(lambda t, g=function, x=x, u=unit: g(q, v + t * u, x), 0.1)
            assert_close(found.dq[:, k], by_q, 1e-7, size)
            assert_close(found.dqd[:, k], by_v, 1e-9, size)


@kinds_and_seeds
def test_regressor(kinds: tuple[str, ...], seed: int) -> None:
    """Y p are the torques of rigid bodies and rotors; of a tree with other masses too."""
    c = case_of(kinds, seed)
    Y, known = c.functions.regressor(c.q, c.v, c.a), c.functions.inertial_parameters
    assert Y.shape == (STATES, c.model.nv, len(known.names)) and len(set(known.names)) == len(known.names)
    assert_close(Y @ known.values, c.functions.inverse_dynamics(c.q, c.v, c.a), 1e-12)
    other = model_of(kinds, seed + 5)
    bodies = tuple(
        dataclasses.replace(b, inertia=o.inertia, parts=()) for b, o in zip(c.model.bodies, other.bodies)
    )
    heavier = ModelFunctions(open_problem(dataclasses.replace(c.model, bodies=bodies), "a tree"))
    assert_close(Y @ heavier.inertial_parameters.values, heavier.inverse_dynamics(c.q, c.v, c.a), 1e-12)

"""Against MuJoCo: dynamics, energies and frames of random trees."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.algorithms.aba import ArticulatedFactor, aba
from robodyn_cli.algorithms.composite import coriolis, crba
from robodyn_cli.algorithms.energy import gravity_energy, kinetic_energy
from robodyn_cli.algorithms.kinematics import (
    motions,
    point_jacobian,
    poses,
    transforms,
    velocities,
)
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.model.model import BASE
from robodyn_cli.spatial.algebra import cross
from tests.engines import MujocoModel, to_mujoco
from tests.identities.trees import condition, torque_scale
from tests.numeric import EPS, assert_close, real
from tests.oracle.cases import cases, tree

mujoco = pytest.importorskip("mujoco")


def mass_matrix(m: MujocoModel) -> np.ndarray:
    n = m.model.nv
    columns = []
    for unit in np.eye(n):
        column = np.zeros(n)
        mujoco.mj_mulM(m.model, m.data, column, unit)
        columns.append(column)
    return m.ours_square(np.stack(columns, axis=1))


@cases
def test_torques(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    m = to_mujoco(model)
    still, scale = [0.0] * n, torque_scale(model, s)
    m.set_state(s.q, s.qd)
    assert_close(rnea(model, s.q, s.qd, still, model.gravity), m.ours(m.data.qfrc_bias), 1e-12, scale)
    m.data.qacc[:] = m.to(s.qdd)
    mujoco.mj_inverse(m.model, m.data)
    assert_close(rnea(model, s.q, s.qd, s.qdd, model.gravity), m.ours(m.data.qfrc_inverse), 1e-12, scale)
    m.set_state(s.q, still)
    assert_close(rnea(model, s.q, still, still, model.gravity), m.ours(m.data.qfrc_bias), 1e-12, scale)


@cases
def test_mass_matrix_and_accelerations(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    m = to_mujoco(model)
    m.data.qfrc_applied[:] = m.to(s.tau)
    m.set_state(s.q, s.qd)
    M = mass_matrix(m)
    assert_close(crba(model, s.q), M, 1e-12)
    tolerance = max(1e-12, 20 * EPS * condition(M))
    expected = m.ours(m.data.qacc)
    qdd = aba(model, s.q, s.qd, s.tau, model.gravity)
    assert_close(qdd, expected, tolerance, np.abs(expected).max() + 1.0)
    solved = np.zeros((1, n))
    mujoco.mj_solveM(m.model, m.data, solved, m.to(s.tau)[None, :])
    assert_close(ArticulatedFactor(model, s.q).solve(s.tau), m.ours(solved[0]), tolerance)


@cases
def test_velocity_terms(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    m = to_mujoco(model)
    m.model.opt.gravity[:] = 0.0
    m.set_state(s.q, s.qd)
    scale = torque_scale(model, s)
    assert_close(real(coriolis(model, s.q, s.qd)) @ s.qd, m.ours(m.data.qfrc_bias), 1e-12, scale)


@cases
def test_energies(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    m = to_mujoco(model)
    m.set_state(s.q, s.qd)
    potential, kinetic = m.data.energy
    assert_close(kinetic_energy(model, s.q, s.qd), kinetic, 1e-12)
    assert_close(gravity_energy(model, s.q, model.gravity), potential, 1e-12, max(10.0 * n, abs(potential)))


@cases
def test_frames(n: int, seed: int) -> None:
    """Positions, axes, velocities and accelerations of sites, and the Jacobians of their points."""
    model, s = tree(n, seed)
    m = to_mujoco(model)
    m.set_state(s.q, s.qd)
    m.data.qacc[:] = m.to(s.qdd)
    mujoco.mj_rnePostConstraint(m.model, m.data)
    X = transforms(model, s.q)
    pose = poses(model, X)
    velocity = velocities(model, X, s.q, s.qd)
    # MuJoCo's accelerations hold gravity's upward acceleration, as an accelerometer would read it
    motion = motions(model, X, s.q, s.qd, s.qdd, model.gravity)
    size = 1.0 + float(np.abs(s.qd).sum())
    hurry = size**2 + float(np.abs(s.qdd).sum())
    for name, frame in model.frames.items():
        site = m.model.site(name).id
        here = pose[frame.body].point(frame.p)
        assert_close(here, m.data.site_xpos[site], 1e-12, 10.0)
        axes = real(pose[frame.body].R) @ real(frame.R)
        assert_close(axes, m.data.site_xmat[site].reshape(3, 3), 1e-12)
        if frame.body == BASE:
            continue
        R, v, a = real(pose[frame.body].R), velocity[frame.body], motion[frame.body]
        got = np.zeros(6)
        mujoco.mj_objectVelocity(m.model, m.data, mujoco.mjtObj.mjOBJ_SITE, site, got, 0)
        assert_close(R @ real(v.w), got[:3], 1e-12, size)
        assert_close(R @ real(v.v + cross(v.w, frame.p)), got[3:], 1e-12, 10 * size)
        mujoco.mj_objectAcceleration(m.model, m.data, mujoco.mjtObj.mjOBJ_SITE, site, got, 0)
        assert_close(R @ real(a.wd), got[:3], 1e-12, hurry)
        assert_close(R @ real(a.acceleration_of(frame.p)), got[3:], 1e-12, 10 * hurry)
        jacp, jacr = np.zeros((3, n)), np.zeros((3, n))
        mujoco.mj_jac(m.model, m.data, jacp, jacr, real(here), m.body[frame.body])
        linear, angular = point_jacobian(model, s.q, pose, frame.body, here)
        assert_close(linear, m.ours(jacp), 1e-12, 10.0)
        assert_close(angular, m.ours(jacr), 1e-12)

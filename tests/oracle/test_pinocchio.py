"""Against Pinocchio: dynamics, energies, frames and derivatives of random trees."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.algorithms.aba import aba
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
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.model.model import BASE
from robodyn_cli.spatial.algebra import cross
from tests.engines import to_pinocchio
from tests.identities.trees import condition, symbols, torque_scale
from tests.numeric import EPS, assert_close, real
from tests.oracle.cases import cases, tree

pin = pytest.importorskip("pinocchio")


@cases
def test_torques(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    p = to_pinocchio(model)
    q, qd, qdd = p.to(s.q), p.to(s.qd), p.to(s.qdd)
    still, scale = [0.0] * n, torque_scale(model, s)
    expected = p.ours(pin.rnea(p.model, p.data, q, qd, qdd))
    assert_close(rnea(model, s.q, s.qd, s.qdd, model.gravity), expected, 1e-12, scale)
    expected = p.ours(pin.nonLinearEffects(p.model, p.data, q, qd))
    assert_close(rnea(model, s.q, s.qd, still, model.gravity), expected, 1e-12, scale)
    expected = p.ours(pin.computeGeneralizedGravity(p.model, p.data, q))
    assert_close(rnea(model, s.q, still, still, model.gravity), expected, 1e-12)


@cases
def test_mass_matrix_and_accelerations(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    p = to_pinocchio(model)
    M = pin.crba(p.model, p.data, p.to(s.q))
    M = p.ours_square(np.triu(M) + np.triu(M, 1).T)
    assert_close(crba(model, s.q), M, 1e-12)
    expected = p.ours(pin.aba(p.model, p.data, p.to(s.q), p.to(s.qd), p.to(s.tau)))
    qdd = aba(model, s.q, s.qd, s.tau, model.gravity)
    assert_close(qdd, expected, max(1e-12, 20 * EPS * condition(M)), np.abs(expected).max() + 1.0)


@cases
def test_coriolis(n: int, seed: int) -> None:
    """Entry by entry: Pinocchio's factorisation is that of Christoffel's symbols too."""
    model, s = tree(n, seed)
    p = to_pinocchio(model)
    C = coriolis(model, s.q, s.qd)
    expected = p.ours_square(pin.computeCoriolisMatrix(p.model, p.data, p.to(s.q), p.to(s.qd)))
    scale = float(np.abs(crba(model, s.q)).max() * np.abs(s.qd).sum())
    assert_close(C, expected, 1e-12, scale)


@cases
def test_energies(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    p = to_pinocchio(model)
    expected = pin.computeKineticEnergy(p.model, p.data, p.to(s.q), p.to(s.qd))
    assert_close(kinetic_energy(model, s.q, s.qd), expected, 1e-12)
    expected = pin.computePotentialEnergy(p.model, p.data, p.to(s.q))
    size = 10.0 * n
    assert_close(gravity_energy(model, s.q, model.gravity), expected, 1e-12, max(size, abs(expected)))


@cases
def test_frames(n: int, seed: int) -> None:
    """Positions, axes, velocities, classical accelerations and Jacobians of frames fixed to bodies."""
    model, s = tree(n, seed)
    p = to_pinocchio(model)
    q, qd, qdd = p.to(s.q), p.to(s.qd), p.to(s.qdd)
    pin.forwardKinematics(p.model, p.data, q, qd, qdd)
    pin.computeJointJacobians(p.model, p.data, q)
    pin.updateFramePlacements(p.model, p.data)
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    X = transforms(model, s.q)
    pose = poses(model, X)
    velocity = velocities(model, X, s.q, s.qd)
    motion = motions(model, X, s.q, s.qd, s.qdd)
    size = 1.0 + float(np.abs(s.qd).sum())
    for name, frame in model.frames.items():
        place = p.model.getFrameId(name)
        where = p.data.oMf[place]
        assert_close(pose[frame.body].point(frame.p), where.translation, 1e-12, 10.0)
        assert_close(real(pose[frame.body].R) @ real(frame.R), where.rotation, 1e-12)
        if frame.body == BASE:
            continue
        R, v, m = real(pose[frame.body].R), velocity[frame.body], motion[frame.body]
        twist = pin.getFrameVelocity(p.model, p.data, place, aligned)
        assert_close(R @ real(v.w), twist.angular, 1e-12, size)
        assert_close(R @ real(v.v + cross(v.w, frame.p)), twist.linear, 1e-12, 10 * size)
        rate = pin.getFrameClassicalAcceleration(p.model, p.data, place, aligned)
        assert_close(R @ real(m.wd), rate.angular, 1e-12, size**2 + np.abs(s.qdd).sum())
        assert_close(
            R @ real(m.acceleration_of(frame.p)), rate.linear, 1e-12, 10 * (size**2 + np.abs(s.qdd).sum())
        )
        J = p.ours(pin.getFrameJacobian(p.model, p.data, place, aligned).reshape(6, n))
        linear, angular = point_jacobian(model, s.q, pose, frame.body, pose[frame.body].point(frame.p))
        assert_close(linear, J[:3], 1e-12, 10.0)
        assert_close(angular, J[3:], 1e-12)


def _dense(rows: list[dict[int, Any]], n: int, inputs: dict[str, list[float]]) -> np.ndarray:
    out = np.zeros((len(rows), n))
    for row, entries in zip(out, rows):
        for k, value in zip(entries, evaluate(list(entries.values()), inputs)):
            row[k] = value
    return out


@pytest.mark.parametrize(("n", "seed"), [(2, 0), (4, 1), (6, 2), (6, 3)])
def test_derivatives_of_the_graph(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    p = to_pinocchio(model)
    q, qd, qdd, tau = symbols(model)
    torque = jacobian(list(rnea(model, q, qd, qdd, model.gravity)), [*q, *qd, *qdd])
    got = _dense(torque, 3 * n, s.inputs)
    expected = pin.computeRNEADerivatives(p.model, p.data, p.to(s.q), p.to(s.qd), p.to(s.qdd))
    for k in range(3):
        assert_close(got[:, k * n : (k + 1) * n], p.ours_square(_symmetric(expected[k], k == 2)), 1e-12)
    motion = jacobian(list(aba(model, q, qd, tau, model.gravity)), [*q, *qd, *tau])
    got = _dense(motion, 3 * n, s.inputs)
    pin.computeABADerivatives(p.model, p.data, p.to(s.q), p.to(s.qd), p.to(s.tau))
    tolerance = max(1e-12, 100 * EPS * condition(crba(model, s.q)))
    for k, block in enumerate((p.data.ddq_dq, p.data.ddq_dv, p.data.Minv)):
        assert_close(got[:, k * n : (k + 1) * n], p.ours_square(_symmetric(block, k == 2)), tolerance)


def _symmetric(block: np.ndarray, upper_only: bool) -> np.ndarray:
    """Fill the lower triangle where Pinocchio computes the upper one."""
    return np.triu(block) + np.triu(block, 1).T if upper_only else block

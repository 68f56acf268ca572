"""Joint forces against Pinocchio, and against the balance of momentum of every body and of the whole."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robodyn_cli.algorithms.constraints import LoopRows
from robodyn_cli.algorithms.kinematics import motions, poses, transforms, velocities
from robodyn_cli.algorithms.reactions import Reactions, loop_wrench, reactions
from robodyn_cli.algorithms.rnea import joint_torque, rnea
from robodyn_cli.loops.registry import loop_types
from robodyn_cli.model.model import BASE, FixedFrame, Loop, Model
from robodyn_cli.spatial.algebra import matrix, vector
from tests.engines import mass_properties, to_pinocchio
from tests.identities.trees import State, torque_scale
from tests.numeric import assert_close, first_derivative, real
from tests.oracle.cases import cases, tree
from tests.random_models import random_rotation


def find(model: Model, s: State, lam: dict[str, float]) -> Reactions:
    X = transforms(model, s.q)
    return reactions(model, X, motions(model, X, s.q, s.qd, s.qdd, model.gravity), lam)


@cases
def test_joint_forces_of_pinocchio(n: int, seed: int) -> None:
    pin = pytest.importorskip("pinocchio")
    model, s = tree(n, seed)
    p = to_pinocchio(model)
    pin.rnea(p.model, p.data, p.to(s.q), p.to(s.qd), p.to(s.qdd))
    scale = torque_scale(model, s)
    for k, found in enumerate(find(model, s, {}).joints):
        assert_close(found.f, p.data.f[p.body[k]].linear, 1e-12, scale)
        assert_close(found.n, p.data.f[p.body[k]].angular, 1e-12, scale)


def closed(seed: int) -> tuple[Model, dict[str, float]]:
    """Return a random tree with a closure of each kind between any two bodies, and multipliers for the rows.

    The points of a closure meet in the random state, as in a closed mechanism.
    """
    rng = np.random.default_rng(seed)
    model, _ = tree(8, seed)
    pose = poses(model, transforms(model, State.random(model, seed).q))

    def frame(body: int) -> FixedFrame:
        return FixedFrame(body, vector(rng.normal(size=3).tolist()), matrix(random_rotation(rng).tolist()))

    loops = []
    for kind, cls in loop_types.items():
        given = {"name": kind, "type": kind, "between": ("a", "b")}
        names = [f.name for f in dataclasses.fields(cls)]
        for key, value in (("axis", (0.3, -1.0, 0.5)), ("axis2", (1.0, 0.2, -0.7)), ("length", 0.8)):
            if key in names:
                given[key] = value
        bodies = rng.choice(np.arange(BASE, 8), 2, replace=False)
        first, second = (frame(int(body)) for body in bodies)
        other = pose[second.body]
        meets = real(other.R).T @ (real(pose[first.body].point(first.p)) - real(other.p))
        second = dataclasses.replace(second, p=vector(meets.tolist()))
        loops.append(Loop(kind, cls(**given), first, second))
    model = dataclasses.replace(model, loops=tuple(loops))
    lam = {}
    for loop in loops:
        X = transforms(model, [0.0] * 8)
        for row in LoopRows(model, X, [0.0] * 8, [0.0] * 8).of(loop):
            lam[row.name] = float(rng.normal() * 10)
    return model, lam


@pytest.mark.parametrize("seed", range(4))
def test_closures_do_the_work_of_their_multipliers(seed: int) -> None:
    """S^T f of each joint is M qdd + h - Psi^T lambda: wrenches and constraint rows are the same thing."""
    model, lam = closed(seed)
    s = State.random(model, seed)
    X = transforms(model, s.q)
    expected = real(rnea(model, s.q, s.qd, s.qdd, model.gravity))
    for loop in model.loops:
        for row in LoopRows(model, X, s.q, s.qd).of(loop):
            expected = expected - real(row.psi) * lam[row.name]
    found = find(model, s, lam)
    for k, body in enumerate(model.bodies):
        rotor = float(body.armature) * s.qdd[body.v]
        own = real(joint_torque(body, s.q[body.q : body.q + 1], found.joints[k]))
        assert_close(own + rotor, expected[body.v : body.v + 1], 1e-11, np.abs(expected).max())


@pytest.mark.parametrize("seed", range(3))
def test_every_body_and_the_whole_are_in_balance(seed: int) -> None:
    """Rates of momentum by differences along a motion are the sum of all forces, body by body and in all."""
    model, lam = closed(seed)
    s = State.random(model, seed)
    qd, qdd = real(s.qd), real(s.qdd)

    def momenta(t: float) -> np.ndarray:
        """Momentum and angular momentum about the base's origin of each body, base axes."""
        q, v = real(s.q) + qd * t + qdd * t**2 / 2, qd + qdd * t
        X = transforms(model, q.tolist())
        pose, twist = poses(model, X), velocities(model, X, q.tolist(), v.tolist())
        rows = []
        for k, body in enumerate(model.bodies):
            m, c, I = mass_properties(body)
            R, w = real(pose[k].R), real(twist[k].w)
            p = m * R @ (real(twist[k].v) + np.cross(w, c))
            rows.append([*p, *(R @ I @ w + np.cross(real(pose[k].point(vector(c.tolist()))), p))])
        return np.array(rows)

    rate = first_derivative(momenta, 2e-3)
    found = find(model, s, lam)
    X = transforms(model, s.q)
    pose = poses(model, X)
    force = {k: np.zeros(6) for k in range(BASE, len(model.bodies))}

    def act(body: int, n: np.ndarray, f: np.ndarray, at: np.ndarray) -> None:
        """Let a force f and a moment n about a point act on a body; all in base axes."""
        force[body] = force[body] + np.concatenate([f, n + np.cross(at, f)])

    for k, body in enumerate(model.bodies):
        m, c, _ = mass_properties(body)
        act(k, np.zeros(3), m * real(model.gravity), real(pose[k].point(vector(c.tolist()))))
        n, f = (real(pose[k].R) @ real(x) for x in (found.joints[k].n, found.joints[k].f))
        act(k, n, f, real(pose[k].p))
        act(body.parent, -n, -f, real(pose[k].p))
    for loop in model.loops:
        wrench = loop_wrench(model, loop, X, lam)
        R = real(pose[wrench.root].R)
        for frame, own in ((loop.first, wrench.on_first), (loop.second, wrench.on_second)):
            act(frame.body, R @ real(own.n), R @ real(own.f), real(pose[frame.body].point(frame.p)))
    size = max(float(np.abs(x).max()) for x in force.values())
    for k in range(len(model.bodies)):
        assert_close(force[k], rate[k], 1e-8, size)
    # what the ground gives is what the base passes on
    ground = np.concatenate([real(found.base.f), real(found.base.n)])
    assert_close(ground, -force[BASE], 1e-12, size)
    weight = sum(mass_properties(b)[0] for b in model.bodies) * real(model.gravity)
    moment = sum(
        np.cross(
            real(pose[k].point(vector(mass_properties(b)[1].tolist()))),
            mass_properties(b)[0] * real(model.gravity),
        )
        for k, b in enumerate(model.bodies)
    )
    assert_close(ground + np.concatenate([weight, moment]), rate.sum(axis=0), 1e-8, size)

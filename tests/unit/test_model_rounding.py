"""Constants of a model against 60 digits: bodies far from their joints, masses and inertias of all sizes."""

from __future__ import annotations

import dataclasses
from typing import Any

import mpmath
import numpy as np
import pytest

from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.model.model import Model
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.spatial.algebra import Transform, matrix, zeros
from robodyn_cli.spatial.double_double import DoubleDouble, orthonormal, two_product, two_sum
from robodyn_cli.spatial.inertia import RigidInertia
from robodyn_cli.works.simulate import simulate

mp = mpmath.mp.clone()
mp.dps = 60
exact = np.frompyfunc(mp.mpf, 1, 1)


def far_bodies(seed: int) -> str:
    """A chain of hinges whose bodies lie far along the axes, light or heavy, with small inertias."""
    rng = np.random.default_rng(seed)
    joints, links = [], []
    for k in range(int(rng.integers(2, 5))):
        axis = np.eye(3)[int(rng.integers(3))]
        com = axis * 10.0 ** rng.uniform(0, 3) * rng.choice([-1, 1]) + (k % 2) * rng.normal(size=3) * 1e-3
        a, b, c = 10.0 ** rng.uniform(-4, -3) * rng.uniform(1.0, 1.5, 3)
        origin = (rng.normal(size=3) * 0.5).tolist()
        joints.append(f"{{name: j{k}, type: revolute, axis: {axis.tolist()}, origin: {{xyz: {origin}}}}}")
        links.append(
            f"{{name: l{k}, mass: {10.0 ** rng.uniform(-1, 1)}, com: {com.tolist()}, "
            f"inertia: {{xx: {a}, yy: {b}, zz: {c}}}}}"
        )
    return f"""
schema: 1
gravity: [0, 0, 0]
robot: {{joints: [{", ".join(joints)}], links: [{", ".join(links)}]}}
"""


def exact_parts(model: Model, q: Any) -> tuple[Model, list[Transform]]:
    """The model of a chain of hinges with inertias of 60 digits, from the parts of the bodies, and its transforms."""
    X, bodies = [], []
    for body, angle in zip(model.bodies, q):
        c, s = mp.cos(angle), mp.sin(angle)
        turn = matrix([[c, s, mp.mpf(0)], [-s, c, mp.mpf(0)], [mp.mpf(0), mp.mpf(0), mp.mpf(1)]])
        X.append(Transform(turn, zeros(3)) @ Transform(exact(body.X_tree.E), exact(body.X_tree.r)))
        inertia = RigidInertia.zero()
        for part in body.parts:
            E, r = exact(part.frame.E), exact(part.frame.r)
            own = RigidInertia.from_com(mp.mpf(part.m), exact(part.c), exact(part.I_com))
            inertia = inertia + own.to_parent(Transform(E, r))
        bodies.append(dataclasses.replace(body, inertia=inertia))
    return dataclasses.replace(model, bodies=tuple(bodies)), X


def exact_inverse_dynamics(model: Model, q: Any, v: Any, a: Any) -> Any:
    """M a + C v (nv,) with 60 digits."""
    whole, X = exact_parts(model, q)
    return rnea(whole, q, v, a, None, X)


def exact_accelerations(model: Model, q: Any, v: Any) -> list[float]:
    """M^-1 (-C v) with 60 digits."""
    q, v = (exact(np.array(x, dtype=object)) for x in (q, v))
    rest = exact(zeros(model.nv))
    bias = exact_inverse_dynamics(model, q, v, rest)
    M = mp.matrix(model.nv, model.nv)
    for k in range(model.nv):
        unit = rest.copy()
        unit[k] = mp.mpf(1)
        column = exact_inverse_dynamics(model, q, rest, unit)
        for i in range(model.nv):
            M[i, k] = column[i]
    return [float(x) for x in mp.lu_solve(M, mp.matrix([-x for x in bias]))]


def test_accelerations_of_bodies_far_from_their_joints() -> None:
    """Doubles of the bodies' own inertias lose three to eight digits here, unless the geometry itself loses more."""
    before, after = [], []
    for seed in range(20):
        problem = Problem(load_scene_text(far_bodies(seed)))
        assert problem.rigid is not problem.model
        plain = Problem(problem.scene)
        plain.__dict__["rigid"] = plain.model
        rng = np.random.default_rng(seed)
        q, v = rng.normal(size=problem.model.nv).tolist(), rng.normal(size=problem.model.nv).tolist()
        asked = np.array(exact_accelerations(problem.model, q, v))
        before.append(np.abs(accelerations(plain, q, v) - asked).max() / np.abs(asked).max())
        after.append(np.abs(accelerations(problem, q, v) - asked).max() / np.abs(asked).max())
    assert np.median(after) < 1e-13 < 1e-11 < np.median(before)
    assert all(a < 4.0 * b + 1e-12 for a, b in zip(after, before))


def accelerations(problem: Problem, q: list[float], v: list[float]) -> np.ndarray:
    return np.array(evaluate(list(problem.forward.qdd), {"q": q, "v": v, "t": [0.0], "p": []}))


def test_a_plate_far_from_its_hinge() -> None:
    """Only the difference of the plate's moments couples the two hinges; 60 digits give the motion."""
    found = simulate(
        load_scene_text("""
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: qA, type: revolute, axis: [1, 0, 0]}
    - {name: qB, type: revolute, axis: [0, 0, 1]}
  links:
    - {name: rod, mass: 0, com: [0, 0, 0], inertia: {xx: 1}}
    - {name: plate, mass: 1, com: [0, 0, -100], inertia: {xx: 2e-4, yy: 1e-4, zz: 2e-4}}
initial: {q: {qA: 0, qB: 0.3}, qd: {qA: 2, qB: 0}}
simulate: {duration: 10, samples: 11}
""")
    )
    assert np.abs(found["q"][-1] - [19.999999991553964853, 0.092917883265560242909]).max() < 1e-13


@pytest.mark.parametrize("seed", range(20))
def test_sums_and_products_of_two_doubles_are_exact_to_32_digits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = (rng.normal(size=3) * 10.0 ** rng.uniform(-8, 8, 3)).tolist()
    s, e = two_sum(a, b)
    assert mp.mpf(s) + e == mp.mpf(a) + b
    p, e = two_product(a, b)
    assert mp.mpf(p) + e == mp.mpf(a) * b
    found = (DoubleDouble(a) * b + c) * a - b
    asked = (mp.mpf(a) * b + c) * a - b
    assert abs(found.high + mp.mpf(found.low) - asked) < 1e-29 * (
        abs(mp.mpf(a) * a * b) + abs(c * a) + abs(b)
    )


def test_a_rotation_made_orthonormal() -> None:
    R = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    E = orthonormal(matrix(R.tolist()))
    E = np.frompyfunc(lambda x: x.high + mp.mpf(x.low), 1, 1)(E)
    assert max(abs(x) for x in (E.T @ E - exact(np.eye(3))).flat) < 1e-30

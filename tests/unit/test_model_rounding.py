"""Constants of a model against 60 digits: bodies far from their joints, masses and inertias of all sizes."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np

from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.model.model import Model
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.spatial.algebra import Transform, matrix, zeros
from robodyn_cli.spatial.inertia import RigidInertia

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


def exact_inverse_dynamics(model: Model, q: Any, v: Any, a: Any) -> Any:
    """M a + C v (nv,) with 60 digits, from the parts of the bodies."""
    import dataclasses

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
    return rnea(dataclasses.replace(model, bodies=tuple(bodies)), q, v, a, None, X)


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


def error_of(model: Model, problem: Problem, q: list[float], v: list[float]) -> float:
    found = evaluate(list(problem.forward.qdd), {"q": q, "v": v, "t": [0.0], "p": []})
    asked = np.array(exact_accelerations(model, q, v))
    return float(np.abs(np.array(found) - asked).max() / np.abs(asked).max())


if __name__ == "__main__":
    for seed in range(20):
        rng = np.random.default_rng(seed + 1000)
        scene = load_scene_text(far_bodies(seed))
        out = []
        for on in (True, False):
            p = Problem(scene)
            if not on:
                p.__dict__["rigid"] = p.model
            r2 = np.random.default_rng(seed)
            n = p.model.nv
            out.append(error_of(p.model, p, r2.normal(size=n).tolist(), r2.normal(size=n).tolist()))
        print(seed, n, p.model is Problem(scene).rigid, out)

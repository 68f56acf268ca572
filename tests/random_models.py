"""Random trees with full asymmetric inertias, offset centres of mass and mixed joint axes."""

from __future__ import annotations

import dataclasses

import numpy as np

from robodyn_cli.expr.graph import Graph
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.spatial.algebra import Transform, matrix, vector
from robodyn_cli.spatial.inertia import RigidInertia


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def random_inertia(rng: np.random.Generator) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass and a physically possible inertia about it."""
    points = rng.normal(size=(8, 3)) * rng.uniform(0.05, 0.3, 3)
    weights = rng.uniform(0.1, 1.0, 8)
    m = weights.sum()
    c = weights @ points / m
    r = points - c
    I = sum(w * (x @ x * np.eye(3) - np.outer(x, x)) for w, x in zip(weights, r))
    return m, c + rng.normal(size=3) * 0.1, I


def random_tree(
    n: int,
    seed: int,
    branching: float = 0.3,
    kinds: tuple[str, ...] = ("revolute", "prismatic"),
    armature: bool = True,
) -> Model:
    """Build a random tree; ``branching`` is the chance that a body does not hang on the one before it."""
    rng = np.random.default_rng(seed)
    bodies = []
    for k in range(n):
        parent = k - 1
        if k and rng.uniform() < branching:
            parent = int(rng.integers(-1, k))
        m, c, I = random_inertia(rng)
        placement = Transform(
            matrix(random_rotation(rng).tolist()), vector((rng.normal(size=3) * 0.4).tolist())
        )
        kind = kinds[int(rng.integers(len(kinds)))]
        bodies.append(
            Body(
                name=f"link{k}",
                joint_name=f"q{k}",
                joint=joint_types[kind],
                parent=parent if k else BASE,
                X_tree=placement,
                inertia=RigidInertia.from_com(m, vector(c.tolist()), matrix(I.tolist())),
                q=k,
                v=k,
                armature=float(rng.uniform(0, 0.2)) if armature else 0.0,
            )
        )
    names = tuple(b.joint_name for b in bodies)
    gravity = rng.normal(size=3) * 9.0
    return Model(
        name=f"random{n}",
        bodies=tuple(bodies),
        nq=n,
        nv=n,
        gravity=vector(gravity.tolist()),
        graph=Graph(),
        base=Transform.identity(),
        points={},
        frames={},
        links={},
        outlines={},
        joint_names=names,
        q_names=names,
        v_names=names,
        q_units=tuple("rad" for _ in names),
    )


def shuffled(model: Model, seed: int) -> Model:
    """Give the joints other places in q and v, as a scene does whose joints are not listed in tree order."""
    order = np.random.default_rng(seed).permutation(model.nv)
    names = [""] * model.nv
    bodies = []
    for body, place in zip(model.bodies, order):
        bodies.append(dataclasses.replace(body, q=int(place), v=int(place)))
        names[place] = body.joint_name
    return dataclasses.replace(
        model, bodies=tuple(bodies), joint_names=tuple(names), q_names=tuple(names), v_names=tuple(names)
    )

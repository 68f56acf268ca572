"""Loop closures: their rows against differences and the graph, their keys."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene_text
from robodyn_cli.algorithms.constraints import LoopRows, vanishes
from robodyn_cli.algorithms.kinematics import transforms
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.calculus import directional, jacobian
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.loops.registry import loop_types
from robodyn_cli.model.model import BASE, FixedFrame, Loop, Model
from robodyn_cli.spatial.algebra import matrix, vector
from tests.identities.trees import State, symbols
from tests.numeric import assert_close, first_derivative, real
from tests.random_models import random_rotation, random_tree

ROWS = {
    "revolute": 5, "prismatic": 5, "cylindrical": 4, "universal": 4, "spherical": 3, "planar": 3, "fixed": 6,
    "point_on_line": 2, "point_on_plane": 1, "distance": 1,
}  # fmt: skip


def element(kind: str, rng: np.random.Generator) -> Any:
    """Return a closure with random axes, attitude and length."""
    cls = loop_types[kind]
    found = {"name": "loop", "type": kind, "between": ("", ""), "length": 0.7}
    found |= {name: tuple(rng.normal(size=3)) for name in ("axis", "axis2", "rpy")}
    return cls(**{field.name: found[field.name] for field in dataclasses.fields(cls)})


def closed(kind: str, seed: int) -> tuple[Model, Loop]:
    """Return a random tree and a loop between two frames of it, one of them the base's now and then."""
    rng = np.random.default_rng(seed)
    model = random_tree(6, seed, branching=0.4)
    first, second = rng.choice(6, 2, replace=False)
    if seed % 3 == 0:
        second = BASE

    def frame(body: int) -> FixedFrame:
        return FixedFrame(
            int(body), vector(rng.normal(size=3).tolist()), matrix(random_rotation(rng).tolist())
        )

    loop = Loop("loop", element(kind, rng), frame(first), frame(second))
    return dataclasses.replace(model, loops=(loop,)), loop


def numbers(model: Model, loop: Loop, q: Any, v: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return eta (m,), Psi (m, nv) and gamma (m,) at a state."""
    rows = LoopRows(model, transforms(model, q), q, v, model.gravity).of(loop)
    return real([r.eta for r in rows]), real([list(r.psi) for r in rows]), real([r.gamma for r in rows])


def test_every_kind_is_here() -> None:
    assert set(ROWS) == set(loop_types)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ROWS)
def test_rows_by_differences(kind: str, seed: int) -> None:
    """Along q + v t + a t^2 / 2: d eta/dt = Psi v and d(Psi v)/dt = Psi a + gamma."""
    model, loop = closed(kind, seed)
    s = State.random(model, seed)
    eta, psi, gamma = numbers(model, loop, s.q, s.qd)
    assert len(eta) == ROWS[kind]
    size = 1.0 + float(np.abs(s.qd).sum())
    h = 0.03 / max(size, float(np.sqrt(np.abs(s.qdd).sum())))

    def position(t: float) -> np.ndarray:
        return numbers(model, loop, s.q + t * s.qd + t * t / 2 * s.qdd, s.qd)[0]

    def rate(t: float) -> np.ndarray:
        v = s.qd + t * s.qdd
        return numbers(model, loop, s.q + t * s.qd + t * t / 2 * s.qdd, v)[1] @ v

    assert_close(psi @ s.qd, first_derivative(position, h), 1e-10, 10 * size)
    assert_close(psi @ s.qdd + gamma, first_derivative(rate, h), 1e-10, 10 * size**2)
    for k in range(model.nv):
        unit = np.eye(model.nv)[k]
        slope = first_derivative(lambda t, u=unit: numbers(model, loop, s.q + t * u, s.qd)[0], 0.02)
        assert_close(psi[:, k], slope, 1e-11, 10.0)


@pytest.mark.parametrize("kind", ROWS)
def test_rows_by_the_graph(kind: str) -> None:
    model, loop = closed(kind, 11)
    s = State.random(model)
    q, v, *_ = symbols(model)
    rows = LoopRows(model, transforms(model, q), q, v, model.gravity).of(loop)
    slopes = jacobian([r.eta for r in rows], q)
    for row, slope in zip(rows, slopes):
        exact = [slope.get(k, 0.0) for k in range(model.nv)]
        rate = sum((x * y for x, y in zip(row.psi, v)), 0.0)
        gamma = directional([rate], q, v)[0]
        outputs = [*row.psi, *exact, row.gamma, gamma]
        found = real(evaluate(outputs, s.inputs))
        assert_close(found[: model.nv], found[model.nv : -2], 1e-13, 10.0)
        assert_close(found[-2], found[-1], 1e-12, 10.0 * (1.0 + float(np.abs(s.qd).sum())) ** 2)


@pytest.mark.parametrize(
    ("kind", "left"),
    [("revolute", 2), ("spherical", 2), ("fixed", 3), ("planar", 2), ("point_on_line", 1), ("distance", 1)],
)
def test_rows_that_vanish_in_the_plane(kind: str, left: int) -> None:
    """Two planar chains: what a closure says about the direction across the plane is left out."""
    model = random_tree(4, 3, branching=0.0, kinds=("revolute",))
    flat = [
        dataclasses.replace(b.X_tree, E=matrix(np.eye(3).tolist()), r=vector([0.5, 0, 0]))
        for b in model.bodies
    ]
    bodies = tuple(
        dataclasses.replace(b, X_tree=X, parent=p) for b, X, p in zip(model.bodies, flat, (BASE, 0, BASE, 2))
    )
    cls = loop_types[kind]
    given: dict[str, Any] = {"name": "loop", "type": kind, "between": ("", "")}
    given |= (
        {"length": 0.4} if kind == "distance" else {"axis": (0, 1.0, 0)} if kind == "point_on_line" else {}
    )
    ends = [FixedFrame(k, vector([0.5, 0, 0]), matrix(np.eye(3).tolist())) for k in (1, 3)]
    loop = Loop("loop", cls(**given), *ends)
    model = dataclasses.replace(model, bodies=bodies, gravity=vector([0, -9.81, 0]), loops=(loop,))
    q, v, *_ = symbols(model)
    rows = LoopRows(model, transforms(model, q), q, v, model.gravity).of(loop)
    assert sum(not vanishes(r) for r in rows) == (left if kind != "planar" else 0)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("type: universal, axis: [1, 0, 0]", "axis2"),
        ("type: distance", "length"),
        ("type: distance, length: 0", "length"),
        ("type: spherical, axis: [1, 0, 0]", "axis"),
        ("type: planar, axis: [0, 0, 0]", "must not be zero"),
        ("type: ball", "spherical"),
    ],
)
def test_keys_of_closures(keys: str, message: str) -> None:
    text = f"""
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{{name: slide, type: prismatic, axis: [1, 0, 0]}}]
  links: [{{name: block, mass: 1, com: [0, 0, 0]}}]
loops: [{{name: hold, between: [base.origin, block.origin], {keys}}}]
"""
    with pytest.raises(SceneError, match=message):
        load_scene_text(text)

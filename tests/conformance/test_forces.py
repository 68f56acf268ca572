"""Every force element of the registry against the checklist in ``forces/element.py``, on random trees."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from robodyn_cli.algorithms.kinematics import transforms
from robodyn_cli.equations.elements import Elements
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.formula import FormulaTree, parse
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.forces.registry import force_types
from robodyn_cli.forces.springs import LengthTable, RateTable
from robodyn_cli.model.model import BASE, FixedFrame, Force, Model
from robodyn_cli.spatial.algebra import matrix, vector
from tests.random_models import random_rotation, random_tree

SAMPLES = (0, 1, 3, 4)


def positive(rng: np.random.Generator, n: int = 6) -> tuple[tuple[float, ...], ...]:
    A = rng.normal(size=(n, n))
    return tuple(map(tuple, (A @ A.T).tolist()))


def formula(text: str) -> FormulaTree:
    return parse(text).resolve({"q0": None, "q1": None}, {}, ("t", "q", "qd"))


def variants(rng: np.random.Generator) -> dict[str, list[dict[str, Any]]]:
    """Values of the keys of each kind that bring out all of its terms."""
    components = tuple(formula(x) for x in ("3*sin(t)", "2 - q0", "qd.q1"))
    return {
        "spring": [
            {"stiffness": 40.0, "length": 0.3, "damping": 2.0},
            {"stiffness": 40.0},
            {"damping": 3.0},
        ],
        "nonlinear_spring": [
            {"tension": LengthTable(((0.2, -3.0), (0.9, 1.0), (1.4, 8.0))), "damping": 2.0},
            {
                "tension": parse("5*rate*(1 + length^2)").resolve({}, {}, ("length", "rate")),
                "damping": RateTable(((-1.0, -4.0), (0.0, 0.0), (2.0, 3.0))),
            },
        ],
        "torsional_spring": [
            {"axis": (0.3, -1.0, 0.5), "stiffness": 4.0, "rest": 0.4, "damping": 0.3},
            {"stiffness": 4.0},
        ],
        "constant_force": [{"force": 7.0}],
        "bushing": [
            {"stiffness": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), "damping": (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)},
            {"stiffness_matrix": positive(rng), "damping_matrix": positive(rng)},
        ],
        "force": [{"force": components, "frame": "world"}, {"force": components, "frame": "body"}],
        "wrench": [
            {"force": components, "moment": components[::-1], "frame": "world"},
            {"force": components, "moment": components[::-1], "frame": "body"},
        ],
    }


def place(model: Model, rng: np.random.Generator, body: int) -> FixedFrame:
    return FixedFrame(body, vector(rng.normal(size=3).tolist()), matrix(random_rotation(rng).tolist()))


def tree_with(kind: str, values: dict[str, Any], seed: int) -> tuple[Model, np.random.Generator]:
    """A tree with one element of a kind on it; between two bodies of one branch, of two, or a body and the base."""
    rng = np.random.default_rng([seed, len(kind)])
    kinds = ("revolute",) if seed % 2 else ("revolute", "revolute", "prismatic")
    model = random_tree(5, seed, branching=0.5 if seed % 2 else 0.0, kinds=kinds)
    cls = force_types[kind]
    one = "at" in {f.name for f in dataclasses.fields(cls)}
    element = cls(name="x", type=kind, **({"at": ""} if one else {"between": ("", "")}), **values)
    bodies = [int(x) for x in rng.choice(5, 2, replace=False)]
    if seed == 0:
        bodies[0] = BASE
    ends = tuple(place(model, rng, k) for k in (bodies[1:] if one else bodies))
    return dataclasses.replace(model, forces=(Force("x", element, ends),)), rng


def built(model: Model) -> tuple[Elements, list[Any], list[Any]]:
    graph, n = model.graph, model.nv
    t = graph.symbol("t", "t")
    q = graph.symbols([f"q{k}" for k in range(n)], "q")
    v = graph.symbols([f"v{k}" for k in range(n)], "v")
    env = {"t": t, **{f"q.q{k}": x for k, x in enumerate(q)}, **{f"qd.q{k}": x for k, x in enumerate(v)}}
    return Elements(model, transforms(model, q), q, v, env, t), q, v


@pytest.mark.parametrize("kind", sorted(force_types))
@pytest.mark.parametrize("seed", SAMPLES)
def test_torques_energy_and_power_belong_together(kind: str, seed: int) -> None:
    """tau . v = -dV/dt + P for any v; and every wrench's power is that of its torques: sum of F . v + M . w."""
    for values in variants(np.random.default_rng(seed))[kind]:
        model, rng = tree_with(kind, values, seed)
        n = model.nv
        elements, q, v = built(model)
        (term,) = elements.torques
        tau = elements.torques[term]
        rate = directional([elements.potential], q, v)[0]
        outputs = [*tau, elements.potential, elements.power, rate]
        conservative = kind == "constant_force" or (kind == "spring" and list(values) == ["stiffness"])
        state_q, state_v = rng.uniform(-1.5, 1.5, size=n), rng.normal(size=n)
        found = np.array(
            evaluate(outputs, {"t": [0.7], "q": state_q.tolist(), "v": state_v.tolist()}), dtype=float
        )
        torque, power, change = found[:n], found[n + 1], found[n + 2]
        scale = np.abs(torque) @ np.abs(state_v)
        assert scale > 1e-3
        assert abs(torque @ state_v + change - power) < 1e-13 * scale
        if conservative or term == "external":
            assert (power == 0.0) == conservative
        else:
            assert power < 0.0 or "damping" not in "".join(values)
        assert term == type(model.forces[0].element).term


@pytest.mark.parametrize("kind", sorted(force_types))
def test_an_element_does_nothing_below_the_bodies_it_acts_on(kind: str) -> None:
    """Between bodies 2 and 4 of a chain only joints 3 and 4 feel anything; a force from outside is felt by all."""
    values = variants(np.random.default_rng(0))[kind][0]
    model, rng = tree_with(kind, values, 2)
    external = len(model.forces[0].ends) == 1
    ends = tuple(place(model, rng, k) for k in ((4,) if external else (2, 4)))
    model = dataclasses.replace(model, forces=(dataclasses.replace(model.forces[0], ends=ends),))
    (tau,) = built(model)[0].torques.values()
    idle = [k for k, x in enumerate(tau) if not hasattr(x, "op") and x == 0.0]
    assert idle == ([] if external else [0, 1, 2])

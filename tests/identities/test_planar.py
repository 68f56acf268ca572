"""A planar mechanism asks for planar data only: nothing unknown reaches its equations.

Every mass property that the plane does not need is a symbol of the group "unknown"; the finished graphs must
be free of them.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from robodyn_cli.algorithms.aba import ArticulatedFactor, aba
from robodyn_cli.algorithms.composite import coriolis, crba
from robodyn_cli.algorithms.energy import gravity_energy, kinetic_energy
from robodyn_cli.algorithms.kinematics import transforms
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.expr.graph import Graph, count_operations, free_symbols
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import BASE, UNKNOWN_GROUP, Body, Model
from robodyn_cli.spatial.algebra import Transform, matrix, rotation_about, rotation_to_z, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia
from tests.identities.trees import State, flat, symbols
from tests.numeric import assert_close

IN_PLANE = vector([1.5, -9.81, 0.0])


def planar(n: int, seed: int, slides: bool = True, tree: bool = True) -> Model:
    """Joints that turn about z or slide in the plane; only m, c_x, c_y and I_zz are known."""
    rng = np.random.default_rng(seed)
    graph = Graph()
    bodies: list[Body] = []
    frames: list[
        Transform
    ] = []  # from each body's own frame to its link frame, whose z is the plane's normal
    for k in range(n):
        unknown = lambda name, k=k: graph.symbol(f"{name} of link{k}", UNKNOWN_GROUP)  # noqa: E731
        parent = int(rng.integers(-1, k)) if tree and k and rng.uniform() < 0.3 else k - 1
        kind = "prismatic" if slides and rng.uniform() < 0.4 else "revolute"
        axis = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)][int(rng.integers(3))]
        R = rotation_to_z(axis) if kind == "prismatic" else matrix(np.eye(3).tolist())
        where = Transform(
            rotation_about(2, float(rng.normal())).T, vector([*rng.normal(size=2).tolist(), 0.1 * k])
        )
        base = frames[parent] if parent != BASE else Transform.identity()
        X_tree = Transform(R.T, zeros(3)) @ where @ base
        c = vector([*rng.normal(size=2).tolist(), unknown("com[2]")])
        I = {name: unknown(f"inertia.{name}") for name in ("xx", "yy", "xy", "xz", "yz")}
        tensor = matrix(
            [
                [I["xx"], I["xy"], I["xz"]],
                [I["xy"], I["yy"], I["yz"]],
                [I["xz"], I["yz"], float(rng.uniform(0.1, 1.0))],
            ]
        )
        link = Transform(R, zeros(3))
        inertia = RigidInertia.from_com(float(rng.uniform(0.5, 3.0)), c, tensor).to_parent(link)
        bodies.append(
            Body(
                f"link{k}",
                f"q{k}",
                joint_types[kind],
                parent,
                X_tree,
                inertia,
                k,
                k,
                float(rng.uniform(0, 0.1)),
            )
        )
        frames.append(link)
    names = tuple(f"q{k}" for k in range(n))
    model = Model("planar", tuple(bodies), n, n, IN_PLANE, graph, Transform.identity(), {}, {}, {}, {})
    return dataclasses.replace(model, joint_names=names, q_names=names, v_names=names)


def unknowns(outputs: Any) -> list[str]:
    return [e.value[0] for e in free_symbols(flat(outputs)) if e.value[1] == UNKNOWN_GROUP]


def equations(model: Model, gravity: Any) -> dict[str, Any]:
    q, qd, qdd, tau = symbols(model)
    return {
        "rnea": rnea(model, q, qd, qdd, gravity),
        "crba": crba(model, q),
        "coriolis": coriolis(model, q, qd),
        "aba": aba(model, q, qd, tau, gravity),
        "solve": ArticulatedFactor(model, q).solve(tau),
        "kinetic": [kinetic_energy(model, q, qd)],
        "gravity": [gravity_energy(model, q, gravity)],
    }


def tilted(model: Model, body: int) -> Model:
    """Turn one joint's axis out of the normal."""
    bodies = list(model.bodies)
    lean = Transform(rotation_about(0, 0.3).T, zeros(3))
    bodies[body] = dataclasses.replace(bodies[body], X_tree=lean @ bodies[body].X_tree)
    return dataclasses.replace(model, bodies=tuple(bodies))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("n", [1, 2, 4, 7])
def test_a_planar_mechanism_needs_planar_data_only(n: int, seed: int) -> None:
    for name, outputs in equations(planar(n, seed), IN_PLANE).items():
        assert not unknowns(outputs), f"{name} needs {unknowns(outputs)}"


@pytest.mark.parametrize("seed", range(4))
def test_gravity_across_the_plane_loads_no_joint(seed: int) -> None:
    model = planar(4, seed)
    across = vector([0.0, -9.0, 4.0])
    found = equations(model, across)
    assert not unknowns(found["rnea"]) and not unknowns(found["aba"])
    # but the height of the centre of mass above the plane now counts
    assert {f"com[2] of link{k}" for k in range(4)} == set(unknowns(found["gravity"]))


@pytest.mark.parametrize("seed", range(4))
def test_a_tilted_axis_asks_for_what_it_needs(seed: int) -> None:
    model = tilted(planar(3, seed, slides=False, tree=False), 1)
    found = equations(model, IN_PLANE)
    for name in ("rnea", "crba", "aba", "coriolis", "kinetic"):
        assert unknowns(found[name]), name
    # link 0 still turns about its own z only
    assert not [x for x in unknowns(found["crba"]) if x.endswith("link0")]
    assert "inertia.yy of link2" in unknowns(found["rnea"])


def test_a_tilted_base_changes_nothing_but_gravity() -> None:
    model = planar(3, 1, slides=False)
    first = dataclasses.replace(
        model.bodies[0], X_tree=model.bodies[0].X_tree @ Transform(rotation_about(0, 0.3).T, zeros(3))
    )
    leaning = dataclasses.replace(model, bodies=(first, *model.bodies[1:]))
    found = equations(leaning, vector([0.0, -9.81, 0.0]))
    for name in ("rnea", "crba", "aba", "kinetic"):
        assert not unknowns(found[name]), name


@pytest.mark.parametrize("seed", range(4))
def test_the_unknown_does_not_matter(seed: int) -> None:
    """The planar equations are those of the full body, whatever the unknown properties are."""
    from robodyn_cli.expr.calculus import substitute

    model = planar(4, seed)
    rng = np.random.default_rng(seed)
    s = State.random(model)
    results = []
    for _ in range(2):
        values = {e.index: float(rng.normal()) for e in model.graph.nodes if e.op == "sym"}

        def fill(array: Any, values: Any = values) -> Any:
            return np.array(substitute(flat(array), values), dtype=object).reshape(np.shape(array))

        bodies = []
        for b in model.bodies:
            inertia = RigidInertia(b.inertia.m, fill(b.inertia.h), fill(b.inertia.I))
            bodies.append(dataclasses.replace(b, inertia=inertia))
        full = dataclasses.replace(model, bodies=tuple(bodies))
        results.append(rnea(full, s.q, s.qd, s.qdd, IN_PLANE))
    q, qd, qdd, _ = symbols(model)
    sparse = evaluate(flat(rnea(model, q, qd, qdd, IN_PLANE)), s.inputs)
    assert_close(results[0], sparse, 1e-13)
    assert_close(results[1], sparse, 1e-13)


def test_the_lecture_arm_is_small() -> None:
    """A planar 2R arm costs as much as its textbook equation: no arithmetic out of the plane."""
    model = planar(2, 3, slides=False, tree=False)
    bodies = [dataclasses.replace(b, armature=0.0) for b in model.bodies]
    along_x = Transform(matrix(np.eye(3).tolist()), vector([1.0, 0.0, 0.0]))
    bodies[0] = dataclasses.replace(bodies[0], X_tree=Transform.identity())
    bodies[1] = dataclasses.replace(bodies[1], X_tree=along_x)
    for k, b in enumerate(bodies):
        c = vector([0.5, 0.0, model.graph.symbol(f"com[2] of link{k}", UNKNOWN_GROUP)])
        I = b.inertia.I
        bodies[k] = dataclasses.replace(b, inertia=RigidInertia(2.0, 2.0 * c, I))
    model = dataclasses.replace(model, bodies=tuple(bodies))
    q, qd, qdd, _ = symbols(model)
    assert count_operations(rnea(model, q, qd, qdd, vector([0.0, -9.81, 0.0]))) < 60
    X = transforms(model, q)
    assert all(e.value[1] != UNKNOWN_GROUP for x in X for e in free_symbols([*flat(x.E), *x.r]))

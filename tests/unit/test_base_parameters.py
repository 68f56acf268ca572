"""Regrouped inertial parameters: fewer numbers, the same M, C and G."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import count_operations
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.base_parameters import with_base_parameters
from robodyn_cli.scene import load_scene
from tests.numeric import assert_close, real
from tests.random_models import random_tree


@pytest.mark.parametrize("seed", range(12))
def test_mass_matrix_and_torques_stay(seed: int) -> None:
    kinds = ("revolute", "prismatic", "helical") if seed % 3 == 0 else ("revolute", "prismatic")
    model = random_tree(7, seed, kinds=kinds)
    other = with_base_parameters(model)
    rng = np.random.default_rng(100 + seed)
    q, qd, qdd = (rng.normal(size=7).tolist() for _ in range(3))
    assert_close(crba(other, q), crba(model, q), 1e-13)
    assert_close(rnea(other, q, qd, qdd, model.gravity), rnea(model, q, qd, qdd, model.gravity), 1e-13)


@pytest.mark.parametrize("seed", range(12))
def test_masses_at_joints_leave_the_equations(seed: int) -> None:
    kinds = ("revolute", "prismatic", "helical") if seed % 3 == 0 else ("revolute", "prismatic")
    model = random_tree(7, seed, kinds=kinds)
    other = model.with_masses_at_joints()
    assert all(body.joint.type != "revolute" or body.inertia.m == 0.0 for body in other.bodies)
    rng = np.random.default_rng(100 + seed)
    q, qd, qdd = (rng.normal(size=7).tolist() for _ in range(3))
    assert_close(crba(other, q), crba(model, q), 1e-13)
    assert_close(rnea(other, q, qd, qdd, model.gravity), rnea(model, q, qd, qdd, model.gravity), 1e-13)


def test_masses_at_joints_may_be_symbols() -> None:
    model = random_tree(3, 5, branching=0.0, kinds=("revolute",))
    mass = model.graph.symbol("mass", "p")
    last = model.bodies[-1]
    known = dataclasses.replace(last.inertia, m=mass)
    model = dataclasses.replace(model, bodies=(*model.bodies[:-1], dataclasses.replace(last, inertia=known)))
    q = [0.3, -0.4, 0.5]
    M, other = (
        [evaluate(list(crba(m, q).flat), {"p": [2.5]})] for m in (model, model.with_masses_at_joints())
    )
    assert model.with_masses_at_joints().bodies[-1].inertia.m == 0.0
    assert_close(other, M, 1e-14)


def test_planar_arms_take_a_quarter_fewer_operations() -> None:
    """The mass of the second link at the elbow leaves nothing of the rotation there and back."""
    problem = Problem(load_scene("configs/double_pendulum.yaml"))
    plain = rnea(problem.model, problem.q, problem.v, problem.a, problem.gravity, problem.X)
    assert count_operations(list(problem.inverse_dynamics)) < 0.85 * count_operations(list(plain))
    assert count_operations(list(problem.free_accelerations(-problem.bias))) < 40


@pytest.mark.parametrize(("kind", "left"), [("revolute", 7), ("prismatic", 4)])
def test_as_many_numbers_are_left_as_a_body_on_such_a_joint_has_parameters(kind: str, left: int) -> None:
    model = with_base_parameters(random_tree(4, 3, branching=0.0, kinds=(kind,)))
    for body in model.bodies:
        I = real(body.inertia.I)
        numbers = [float(body.inertia.m), *real(body.inertia.h), *I[np.triu_indices(3)]]
        assert sum(x != 0.0 for x in numbers) == left


def test_torques_take_fewer_operations() -> None:
    model = random_tree(6, 1, branching=0.0, kinds=("revolute",), armature=False)
    graph = model.graph
    q, qd, qdd = (graph.symbols([f"{g}{k}" for k in range(6)], g) for g in "qva")
    before, after = (
        count_operations(list(rnea(m, q, qd, qdd, m.gravity))) for m in (model, with_base_parameters(model))
    )
    assert after < 0.92 * before


def test_symbols_stay_where_they_are() -> None:
    model = random_tree(3, 5)
    mass = model.graph.symbol("mass", "p")
    last = model.bodies[-1]
    inertia = dataclasses.replace(last.inertia, m=mass)
    model = dataclasses.replace(
        model, bodies=(*model.bodies[:-1], dataclasses.replace(last, inertia=inertia))
    )
    assert with_base_parameters(model).bodies[-1].inertia is inertia


def test_joints_without_such_a_part_say_so() -> None:
    model = random_tree(2, 0)
    assert joint_types["spherical"].parent_inertia(model.bodies[0].inertia) is None

"""Energies: their values, their slopes and their balance along the motion."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robodyn_cli.algorithms.aba import aba
from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.energy import gravity_energy, kinetic_energy, spring_energy
from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.expr.calculus import directional, jacobian
from robodyn_cli.expr.graph import count_operations
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.forces.friction import Friction
from robodyn_cli.forces.springs import Damper, Spring
from robodyn_cli.model.model import BASE, JointForce, Model
from robodyn_cli.spatial.algebra import dot, vector
from tests.identities.trees import State, symbols, trees
from tests.numeric import assert_close, examples, first_derivative, real
from tests.random_models import random_tree


def potential_energy(model: Model, q: Any) -> Any:
    """Gravity and joint springs."""
    return gravity_energy(model, q, model.gravity) + spring_energy(model, q)


def with_forces(model: Model, seed: int) -> Model:
    """Give every joint some of: spring, damper, friction."""
    rng = np.random.default_rng(seed)
    bodies = []
    for body in model.bodies:
        elements = [
            ("spring", Spring(stiffness=rng.uniform(1, 50), rest=rng.normal())),
            ("damper", Damper(damping=rng.uniform(0, 5))),
            (
                "friction",
                Friction(viscous=rng.uniform(0, 2), coulomb=rng.uniform(0, 3), transition_speed=0.1),
            ),
        ]
        ratio = float(rng.uniform(1, 5))
        chosen = tuple(
            JointForce(kind, e, body.joint_name, body.q, body.v, gear_ratio=ratio)
            for kind, e in elements
            if rng.uniform() < 0.7
        )
        bodies.append(dataclasses.replace(body, forces=chosen, gear_ratio=ratio))
    return dataclasses.replace(model, bodies=tuple(bodies))


def joint_forces(model: Model, q: np.ndarray, qd: np.ndarray, dissipative: bool) -> np.ndarray:
    """Torques of the elements in the joints, those that dissipate or the others."""
    tau = np.zeros(model.nv)
    for b in model.bodies:
        for force in b.forces:
            if force.element.dissipative == dissipative:
                tau[b.v] += force.element.torque(float(q[b.q]), float(qd[b.v]), b.gear_ratio, True)
    return tau


@examples(40)
@given(trees())
def test_kinetic_energy_is_half_of_the_mass_matrix_between_rates(model: Model) -> None:
    s = State.random(model)
    expected = 0.5 * s.qd @ real(crba(model, s.q)) @ s.qd
    assert_close(kinetic_energy(model, s.q, s.qd), expected, 1e-13)
    assert_close(kinetic_energy(model, s.q, s.qd, transforms(model, s.q)), expected, 1e-13)


@examples(40)
@given(trees())
def test_gravity_energy_is_weight_times_height(model: Model) -> None:
    s = State.random(model)
    X = transforms(model, s.q)
    pose = poses(model, X)
    g, expected, size = real(model.gravity), 0.0, 0.0
    for k, body in enumerate(model.bodies):
        com = real(pose[k].point(vector([h / body.inertia.m for h in body.inertia.h])))
        expected -= body.inertia.m * g @ com
        size += body.inertia.m * np.linalg.norm(g) * np.linalg.norm(com)
    assert_close(gravity_energy(model, s.q, model.gravity), expected, 1e-13, size)
    assert_close(gravity_energy(model, s.q, model.gravity, X), expected, 1e-13, size)
    assert gravity_energy(model, s.q, None) == 0.0


def test_no_energy_at_the_base_origin() -> None:
    """The zero level: a mass point at the base's origin."""
    model = random_tree(1, 3)
    body = model.bodies[0]
    X = transforms(model, [0.0])[0]
    m = body.inertia.m
    at_base = dataclasses.replace(body.inertia, h=vector([float(x) for x in m * -(real(X.E) @ real(X.r))]))
    model = dataclasses.replace(model, bodies=(dataclasses.replace(body, inertia=at_base),))
    assert abs(gravity_energy(model, [0.0], model.gravity)) < 1e-13


@examples(25)
@given(trees())
def test_gravity_torque_is_the_slope_of_the_potential_by_differences(model: Model) -> None:
    s, still = State.random(model), [0.0] * model.nv
    G = real(rnea(model, s.q, still, still, model.gravity))
    scale = float(np.abs(G).max()) + abs(float(gravity_energy(model, s.q, model.gravity)))
    for body in model.bodies:
        unit = np.eye(model.nq)[body.q]
        slope = first_derivative(lambda t, e=unit: gravity_energy(model, s.q + t * e, model.gravity), 0.05)
        assert_close(slope, G[body.v], 1e-11, scale)


@examples(12)
@given(trees(8), st.integers(0, 99))
def test_potential_torque_is_the_slope_of_the_potential_by_the_graph(model: Model, seed: int) -> None:
    model = with_forces(model, seed)
    s, still = State.random(model), [0.0] * model.nv
    q, _, _, _ = symbols(model)
    rows = jacobian([gravity_energy(model, q, model.gravity), spring_energy(model, q)], q)
    got = np.zeros((2, model.nq))
    for row, values in zip(got, rows):
        for k, slope in zip(values, evaluate(list(values.values()), s.inputs)):
            row[k] = slope
    assert_close(got[0], rnea(model, s.q, still, still, model.gravity), 1e-12)
    assert_close(got[1], -joint_forces(model, s.q, s.qd, dissipative=False), 1e-13)


@examples(12)
@given(trees(8), st.integers(0, 99))
def test_energy_changes_by_the_power_of_torques_less_what_is_dissipated(model: Model, seed: int) -> None:
    model = with_forces(model, seed)
    s = State.random(model)
    q, qd, qdd, _ = symbols(model)
    energy = kinetic_energy(model, q, qd) + potential_energy(model, q)
    rate = directional([energy], [*q, *qd], [*qd, *qdd])
    lost = joint_forces(model, s.q, s.qd, dissipative=True)
    total = s.tau + lost + joint_forces(model, s.q, s.qd, dissipative=False)
    motion = aba(model, s.q, s.qd, total, model.gravity)
    got = evaluate(rate, {**s.inputs, "qdd": [float(x) for x in motion]})[0]
    dissipated = -float(dot(lost, s.qd))
    assert dissipated >= 0.0
    inertial = np.abs(real(rnea(model, s.q, s.qd, motion, model.gravity))) @ np.abs(s.qd)
    scale = float(
        inertial + np.abs(real(crba(model, s.q)) @ real(motion)) @ np.abs(s.qd) + np.abs(s.tau @ s.qd)
    )
    assert_close(got, dot(s.tau, s.qd) - dissipated, 1e-11, scale)


@examples(25)
@given(trees())
def test_energy_rate_by_differences(model: Model) -> None:
    """Along q(t) = q + t qd + t^2 qdd / 2, the total energy grows with the power of the inverse dynamics."""
    s = State.random(model)

    def energy(t: float) -> float:
        q, qd = s.q + t * s.qd + t * t / 2 * s.qdd, s.qd + t * s.qdd
        return float(kinetic_energy(model, q, qd) + potential_energy(model, q))

    tau = rnea(model, s.q, s.qd, s.qdd, model.gravity)
    h = 0.02 / max(1.0, float(np.abs(s.qd).sum()), float(np.sqrt(np.abs(s.qdd).sum())))
    scale = abs(energy(0.0)) / h + float(np.abs(real(tau)) @ np.abs(s.qd))
    assert_close(first_derivative(energy, h), dot(tau, s.qd), 1e-11, scale)


@examples(12)
@given(trees(8), st.integers(0, 99))
def test_graph_gives_the_same_numbers(model: Model, seed: int) -> None:
    model = with_forces(model, seed)
    s = State.random(model)
    q, qd, _, tau = symbols(model)
    graph = [
        kinetic_energy(model, q, qd),
        potential_energy(model, q),
        spring_energy(model, q),
        dot(tau, qd),
    ]
    numbers = [
        kinetic_energy(model, s.q, s.qd),
        potential_energy(model, s.q),
        spring_energy(model, s.q),
        dot(s.tau, s.qd),
    ]
    for got, expected in zip(evaluate(graph, s.inputs), numbers):
        assert_close(got, expected, 1e-13, max(abs(float(expected)), 1.0))


def test_energies_cost_few_operations() -> None:
    """O(N), and less than the equations they are computed beside."""
    counts = {}
    for n in (6, 12):
        model = random_tree(n, 1, branching=0.0, kinds=("revolute",))
        q, qd, qdd, _ = symbols(model)
        torque = count_operations(rnea(model, q, qd, qdd, model.gravity))
        kinetic = count_operations([kinetic_energy(model, q, qd)])
        height = count_operations([gravity_energy(model, q, model.gravity)])
        assert kinetic < 0.6 * torque and height < 0.3 * torque
        counts[n] = kinetic, height
    for small, large in zip(counts[6], counts[12]):
        assert large < 2.3 * small


def test_what_is_not_there_costs_nothing() -> None:
    model = random_tree(3, 2)
    q, _, _, _ = symbols(model)
    assert spring_energy(model, q) == 0.0
    assert gravity_energy(model, q, vector([0.0, 0.0, 0.0])) == 0.0
    assert model.bodies[0].parent == BASE

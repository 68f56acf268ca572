"""Accelerations as corrections of a guess: one solution whatever the guess and the age of the factors."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.residual import Residual
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.ready.prepare import prepare
from tests.mechanisms import CONFIGS
from tests.numeric import assert_close

# a tree with both kinds of joints, tilted axes, full inertias, rotors, and forces of every smooth kind
TREE = """
schema: 1
gravity: [1.0, -2.0, -9.0]
robot:
  joints:
    - {name: q1, type: revolute, axis: [0, 0, 1], gear_ratio: 20, rotor_inertia: 1e-3}
    - {name: q2, type: revolute, axis: [0.3, 1, 0.2], origin: {xyz: [0.1, 0.2, 0.3], rpy: [0.2, 0.1, -0.4]},
       spring: {stiffness: 8, rest: 0.2}, damper: {damping: 0.3}}
    - {name: q3, type: prismatic, axis: [1, 0.5, 0], origin: {xyz: [0.3, 0, 0.1]}, damper: {damping: 4},
       spring: {stiffness: 90}}
    - {name: q4, type: revolute, axis: [1, 0, 0], origin: {xyz: [0.2, 0.1, 0], rpy: [0, 0.7, 0.1]},
       damper: {damping: 0.1}}
    - {name: q5, type: revolute, axis: [0, 1, 0], parent: a2, origin: {xyz: [0, 0.1, 0.3], rpy: [0.5, 0, 0]}}
    - {name: q6, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.1, 0.1, 0.2], rpy: [1, 0, 0.3]}}
  links:
LINKS
torques: {q1: "2*sin(3*t) - 0.5*qd.q1", q4: "0.3*q.q5"}
command: simulate
initial: {q: {q1: 0.3, q2: -0.4, q3: 0.1, q4: 0.7, q5: 1.0, q6: -0.6}, qd: {q1: 0.5, q5: -1.0}}
simulate: {duration: 1}
"""


def tree() -> str:
    rng = np.random.default_rng(5)
    lines = []
    for k in range(6):
        points = rng.normal(size=(8, 3)) * [0.1, 0.2, 0.15]
        I = 0.3 * (np.sum(points**2) * np.eye(3) - points.T @ points)
        names = {"xx": I[0, 0], "yy": I[1, 1], "zz": I[2, 2], "xy": I[0, 1], "xz": I[0, 2], "yz": I[1, 2]}
        inertia = ", ".join(f"{name}: {float(x)!r}" for name, x in names.items())
        com = (rng.normal(size=3) * 0.1).tolist()
        mass = float(rng.uniform(0.5, 2.0))
        lines.append(
            f"    - {{name: a{k + 1}, mass: {mass!r}, com: {com}, com_frame: link, inertia: {{{inertia}}}}}"
        )
    return TREE.replace("LINKS", "\n".join(lines))


def built() -> tuple[Residual, System, np.ndarray]:
    setup = prepare(load_scene_text(tree()))
    system = build_system(setup.problem)
    assert system.residual is not None
    return system.residual, system, np.concatenate([setup.assembled.q, setup.assembled.v])


def groups(rng: np.random.Generator, **more: Any) -> dict[str, Any]:
    return {
        "t": [0.3],
        "q": rng.normal(size=6).tolist(),
        "v": rng.normal(size=6).tolist(),
        "z": [0.0],
        "p": [],
        **more,
    }


@pytest.mark.parametrize("seed", range(5))
def test_a_guess_and_its_correction_are_forward_dynamics(seed: int) -> None:
    residual, system, _ = built()
    rng = np.random.default_rng(seed)
    state = groups(rng)
    right = np.array(evaluate(system.acceleration, state))
    factors = evaluate(residual.entries, state)
    for guess in (np.zeros(6), 10.0 * rng.normal(size=6), right):
        found = evaluate(residual.corrections, {**state, "a": guess.tolist(), "l": factors})
        assert_close(guess + found, right, 1e-11, scale=float(np.abs(right).max() + 10.0))


def test_old_factors_slow_an_iteration_down_and_lead_nowhere_else() -> None:
    residual, system, _ = built()
    rng = np.random.default_rng(9)
    state = groups(rng)
    right = np.array(evaluate(system.acceleration, state))
    old = {**state, "q": (np.array(state["q"]) + 0.05 * rng.normal(size=6)).tolist()}
    factors = evaluate(residual.entries, old)
    a, errors = np.zeros(6), []
    for _ in range(25):
        a = a + np.array(evaluate(residual.corrections, {**state, "a": a.tolist(), "l": factors}))
        errors.append(float(np.abs(a - right).max()))
    assert errors[0] > 1e-4 * np.abs(right).max()  # they are wrong enough to matter
    assert errors[4] < 0.05 * errors[0]
    assert errors[-1] < 1e-11 * np.abs(right).max()


def test_gauss_takes_corrections_where_they_are_shorter() -> None:
    residual, system, _ = built()
    assert methods["gauss"].residual_of(system) is residual
    assert residual.correction.operations < 0.7 * system.dynamics.program.operations
    pendulum = prepare(load_scene(CONFIGS / "double_pendulum.yaml")).problem
    assert methods["gauss"].residual_of(build_system(pendulum)) is None


@pytest.mark.parametrize("name", ["four_bar_deploy", "stick_slip"])
def test_constraints_and_modes_have_none(name: str) -> None:
    problem = prepare(load_scene(CONFIGS / f"{name}.yaml", ["command=simulate", "expect=null"])).problem
    assert build_system(problem).residual is None


@pytest.mark.parametrize("method", ["gauss", "gauss8"])
def test_runs_end_where_those_of_forward_dynamics_end(method: str) -> None:
    """The same steps, rounds and samples, but for rounding; the work done is carried as well."""
    _, system, start = built()
    assert system.nz == 1
    plain = dataclasses.replace(system, forms=None)
    ends, samples, counts = [], [], []
    for one in (system, plain):
        integrator = Integrator(one, method)
        integrator.reset(0.0, np.append(start, 0.0), Options(1e-9, 1e-11))
        kept: list[np.ndarray] = []
        integrator.run(1.0, Grid(0.0, 0.05, 21), lambda t, x, kept=kept: kept.append(x.copy()))
        ends.append(integrator.state.copy())
        samples.append(np.concatenate(kept))
        counts.append((integrator.counters.steps, integrator.counters.evaluations))
    assert_close(ends[0], ends[1], 1e-9)
    assert_close(samples[0], samples[1], 1e-9)
    assert abs(counts[0][0] - counts[1][0]) <= 2
    assert counts[0][1] <= 1.1 * counts[1][1]


def test_smoothed_friction_does_not_multiply_steps_at_tight_tolerances() -> None:
    """Rounding at the ends of a step, through M^-1, used to pass for a front there: 1e5 steps at rtol 1e-13."""
    smooth = "friction: {viscous: 0.1, coulomb: 0.2, transition_speed: 0.1}}"
    setup = prepare(load_scene_text(tree().replace("damper: {damping: 0.1}}", smooth)))
    system = build_system(setup.problem, work=False)
    integrator, steps = Integrator(system, "gauss"), []
    for rtol in (1e-11, 1e-13):
        integrator.reset(0.0, np.concatenate([setup.assembled.q, setup.assembled.v]), Options(rtol, 1e-16))
        integrator.advance(1.0)
        steps.append(integrator.counters.steps)
    assert steps[1] < 2 * steps[0]

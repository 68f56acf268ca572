"""Generalized-alpha: order, damping and stiffness, with loops solved at index 3, and what it refuses."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

import robodyn_cli
from robodyn_cli import load_scene, simulate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.index3 import Index3
from robodyn_cli.integrators.methods import generalized_alpha as module
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text
from tests.oracle.test_stiff import PENDULUM as STIFF_PENDULUM
from tests.systems import advance, collect, linear, system

CONFIGS = Path(robodyn_cli.__file__).parents[1] / "configs"
NAME = "generalized_alpha"
# a mass point on two slides, held at a distance of 1 m from the base: a pendulum
POINT = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: x, type: prismatic, parent: base, axis: [1, 0, 0]}
    - {name: y, type: prismatic, axis: [0, 1, 0]}
  links:
    - {name: slide, mass: 0, com: [0, 0, 0], com_frame: joint}
    - {name: bob, mass: 2, com: [0, 0, 0], com_frame: joint}
  points: {pivot: {link: base, at: [0, 0, 0]}}
loops: [{name: rod, type: distance, between: [pivot, bob.origin], length: 1}]
initial: {q: {x: SINE, y: COSINE}, hold: [x]}
simulate: {duration: 2, samples: 41}
"""


def run(scene: Any, method: str = NAME, **options: Any) -> Result:
    given = {"integrator": method, "error_estimate": "false", **options}
    settings = [f"simulate.{key}={value}" for key, value in given.items()]
    return simulate(
        load_scene(scene, settings) if isinstance(scene, Path) else load_scene_text(scene, overrides=settings)
    )


@lru_cache
def pendulum() -> tuple[str, dict[str, np.ndarray]]:
    """The scene from an amplitude of 2 rad, and its exact motion and force in the rod."""
    amplitude, w = 2.0, np.sqrt(9.81)
    t = np.linspace(0.0, 2.0, 41)
    k = np.sin(amplitude / 2)
    sn, cn, *_ = ellipj(ellipk(k * k) - w * t, k * k)
    angle, rate = 2 * np.arcsin(k * sn), -2 * k * w * cn
    s, c = np.sin(angle), np.cos(angle)
    exact = {
        "q": np.column_stack([s, -c]),
        "qd": np.column_stack([c * rate, s * rate]),
        "constraints/multipliers": -(2.0 * (rate**2 + 9.81 * c))[:, None],
    }
    text = POINT.replace("COSINE", repr(-math.cos(amplitude))).replace("SINE", repr(math.sin(amplitude)))
    return text, exact


MECHANISMS = {
    "pendulum": ("", 0.005, {}),
    # no shorter: multipliers without projection carry roundings of the positions over h^2, 3e-8 N at 5 ms
    "four-bar": (CONFIGS / "four_bar_deploy.yaml", 0.04, {"duration": 8, "samples": 41}),
    "squeezer": (CONFIGS / "benchmarks" / "andrews.yaml", 5e-5, {"samples": 31}),
    "slider-crank": (CONFIGS / "benchmarks" / "slider_crank.yaml", 2.5e-4, {"samples": 31}),
    "open chain": (CONFIGS / "double_pendulum.yaml", 0.005, {"duration": 1, "samples": 31}),
}
COMPARED = ("q", "qd", "constraints/multipliers")


@pytest.mark.parametrize("stabilisation", ["projection", "none"])
@pytest.mark.parametrize("name", MECHANISMS)
def test_positions_velocities_and_multipliers_are_of_order_2(name: str, stabilisation: str) -> None:
    scene, step, more = MECHANISMS[name]
    exact: Any
    if name == "pendulum":
        scene, exact = pendulum()
    else:
        found = run(scene, "gauss", rtol=1e-12, atol=1e-13, **more)
        exact = {key: found[key] for key in COMPARED if key in found.variables}
    assert name == "open chain" or len(exact) == 3
    errors: dict[str, list[float]] = {key: [] for key in exact}
    for halvings in range(3):
        found = run(scene, step=step / 2**halvings, stabilisation=stabilisation, **more)
        for key in exact:
            errors[key].append(float(np.abs(found[key] - exact[key]).max()))
        if name != "open chain":
            closed = 1e-14 if stabilisation == "projection" else 1e-6  # between the steps
            assert np.abs(found["constraints/position_residual"]).max() < closed
    for key, (first, second, third) in errors.items():
        assert 1.7 < np.log2(second / third) < 2.2, (key, first, second, third)
        assert third < first / 12.0, (key, first, second, third)


def test_steps_keep_loops_closed_by_themselves() -> None:
    setup = prepare(load_scene(CONFIGS / "benchmarks" / "andrews.yaml"))
    body = build_system(setup.problem, "none", work=False)
    integrator = Integrator(body, NAME)
    integrator.reset(0.0, np.concatenate([setup.assembled.q, setup.assembled.v]), Options(step=1e-4))
    for stop in np.linspace(1e-3, 0.03, 30):
        integrator.advance(float(stop))
        gaps = evaluate(setup.problem.constraints.eta, {"t": [stop], "q": integrator.state[:7].tolist()})
        assert np.abs(gaps).max() < 1e-15
    assert integrator.counters.projections == 0


@pytest.mark.parametrize("ratio", [1e1, 1e3, 1e6])
def test_oscillations_that_are_not_resolved_lose_what_rho_says(ratio: float) -> None:
    """Spectral radius of one step for q'' = -w^2 q with w h = ratio, from the decay of the energy; rho as w h grows."""
    step = 1e-3
    w = ratio / step
    body = system(1, lambda t, q, v, z, p: [-w * w * q[0]])
    case = linear("fast", np.array([[0.0, 1.0], [-w * w, 0.0]]), body, (1.0, 0.0), 1.0)
    levels = []
    for steps in (100, 200):
        x = advance(case, NAME, steps * step, step=step).state
        levels.append(np.log(np.hypot(x[0], x[1] / w * ratio)))
    rho = np.exp((levels[1] - levels[0]) / 100)
    assert rho < 1.0
    assert abs(rho - module.RHO) < (0.02 if ratio > 1e2 else 0.2)


def test_slow_oscillations_keep_their_energy() -> None:
    """The damping per period falls with the cube of the step."""
    losses = []
    case = linear("slow", np.array([[0.0, 1.0], [-1.0, 0.0]]),
                  system(1, lambda t, q, v, z, p: [-q[0]]), (1.0, 0.0), 1.0)  # fmt: skip
    for step in (0.1, 0.05):
        x = advance(case, NAME, 200.0, step=step).state
        losses.append(1.0 - np.hypot(*x))
    assert 0.0 < losses[1] < losses[0] < 0.1
    assert 2.7 < np.log2(losses[0] / losses[1]) < 3.3


@pytest.mark.parametrize("step", [0.05, 0.02, 0.005])
def test_stiff_springs_and_dampers_leave_the_step_alone(step: float) -> None:
    """The fastest decay is over in less than a millisecond."""
    more = {"duration": 10, "samples": 101}
    slow, exact = run(STIFF_PENDULUM, step=step, **more), run(STIFF_PENDULUM, "radau13", **more)
    assert slow.summary["counters"]["steps"] == round(10 / step)
    # the transient itself is not resolved, and what it leaves creeps through a damper of 1e4 N m s
    assert np.abs(slow["q"] - exact["q"])[10:].max() < 0.03
    assert np.abs(slow["qd"] - exact["qd"])[10:].max() < 0.03


def test_events_and_stops_are_of_order_2() -> None:
    """Where a run stops, goes on, or steps are cut short, a is set for the step at hand."""
    text, exact = pendulum()
    setup = prepare(load_scene_text(text))
    body = build_system(setup.problem)
    start = body.join(setup.assembled.q, setup.assembled.v)
    errors = []
    for step in (0.004, 0.002):
        integrator = Integrator(body, NAME)
        integrator.reset(0.0, start, Options(step=step))
        integrator.advance(0.3333)
        _, first = collect(integrator, 1.2345, Grid(0.0, 0.05, 41))
        _, second = collect(integrator, 2.0, Grid(0.0, 0.05, 41))
        whole = np.concatenate([first, second])
        errors.append(np.abs(whole[:, :2] - exact["q"][-len(whole) :]).max())
    assert 1.7 < np.log2(errors[0] / errors[1]) < 2.4


def test_the_index_3_form_agrees_with_the_accelerations() -> None:
    """With weights near zero a step of Newton from anywhere gives accelerations and multipliers at once."""
    problem = Problem(load_scene(CONFIGS / "benchmarks" / "andrews.yaml"))
    program = Index3(problem).program
    assert len(program.outputs["a"]) == 7 and len(program.outputs["l"]) == 6
    assert set(program.inputs) >= {"q", "v", "a", "l", "g"}
    setup = prepare(load_scene(CONFIGS / "benchmarks" / "andrews.yaml"))
    body = build_system(setup.problem, "none", work=False)
    assert body.index3 is not None and body.index3.rows == 6


BALL = "robot: {joints: [{name: b, type: spherical}], links: [{name: l, mass: 1, com: [0, 0, 1], inertia: {xx: 1, yy: 1, zz: 1}}]}"


def test_refusals() -> None:
    cases = [
        (
            f"schema: 1\ngravity: [0, 0, -9.81]\n{BALL}\ninitial: {{q: {{b: {{rpy: [0, 0, 0]}}}}}}\n",
            "velocities that are not rates",
            {},
        ),
        (CONFIGS / "bouncing_pendulum.yaml", "rigid stop", {}),
        (
            CONFIGS / "benchmarks" / "slider_crank.yaml",
            "independent' chooses",
            {"stabilisation": "independent"},
        ),
    ]
    for scene, words, more in cases:
        with pytest.raises(CapabilityError, match=f"'{NAME}' does not do this scene.*{words}") as caught:
            run(scene, step=0.001, **more)
        assert caught.value.exit_code == 2


def test_a_step_that_is_too_long_is_an_error_with_advice() -> None:
    """The jump of a relaxation oscillation."""
    body = system(1, lambda t, q, v, z, p: [((1.0 - q[0] * q[0]) * v[0] - q[0]) * 1e6])
    integrator = Integrator(body, NAME)
    integrator.reset(0.0, (2.0, 0.0), Options(step=0.002))
    with pytest.raises(
        NumericalError, match=r"step of 0.002 s have no solution nearby .* shorter simulate.step"
    ):
        integrator.advance(2.0)
    assert 0.7 < integrator.time < 0.9

"""Reference problems from scene to motion, by every method, and what a System promises."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

import robodyn_cli
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.events import EventFunction, Stopping
from robodyn_cli.formulations.system import Corrections, System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.solve.closing.assembly import assemble
from tests.methods import each_adaptive, each_adaptive_family, each_family, taking
from tests.systems import collect, settings, system, within_reach

CONFIGS = Path(robodyn_cli.__file__).resolve().parent.parent / "configs"
GRAVITY = 9.81


def largest(x: Any) -> float:
    return float(np.abs(x).max(initial=0.0))


def options(method: str, tolerance: float) -> Options:
    if methods[method].adaptive:
        return settings(method, tolerance, tolerance)
    return Options(step=0.1 * within_reach(method, tolerance) ** (1 / methods[method].order))


def run(body: System, method: str, start: Any, grid: Grid, chosen: Options, end: float | None = None) -> Any:
    integrator = Integrator(body, method)
    integrator.reset(0.0, start, chosen)
    _, states = collect(integrator, grid.times(0, grid.count)[-1] if end is None else end, grid)
    return states, integrator


# -- simple pendulum --------------------------------------------------------------------------------------
PENDULUM = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints: [{name: hinge, type: revolute, a: 1, alpha: 0, d: 0}]
  links: [{name: bob, mass: 1, com: [1, 0, 0], com_frame: joint, inertia: {zz: 0}}]
initial: {q: {hinge: 180 deg}, qd: {hinge: 0}}
"""


@each_family
@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-10])
def test_simple_pendulum_against_elliptic_functions(method: str, tolerance: float) -> None:
    """Released horizontal at (-1, 0); theta from the downward vertical, sin(theta/2) = k sn(K - w t)."""
    body = build_system(Problem(load_scene_text(PENDULUM)))
    states, _ = run(body, method, (np.pi, 0.0), Grid(0.0, 0.01, 1001), options(method, tolerance))
    tolerance = within_reach(method, tolerance)
    w, t = np.sqrt(GRAVITY), np.arange(1001) * 0.01
    sn, cn, *_ = ellipj(ellipk(0.5) - w * t, 0.5)
    x, y = np.cos(states[:, 0]), np.sin(states[:, 0])
    theta = 2.0 * np.arcsin(np.sqrt(0.5) * sn)
    bound = 2e3 * tolerance if methods[method].adaptive else 1e4 * tolerance
    assert largest(x + np.sin(theta)) < bound and largest(y + np.cos(theta)) < bound
    # the joint turns the other way round than theta does
    assert largest(-states[:, 1] - (-2.0 * np.sqrt(0.5) * w * cn)) < 5 * bound
    # five values of the exact solution, to 17 digits
    for k, exact in {50: -0.391048791550546388, 100: 0.986291751131875319, 200: -0.793566195343321747,
                     500: -0.942305435043757335, 1000: -0.27508746257611686}.items():  # fmt: skip
        assert abs(x[k] - exact) < bound


# -- double pendulum of two rods ----------------------------------------------------------------------------
RODS = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, a: 1, alpha: 0, d: 0}
    - {name: b, type: revolute, a: 1, alpha: 0, d: 0}
  links:
    - {name: rod1, mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1/12}}
    - {name: rod2, mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1/12}}
initial: {q: {a: 0, b: 0}, qd: {a: 0, b: 0}}
"""
# angles from the downward vertical and their rates, from runs in extended precision
ROD_TABLE = {
    0.5: (0.4481426259320015078, 1.0419628873038667596, -2.4143083126482597, -5.9491049361176370),
    1.0: (-1.2077162381906379939, -0.8143910230912963515, -3.4065175329719577, -0.5160454721052089),
    2.0: (-0.0827583068205708470, 0.4073620749119072340, -0.9611454445459985, 11.898955053045295),
    3.0: (1.0250860122887291474, 0.4957346476269753775, -4.5933571054749802, 1.1843208806142299),
    5.0: (1.1385437966718796862, 1.2443799277502558404, 4.9109500240044542, -5.4247105931588760),
}


def rods(stop: bool = False) -> System:
    problem = Problem(load_scene_text(RODS))
    body = build_system(problem)
    return (
        dataclasses.replace(body, events=(EventFunction("stop", problem.t - 5.5, owner=Stopping()),))
        if stop
        else body
    )


def rod_errors(states: np.ndarray, step: float = 0.5) -> dict[float, float]:
    """Return the largest error at each time of the table."""
    found = {}
    for time, exact in ROD_TABLE.items():
        a, b, u, v = states[round(time / step)]
        found[time] = largest(np.array([a + np.pi / 2, a + b + np.pi / 2, u, u + v]) - exact)
    return found


@each_adaptive_family
@pytest.mark.parametrize("duration", [5.5, 1e5])
@pytest.mark.parametrize("tolerance", [10.0**-k for k in range(3, 14)])
def test_a_start_where_derivatives_vanish(method: str, tolerance: float, duration: float) -> None:
    """At rest and stretched out, many derivatives are zero: no tolerance, and no long run, may be fooled by it."""
    states, integrator = run(
        rods(stop=True), method, np.zeros(4), Grid(0.0, 0.5, 12), options(method, tolerance), duration
    )
    assert integrator.time == pytest.approx(5.5, abs=1e-12)
    errors = rod_errors(states)
    # small motions amplify an error about 2 times by 3 s and 6 times by 5 s
    tolerance = within_reach(method, tolerance)
    loose = {"gauss": 30.0, "dop853": 300.0}.get(method, 2000.0)
    assert max(errors[t] for t in (0.5, 1.0, 2.0, 3.0)) < loose * tolerance + 1e-12
    assert errors[5.0] < 20 * loose * tolerance + 1e-11


def test_double_pendulum_of_rods_to_the_last_digits() -> None:
    states, _ = run(rods(), "gauss", np.zeros(4), Grid(0.0, 0.5, 11), Options(3e-14, 3e-14))
    errors = rod_errors(states)
    assert errors[1.0] < 1e-13 and errors[3.0] < 1e-12 and errors[5.0] < 3e-11


@each_adaptive
def test_rods_keep_their_energy(method: str) -> None:
    """Released horizontal and at rest, the energy about the pivot is exactly zero."""
    problem = Problem(load_scene_text(RODS))
    body = build_system(problem)
    states, _ = run(body, method, np.zeros(4), Grid(0.0, 0.1, 201), options(method, 1e-11))
    groups = {"t": [0.0], "q": states[:, :2].T, "v": states[:, 2:].T}
    kinetic, potential = evaluate([problem.kinetic, problem.potential], groups)
    assert largest(kinetic + potential) < 2e4 * within_reach(method, 1e-11)
    assert largest(kinetic) > 10.0


# -- the lecture's double pendulum --------------------------------------------------------------------------
LECTURE = (-1.62889639534037, 0.477493006480734, -1.42990244445507, 2.56888649044476)


@pytest.mark.parametrize(
    ("rtol", "atol", "bound"), [(1e-10, 1e-12, 1e-8), (1e-10, 1e-10, 1e-8), (3e-14, 3e-14, 1e-11)]
)
def test_the_lectures_double_pendulum(rtol: float, atol: float, bound: float) -> None:
    scene = load_scene(CONFIGS / "double_pendulum.yaml")
    start = (-np.pi / 2, np.pi / 4, 0.0, 0.0)
    states, integrator = run(
        build_system(Problem(scene)), "gauss", start, Grid(0.0, 0.01, 1001), Options(rtol, atol)
    )
    assert largest(integrator.state - LECTURE) < bound
    assert largest(states[-1] - LECTURE) < bound
    assert integrator.counters.evaluations < 3000


@pytest.mark.parametrize("method", taking("accelerations from velocities"))
def test_every_method_finds_the_lectures_end(method: str) -> None:
    scene = load_scene(CONFIGS / "double_pendulum.yaml")
    integrator = Integrator(build_system(Problem(scene)), method)
    integrator.reset(0.0, (-np.pi / 2, np.pi / 4, 0.0, 0.0), options(method, 1e-12))
    integrator.advance(10.0)
    assert largest(integrator.state - LECTURE) < max(5e-8, 1e3 * within_reach(method, 1e-12))


# -- a closed loop ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("method", taking("a closed loop"))
def test_a_loop_stays_closed_and_all_methods_agree(method: str) -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml")
    problem = Problem(scene)
    closed = assemble(problem, dict(scene.initial.q or {}), {}, list(scene.initial.hold))
    start = np.concatenate([closed.q, closed.v, [0.0]])
    body = build_system(problem)
    assert body.nz == 1, "the spring's work"
    integrator = Integrator(body, method)
    reference = Integrator(body, "gauss")
    constraints = problem.constraints
    gaps = {"position": constraints.eta, "velocity": constraints.velocity_residual(problem.v)}
    for stop in (1.0, 4.0, 8.0):
        for each, chosen in ((integrator, options(method, 1e-9)), (reference, Options(1e-13, 1e-13))):
            if stop == 1.0:
                each.reset(0.0, start, chosen)
            each.advance(stop)
        q, v, (work,) = np.split(integrator.state, [3, 6])
        values = {"q": q.tolist(), "v": v.tolist(), "t": [stop]}
        assert largest(evaluate(gaps["position"], values)) < 2e-15
        # index 3 leaves a residual of the order of the method
        bound = 2e-15 if methods[method].projects(body) else 1e-8
        assert largest(evaluate(gaps["velocity"], values)) < bound
        assert largest(integrator.state - reference.state) < 1e-5
        (kinetic,) = evaluate([problem.kinetic], values)
        assert abs(kinetic - work) < 1e-6
        # the work of a torque 1.96 - 0.1 theta1 depends on the angle only
        expected = 1.96 * (q[0] - start[0]) - 0.05 * (q[0] ** 2 - start[0] ** 2)
        assert abs(work - expected) < 1e-6


# -- what a System promises -----------------------------------------------------------------------------------
def test_equal_systems_share_code_and_different_ones_do_not() -> None:
    def make(**changes: Any) -> System:
        more = {"events": lambda t, q, v, z, p: [EventFunction("e", q[0], changes.get("direction", 0))]}
        return system(1, lambda t, q, v, z, p: [-changes.get("stiffness", 2.0) * q[0]], **more)

    digest = make().digest
    assert make().digest == digest
    assert make(direction=1).digest != digest
    assert make(stiffness=3.0).digest != digest
    assert dataclasses.replace(make(), events=()).digest != digest
    # times of discontinuities and what an event is called are no business of the code
    assert dataclasses.replace(make(), breakpoints=(1.0,)).digest == digest
    renamed = tuple(dataclasses.replace(e, name="other", owner=Stopping()) for e in make().events)
    assert dataclasses.replace(make(), events=renamed).digest == digest
    assert (
        dataclasses.replace(make(), corrections=Corrections(velocity=(Graph().symbol("v", "v"),))).digest
        != digest
    )


@each_family
def test_systems_that_differ_only_in_python_get_their_own_treatment(method: str) -> None:
    """Two systems with the same code, one stopping at its event: the cache must not mix them up."""
    graph = Graph()
    q = graph.symbol("q0", "q")
    plain = system(1, lambda t, q, v, z, p: [-q[0]])
    ends = []
    for terminal in (True, False):
        body = dataclasses.replace(
            plain, events=(EventFunction("zero", q, -1, owner=Stopping() if terminal else None),)
        )
        integrator = Integrator(body, method)
        integrator.reset(0.0, (0.0, 1.0), options(method, 1e-8))
        integrator.run(4.0, Grid(0.0, 9.0, 1), lambda t, x: None)
        ends.append(integrator.time)
    assert ends == [pytest.approx(np.pi, abs=1e-6), 4.0]

"""The contracts inside: equations in parts, symbolic parameters, discrete memory, formulations that agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.dynamics import Expanded
from robodyn_cli.formulations.events import Event, EventFunction
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.kernels.compiler import REPORT
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.types import Baumgarte
from robodyn_cli.solve.closing.assembly import assemble
from tests.systems import told

CONFIGS = Path(__file__).parents[2] / "configs"
SYMBOLIC = ["links.link2.mass", "joints.theta1.a", "gravity.1"]
GROUPS = ("t", "q", "v", "z", "p")


def test_a_problem_builds_only_what_is_asked_for() -> None:
    problem = Problem(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    assert problem.mass_matrix.shape == (3, 3)
    built = set(vars(problem))
    assert "mass_matrix" in built
    assert not built & {"bias", "forward", "constraints", "kinetic", "potential", "actuator_torques"}


def test_the_parts_of_a_problem_add_up_and_have_derivatives() -> None:
    """M qdd + h = tau_a + tau_f + Psi^T lambda and Psi qdd + gamma = 0, from parts that were built apart."""
    problem = Problem(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    closed = assemble(problem, {"theta1": 0.7, "phi1": 1.0}, {"theta1": 0.4}, ["theta1"])
    values = {"t": [0.0], "q": closed.q.tolist(), "v": closed.v.tolist(), "p": []}

    def numbers(entries: object) -> np.ndarray:
        return np.array(evaluate(list(np.asarray(entries, dtype=object).ravel()), values), dtype=float)

    nv = problem.model.nv
    M, psi = numbers(problem.mass_matrix).reshape(nv, nv), numbers(problem.psi).reshape(-1, nv)
    qdd, lam = numbers(problem.forward.qdd), numbers(problem.forward.lam)
    balance = M @ qdd + numbers(problem.bias) - numbers(problem.applied) - psi.T @ lam
    assert np.abs(balance).max() < 1e-12
    assert np.abs(psi @ qdd + numbers(problem.constraints.gamma)).max() < 1e-12
    rows = jacobian(problem.constraints.eta, problem.q)
    exact = numbers([[row.get(k, 0.0) for k in range(nv)] for row in rows]).reshape(-1, nv)
    assert np.abs(exact - psi).max() < 1e-14


def test_constants_may_stay_parameters() -> None:
    """One compiled kernel serves all values of the symbolic constants, and equals the folded ones."""
    path = CONFIGS / "double_pendulum.yaml"
    kernel = SampleKernel({"a": Problem(load_scene(path), SYMBOLIC).forward.qdd}, GROUPS)
    rng = np.random.default_rng(3)
    q, v = rng.normal(size=(2, 9, 2))
    kernel(q=q, v=v, p=np.ones(3))  # compiles it
    before = REPORT.compiled
    for mass, length, gravity in ((12.456, 1.0, -9.81), (3.0, 0.4, -1.62), (100.0, 2.5, 0.0)):
        changed = load_scene(
            path,
            [
                f"robot.links.link2.mass={mass}",
                f"robot.joints.theta1.a={length}",
                f"gravity=[0, {gravity}, 0]",
            ],
        )
        problem = Problem(changed)
        folded = [
            evaluate(list(problem.forward.qdd), {"t": [0.0], "q": a.tolist(), "v": b.tolist()})
            for a, b in zip(q, v)
        ]
        found = kernel(q=q, v=v, p=np.array([mass, length, gravity]))["a"]
        assert np.abs(found - np.array(folded, dtype=float)).max() < 1e-11 * np.abs(found).max()
    assert REPORT.compiled == before


def test_parameters_reach_the_stepping_loop() -> None:
    path = CONFIGS / "double_pendulum.yaml"
    system = build_system(Problem(load_scene(path), ["gravity.1"]), work=False)
    start = [-1.2, 0.4, 0.0, 0.0]
    ends = []
    for gravity in (-9.81, -1.62):
        integrator = Integrator(system, parameters=[gravity])
        integrator.reset(0.0, start, Options(1e-12, 1e-13))
        integrator.advance(2.0)
        folded = Integrator(
            build_system(Problem(load_scene(path, [f"gravity=[0, {gravity}, 0]"])), work=False)
        )
        folded.reset(0.0, start, Options(1e-12, 1e-13))
        folded.advance(2.0)
        assert np.abs(integrator.state - folded.state).max() < 1e-9
        ends.append(integrator.state)
    assert np.abs(ends[0] - ends[1]).max() > 0.1


def test_a_symbolic_name_that_means_nothing_is_an_error() -> None:
    with pytest.raises(SceneError, match=r"links\.link9\.mass"):
        Problem(load_scene(CONFIGS / "double_pendulum.yaml"), ["links.link9.mass"])


def test_discrete_memory_changes_at_scheduled_events() -> None:
    """A force held in p is switched at given times: the motion is piecewise parabolic, exactly."""
    graph = Graph()
    t, force = graph.symbol("t", "t"), graph.symbol("force", "p", 0)
    times = (0.5, 1.25)
    events = tuple(EventFunction(f"at {x}", t - x, +1) for x in times)
    seen: list[float] = []
    rows: list[np.ndarray] = []

    def switch(event: Event) -> bool:
        seen.append(event.time)
        integrator.p[0] = -integrator.p[0]
        return True

    integrator = Integrator(told(System(1, 1, Expanded((force,)), events=events), switch), parameters=[2.0])
    integrator.reset(0.0, [0.0, 0.0])
    integrator.run(2.0, Grid.over(2.0, 9), lambda time, x: rows.append(x))
    assert np.abs(np.array(seen) - times).max() < 1e-15
    q, v, clock = 0.0, 0.0, 0.0
    for until, a in ((0.5, 2.0), (1.25, -2.0), (2.0, 2.0)):
        h = until - clock
        q, v, clock = q + h * v + 0.5 * a * h * h, v + a * h, until
    assert np.abs(integrator.state - [q, v]).max() < 1e-14
    assert len(np.concatenate(rows)) == 9


@pytest.mark.parametrize("stabilisation", ["projection", "none", Baumgarte(alpha=5.0, beta=5.0)])
def test_formulations_agree_on_the_constraints(stabilisation: str | Baumgarte) -> None:
    """Where the loops are closed, every formulation gives the acceleration of equation (36)."""
    problem = Problem(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    closed = assemble(problem, {"theta1": 1.1, "phi1": 1.4}, {"theta1": -0.8}, ["theta1"])
    system = build_system(problem, stabilisation, work=False)
    values = {"t": [0.0], "q": closed.q.tolist(), "v": closed.v.tolist(), "p": []}
    expected = np.array(evaluate(list(problem.forward.qdd), values), dtype=float)
    found = np.array(evaluate(list(system.acceleration), values), dtype=float)
    assert np.abs(found - expected).max() < 1e-12
    assert bool(system.corrections.position) == (stabilisation == "projection")


def test_the_work_is_a_state_only_where_something_works() -> None:
    free = build_system(Problem(load_scene(CONFIGS / "double_pendulum.yaml")))
    driven = build_system(Problem(load_scene(CONFIGS / "four_bar_deploy.yaml")))
    assert (free.nz, driven.nz) == (0, 1)

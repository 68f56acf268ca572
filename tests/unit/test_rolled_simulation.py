"""Simulations of long chains by loops over their bodies: the same motion as by unrolled code, and true motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError
from robodyn_cli.formulations.build import build_system, is_rolled
from robodyn_cli.formulations.dynamics import Expanded
from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.kernels import compiler, crossover
from robodyn_cli.kernels.rolled.kernels import RolledPlan
from robodyn_cli.over.findings import findings
from robodyn_cli.over.plan.plan import plan as make_plan
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.scene import load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.works.simulate import simulate
from tests.systems import told

METHODS = {
    "gauss": Options(1e-10, 1e-12),
    "dop853": Options(1e-9, 1e-11),
    "dopri5": Options(1e-7, 1e-9),
    "rk4": Options(step=1e-3),
}
FORCES = (
    "",
    ", spring: {stiffness: 3, rest: 0.1}",
    ", damper: {damping: 0.05}, gear_ratio: 20, rotor_inertia: 1e-4",
    ", friction: {viscous: 0.02, coulomb: 0.1, transition_speed: 0.2}",
)
TORQUES = (
    'torques: {j1: "0.4*sin(3*t) - 0.3*qd.j1", j3: "2*q.j0*cos(t)", j4: {table: [[0, 0], [0.1, 1], [1, 0]]}}'
)


def scene(
    joints: int, forces: tuple[str, ...] = (), tree: bool = False, prismatic: bool = False, planar: bool = False,
    extra: str = "", **simulate_keys: Any,
) -> Scene:  # fmt: skip
    """A chain of slender links with skew axes, or a tree of arms of three; the angles at the start are small."""
    rng = np.random.default_rng(joints)
    lines = ["schema: 1", "gravity: [0.3, -9.81, -1]", "robot:", "  convention: modified", "  joints:"]
    for k in range(joints):
        kind = "prismatic" if prismatic and k % 4 == 2 else "revolute"
        parts = [f"name: j{k}, type: {kind}, link: l{k}"]
        parts.append(f"a: {0 if k == 0 else 0.2}, alpha: {0 if planar else (90, 0, -90)[k % 3]} deg")
        parts.append("theta: 20 deg" if kind == "prismatic" else "d: 0")
        if tree and k % 3 == 0 and k:
            parts.append(f"parent: l{max(0, k // 2 - 1)}")
        acting = forces[k % len(forces)] if forces else ""
        if kind == "prismatic":
            acting = ", spring: {stiffness: 300}"  # what slides needs a hold
        lines.append(f"    - {{{', '.join(parts)}{acting}}}")
    lines.append("  links:")
    for k in range(joints):
        inertia = "zz: 0.01" if planar else "xx: 0.002, yy: 0.011, zz: 0.01, xy: 0.0002, xz: -0.0003"
        com = "[0.1, 0.02, 0]" if planar else "[0.1, 0.01, 0.02]"
        lines.append(
            f"    - {{name: l{k}, mass: {1 - 0.3 * k / joints:.4f}, com: {com}, com_frame: link, "
            f"inertia: {{{inertia}}}}}"
        )
    lines.append(f"  points: {{tip: {{link: l{joints - 1}, at: [0.2, 0, 0]}}}}")
    start = ", ".join(f"j{k}: {0.1 * x:.4f}" for k, x in enumerate(rng.normal(size=joints)))
    keys = {"duration": 0.5, "samples": 11, "rtol": 1e-10, "atol": 1e-12, **simulate_keys}
    lines += [extra, f"initial: {{q: {{{start}}}}}"]
    lines.append(f"simulate: {{{', '.join(f'{k}: {v}' for k, v in keys.items())}}}")
    return load_scene_text("\n".join(lines) + "\n")


def systems(source: Scene, monkeypatch: pytest.MonkeyPatch) -> tuple[System, System, np.ndarray]:
    """The system of a scene in both shapes, and its start."""
    monkeypatch.setattr(crossover, "CROSSOVER", 2)
    setup = prepare(source)
    loops, graph = build_system(setup.problem), build_system(setup.problem, expanded=True)
    assert isinstance(loops.dynamics, Rolled) and isinstance(graph.dynamics, Expanded)
    return loops, graph, np.concatenate([setup.assembled.q, setup.assembled.v, np.zeros(loops.nz)])


def run(
    system: System, start: np.ndarray, method: str, options: Options, end: float = 0.5, count: int = 26
) -> tuple[np.ndarray, Integrator]:
    integrator = Integrator(system, method)
    integrator.reset(0.0, start, options)
    rows: list[np.ndarray] = []
    integrator.run(end, Grid.over(end, count), lambda t, x: rows.append(x))
    return np.concatenate(rows), integrator


SCENES = {
    "free": scene(5),
    "forces": scene(6, forces=FORCES, extra=TORQUES),
    "slides": scene(5, prismatic=True),
    "tree": scene(8, forces=FORCES, tree=True, extra=TORQUES),
    "planar": scene(5, planar=True, forces=FORCES),
}


# -- both shapes keep the same contract -----------------------------------------------------------------------
@pytest.mark.parametrize("name", SCENES)
def test_rates_agree(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loops, graph, start = systems(SCENES[name], monkeypatch)
    assert (loops.nq, loops.nv, loops.nz, loops.size) == (graph.nq, graph.nv, graph.nz, graph.size)
    assert loops.breakpoints == graph.breakpoints
    rng = np.random.default_rng(1)
    for _ in range(3):
        x = start + 0.5 * rng.normal(size=start.shape)
        n = loops.nv
        groups = {
            "t": np.array([[0.07]]),
            "q": x[:n, None],
            "v": x[n : 2 * n, None],
            "z": x[2 * n :, None],
            "p": [],
        }
        a, b = loops.dynamics.values(groups), graph.dynamics.values(groups)
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11 * np.abs(b).max())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["forces", "tree"])
def test_same_steps_and_states(name: str, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loops, graph, start = systems(SCENES[name], monkeypatch)
    (a, one), (b, other) = (run(s, start, method, METHODS[method]) for s in (loops, graph))
    assert one.counters.steps > 5
    assert abs(one.counters.steps - other.counters.steps) <= 1
    # where a rounding error changes a step's length, the states differ by their errors
    tolerance = 1e-11 if method == "rk4" else 100 * METHODS[method].rtol
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * np.abs(b).max())


@pytest.mark.parametrize("name", ["free", "slides", "planar"])
def test_same_states_by_collocation(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loops, graph, start = systems(SCENES[name], monkeypatch)
    # a front of friction may hide between the nodes of a long step, as rounding has it
    options = dataclasses.replace(METHODS["gauss"], max_step=0.01)
    (a, one), (b, other) = (run(s, start, "gauss", options) for s in (loops, graph))
    assert abs(one.counters.steps - other.counters.steps) <= 1
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * np.abs(b).max())


def test_events_are_found_in_either_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crossover, "CROSSOVER", 2)
    setup = prepare(SCENES["forces"])
    q = setup.problem.q
    watched = (EventFunction("straight", q[1] + 0.1 * setup.problem.v[2]),)
    start = np.concatenate([setup.assembled.q, setup.assembled.v, [0.0]])
    for method in ("gauss", "dop853"):
        found: list[list[tuple[float, np.ndarray]]] = []
        for expanded in (False, True):
            system = build_system(setup.problem, events=watched, expanded=expanded)
            seen: list[tuple[float, np.ndarray]] = []

            def on_event(event: Any, seen: list[tuple[float, np.ndarray]] = seen) -> bool:
                seen.append((event.time, event.state))
                return True

            integrator = Integrator(told(system, on_event), method)
            integrator.reset(0.0, start, METHODS[method])
            integrator.run(0.5, Grid.over(0.5, 3), lambda t, x: None)
            found.append(seen)
        assert len(found[0]) == len(found[1]) > 0
        for (t, x), (u, y) in zip(*found):
            assert t == pytest.approx(u, abs=1e-7)
            np.testing.assert_allclose(x, y, rtol=0, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_runs_stop_and_resume(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loops, _, start = systems(SCENES["forces"], monkeypatch)
    whole, one = run(loops, start, method, METHODS[method], end=0.4, count=41)
    integrator = Integrator(loops, method)
    integrator.reset(0.0, start, METHODS[method])
    rows: list[np.ndarray] = []
    integrator.run(0.4, Grid.over(0.4, 41), lambda t, x: rows.append(x), block=3)
    np.testing.assert_array_equal(np.concatenate(rows), whole)
    again = Integrator(loops, method)
    again.reset(0.0, start, METHODS[method])
    again.advance(0.2)
    middle = again.state
    third = Integrator(loops, method)
    third.reset(0.2, middle, METHODS[method])
    third.advance(0.4)
    np.testing.assert_allclose(third.state, whole[-1], rtol=0, atol=1e-6 * np.abs(whole).max())
    assert one.counters.steps > 0


def test_code_serves_chains_of_any_length(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    monkeypatch.setattr(compiler, "_loaded", {})
    digests = set()
    before = compiler.REPORT.compiled
    for joints in (18, 30, 45):
        system, start = made(scene(joints))
        digests.add(system.digest)
        x, _ = run(system, start, "gauss", METHODS["gauss"], end=0.02, count=2)
        assert x.shape == (2, 2 * joints) and np.all(np.isfinite(x))
    assert len(digests) == 1
    assert compiler.REPORT.compiled == before + 1


def made(source: Scene) -> tuple[System, np.ndarray]:
    setup = prepare(source)
    system = build_system(setup.problem)
    assert isinstance(system.dynamics, Rolled)
    return system, np.concatenate([setup.assembled.q, setup.assembled.v, np.zeros(system.nz)])


# -- true motion ------------------------------------------------------------------------------------------------
def test_a_hundred_joints_move_as_scipy_says() -> None:
    from scipy.integrate import solve_ivp

    from robodyn_cli.torques.dynamics import ForwardDynamics

    source = scene(100, forces=FORCES[:3], extra=TORQUES)
    system, start = made(source)
    n = system.nv
    dynamics = ForwardDynamics(source)  # springs and dampers included, torques not
    assert dynamics.shape == "rolled"

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        q, v, tau = x[:n], x[n:], np.zeros(n)
        tau[1] = 0.4 * np.sin(3 * t) - 0.3 * v[1]
        tau[3] = 2 * q[0] * np.cos(t)
        tau[4] = np.interp(t, [0, 0.1, 1], [0, 1, 0])
        return np.concatenate([v, dynamics(q[None], v[None], tau[None])[0]])

    end = 0.1
    truth = solve_ivp(rate, (0.0, end), start[: 2 * n], method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    for method, options in (("gauss", Options(1e-10, 1e-12)), ("dop853", Options(1e-10, 1e-12))):
        got, _ = run(system, start, method, options, end=end, count=3)
        np.testing.assert_allclose(got[-1, : 2 * n], truth, rtol=0, atol=1e-8 * np.abs(truth).max())


def test_a_chain_hangs_as_mujoco_says() -> None:
    mujoco = pytest.importorskip("mujoco")
    n = 40
    half, radius = 0.1, 0.02
    body, close = "", ""
    axes = ("0 0 1", "0 1 0", "1 0 1")
    for k in range(n):
        place = "0 0 0" if k == 0 else f"{2 * half} 0 0"
        body += f'<body pos="{place}"><joint type="hinge" axis="{axes[k % 3]}"/>'
        body += f'<inertial pos="{half} 0.01 0" mass="0.5" diaginertia="0.0001 0.0017 0.0017"/>'
        body += f'<geom type="capsule" size="{radius}" fromto="0 0 0 {2 * half} 0 0" contype="0" conaffinity="0"/>'
        close += "</body>"
    text = f'<mujoco><option gravity="0 0 -9.81"/><worldbody>{body}{close}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    q, v = 0.3 * rng.normal(size=n), 0.3 * rng.normal(size=n)
    lines = ["schema: 1", "gravity: [0, 0, -9.81]", "robot:", "  joints:"]
    for k in range(n):
        place = 0 if k == 0 else 2 * half
        axis = axes[k % 3].replace(" ", ", ")
        lines.append(
            f"    - {{name: j{k}, type: revolute, link: l{k}, origin: {{xyz: [{place}, 0, 0]}}, axis: [{axis}]}}"
        )
    lines.append("  links:")
    for k in range(n):
        lines.append(
            f"    - {{name: l{k}, mass: 0.5, com: [{half}, 0.01, 0], com_frame: link, "
            "inertia: {xx: 1.0e-4, yy: 1.7e-3, zz: 1.7e-3}}"
        )
    for name, values in (("q", q), ("qd", v)):
        inner = ", ".join(f"j{k}: {x!r}" for k, x in enumerate(values.tolist()))
        lines.append(f"initial: {{q: {{{inner}}}, " if name == "q" else f"  qd: {{{inner}}}}}")
    lines.append("simulate: {duration: 0.1, samples: 3, rtol: 1e-10, atol: 1e-12}")
    system, start = made(load_scene_text("\n".join(lines) + "\n"))
    rates = system.dynamics.values(
        {"t": np.zeros((1, 1)), "q": q[:, None], "v": v[:, None], "z": [], "p": []}
    )
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(rates, data.qacc, rtol=0, atol=1e-9 * np.abs(data.qacc).max())
    x, _ = run(system, start, "gauss", Options(1e-10, 1e-12), end=1e-4, count=2)
    np.testing.assert_allclose(
        x[-1, n:] - v, 1e-4 * data.qacc, rtol=0, atol=1e-3 * 1e-4 * np.abs(data.qacc).max()
    )


def test_energy_stays() -> None:
    result = simulate(scene(30, duration=1.0))
    summary = result.summary
    assert summary["integrator"] == "gauss"
    assert summary["energy_drift_relative"] < 1e-9
    assert summary["error_estimate"]["state_max"] < 1e-5
    energy = result["energy/kinetic"] + result["energy/potential"]
    assert np.ptp(result["energy/kinetic"]) > 1.0 and np.ptp(energy) < 1e-7


def test_energy_is_balanced_by_work() -> None:
    summary = simulate(scene(20, forces=FORCES, tree=True, extra=TORQUES)).summary
    assert summary["energy_balance"] == "kinetic + potential - work"
    assert summary["energy_drift_relative"] < 1e-8


def test_observation_is_that_of_unrolled_code(monkeypatch: pytest.MonkeyPatch) -> None:
    source = scene(6, forces=FORCES, extra=TORQUES)
    monkeypatch.setattr(crossover, "CROSSOVER", 2)
    loops = simulate(source)
    monkeypatch.setattr(crossover, "CROSSOVER", 100)
    graph = simulate(source)
    assert set(loops.variables) == set(graph.variables)
    for path in graph.variables:
        expected = graph[path]
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(loops[path], expected, rtol=0, atol=1e-6 * scale, err_msg=path)


# -- around it --------------------------------------------------------------------------------------------------
def test_whole_graph_is_never_built(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: Any) -> Any:
        raise AssertionError("the accelerations of a long chain were written out")

    monkeypatch.setattr(Problem, "free_accelerations", refuse)
    result = simulate(scene(60, forces=FORCES, duration=0.02, samples=3, rtol=1e-6))
    assert result["qdd"].shape == (3, 60)


def test_a_thousand_joints() -> None:
    system, start = made(scene(1000))
    x, integrator = run(system, start, "gauss", Options(1e-4, 1e-6), end=0.005, count=2)
    assert np.all(np.isfinite(x)) and integrator.counters.steps > 0
    plan = RolledPlan(system.dynamics.model, "forward")  # type: ignore[attr-defined]
    memory = sum(a.nbytes for a in (*integrator.engine.fixed, integrator.memory))
    assert memory < 20_000 * plan.nv


def test_linearly_implicit_methods_say_why_not() -> None:
    with pytest.raises(CapabilityError, match="'rodas5p' does not do .* 20 joints .* exact Jacobian"):
        simulate(scene(20, integrator="rodas5p"))


@pytest.mark.parametrize("method", ["radau13", "bdf", "generalized_alpha"])
def test_a_refusal_names_methods_that_do(method: str) -> None:
    with pytest.raises(CapabilityError, match=r"allowed: auto, gauss$"):
        simulate(scene(20, integrator=method, **({"step": 1e-3} if method == "generalized_alpha" else {})))


def test_a_run_that_blows_up_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    loops, _, start = systems(scene(4, extra='torques: {j1: "1e3*qd.j1^3 + 1"}'), monkeypatch)
    with pytest.raises(NumericalError, match="too small|finite"):
        run(loops, start, "gauss", Options(1e-8, 1e-10), end=5.0)


def test_unrolled_where_something_is_unknown_or_prescribed() -> None:
    source = scene(20, extra='prescribed: {j0: "0.1*t^2"}')
    start = dataclasses.replace(source.initial, q={k: v for k, v in source.initial.q.items() if k != "j0"})
    problem = Problem(dataclasses.replace(source, initial=start))
    assert not is_rolled(problem)
    assert is_rolled(Problem(scene(20)))


def test_plan_and_validation(tmp_path: Path) -> None:
    source = scene(20, forces=FORCES)
    plan = make_plan(source, "simulate")
    kernel = plan["kernels"][0]
    assert (kernel["shape"], kernel["lanes"], kernel["lanes_hold"]) == ("rolled", 8, "stages")
    path = tmp_path / "chain.yaml"
    path.write_text(source.text)
    assert [f for f in findings(path) if f.severity == "error"] == []

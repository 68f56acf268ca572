"""Errors and residuals of a run, each made as large as the test likes, and figures recomputed from the datasets."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError, NumericalError
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion import self_check
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.conditioning import Conditioning
from robodyn_cli.motion.error import MARGIN, First, remainder
from robodyn_cli.observe.joint_limits import Bound
from robodyn_cli.observe.singular_values import LeastNorm
from robodyn_cli.over.many import simulate as many_simulate
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.summaries.facts import ABSENT, PeakLoad, fact
from robodyn_cli.summaries.inverse import definitions_of
from robodyn_cli.summaries.motion import Counters
from robodyn_cli.torques.checks import Loaded, attitude_error, error_estimate, path_error
from robodyn_cli.torques.program import InverseProgram
from robodyn_cli.works.inverse import inverse, program_of
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate
from robodyn_cli.works.statics import held, holding_joints, summarise
from tests.mechanisms import BENNETT, CONFIGS, SLIDER

ARM = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}
  links:
    - {name: A, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.2}}
    - {name: B, mass: 1, com: [0.4, 0.1, 0], inertia: {zz: 0.1}}
  points: {tip: {link: B, at: [0.8, 0, 0]}}
trajectory: {type: joint, duration: 2, q: {a: "0.7*t + sin(3*t)", b: "cos(4*t)"}}
inverse: {samples: 41}
initial: {q: {a: 0.3, b: 0.4}, qd: {a: 1, b: -2}}
simulate: {duration: 2, samples: 21}
"""


# -- inverse: an error that is put in is told ----------------------------------------------------------------------
def made(text: str = ARM) -> tuple[InverseProgram, Any, Any]:
    """Return the program of an inverse run, its motion and its samples."""
    program = program_of(load_scene_text(text))
    planned = program.plan(program.times(41))
    return program, planned, program.evaluate(planned, program.compile(41))


def test_a_path_that_is_missed_by_so_much() -> None:
    _, planned, sampled = made()
    there = sampled.arrays["points/tip"][:, :2]
    off = dataclasses.replace(planned, point="tip", target=there + np.array([0.003, -0.004]))
    assert path_error(off, sampled) == pytest.approx(0.005, rel=1e-12)


def test_an_attitude_that_is_missed_by_so_much() -> None:
    program, planned, _ = made()
    angle = planned.motion.q.sum(axis=1) + np.linspace(0.0, 0.01, 41)
    c, s, one, zero = np.cos(angle), np.sin(angle), np.ones(41), np.zeros(41)
    axes = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    off = dataclasses.replace(planned, point="tip", axes=axes)
    assert attitude_error(program.problem, off) == pytest.approx(0.01, rel=1e-9)


def test_accelerations_that_the_torques_do_not_give() -> None:
    program, planned, sampled = made()
    motion = sampled.motion
    shifted = dataclasses.replace(sampled, motion=dataclasses.replace(motion, qdd=motion.qdd + 0.01))
    loaded = Loaded.of(program.problem, sampled)
    errors = error_estimate(program, planned, shifted, loaded)
    free = np.abs(program.forward(sampled)[1]).max()  # type: ignore[index]
    assert errors.round_trip == pytest.approx(0.01 / max(np.abs(motion.qdd + 0.01).max(), free), rel=1e-9)


def test_rounding_of_torques_is_some_units_in_the_last_place() -> None:
    found = inverse(load_scene_text(ARM))
    unit = np.finfo(float).eps * np.abs(found["tau"]).max()
    assert 0.1 * unit < found.summary["error_estimate"]["torque_rounding"] < 100.0 * unit


def test_the_balance_of_energy_is_what_the_samples_leave_of_the_work() -> None:
    """At few samples the work is off, by what it is on many; the energy is exact at both ends."""
    coarse, fine = (inverse(load_scene_text(ARM, overrides=[f"inverse.samples={n}"])) for n in (61, 2001))
    work, true = (sum(x["energy_net"] for x in run.summary["joints"].values()) for run in (coarse, fine))
    balance = coarse.summary["error_estimate"]["energy_balance"]
    assert abs(work - true) > 1e-6
    assert balance == pytest.approx(work - true, rel=1e-3)
    assert coarse.summary["error_estimate"]["energy_quadrature"] >= abs(work - true)
    # relative to the work that is turned over, as there is more of it than change of energy
    over = trapezoid(np.abs((coarse["tau"] * coarse["qd"]).sum(axis=1)), coarse.time)
    change = np.ptp(coarse["energy/kinetic"] + coarse["energy/potential"])
    relative = coarse.summary["error_estimate"]["energy_balance_relative"]
    assert relative == pytest.approx(balance / max(over, change), rel=0.5, abs=0.0)


def test_loads_that_neither_actuators_nor_loops_bear() -> None:
    text = (
        "schema: 1\n"
        + SLIDER
        + "actuated: [crank]\ntrajectory: {type: joint, duration: 1, q: {crank: 0.2 + t}}\n"
    )
    found = inverse(load_scene_text(text, overrides=["inverse.samples=41"]))
    residual = found.summary["error_estimate"]["virtual_work_residual"]
    assert 0.0 < residual < 1e-12 * np.abs(found["tau"]).max() * 100.0


# -- simulations: figures from the datasets ------------------------------------------------------------------------
def test_the_drift_of_energy_is_that_of_its_dataset() -> None:
    settings = ["simulate.integrator=rk4", "simulate.step=0.05", "simulate.samples=41"]
    found = simulate(load_scene_text(ARM, overrides=settings))
    total, kinetic, potential = (found[f"energy/{x}"] for x in ("total", "kinetic", "potential"))
    drift = np.abs(total - total[0]).max()
    assert drift > 1e-6 and found.summary["energy_drift"] == drift
    scale = max(np.ptp(potential), kinetic.max())
    assert found.summary["energy_drift_relative"] == pytest.approx(drift / scale, rel=1e-12)


def test_residuals_of_loops_are_those_of_their_datasets() -> None:
    settings = [
        "simulate.integrator=rk4",
        "simulate.step=0.02",
        "simulate.stabilisation=none",
        "simulate.duration=1",
    ]
    found = simulate(load_scene_text("schema: 1\n" + SLIDER, overrides=settings))
    for name in ("position", "velocity"):
        largest = np.abs(found[f"constraints/{name}_residual"]).max()
        assert largest > 1e-9 and found.summary["constraint_residual"][name] == largest


def test_rows_that_were_left_out_are_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene_text(
        "schema: 1\n" + BENNETT,
        overrides=["simulate.duration=0.1", "simulate.samples=3", "simulate.error_estimate=false"],
    )
    residual = simulate(scene).summary["constraint_residual"]["redundant"]
    assert 0.0 < residual < 1e-9
    monkeypatch.setattr(self_check, "OPEN", 0.1 * residual / 4.0)
    with pytest.raises(GeometryError, match="followed from the other constraints") as caught:
        simulate(scene)
    assert caught.value.details["residual"] == pytest.approx(residual, rel=0.5)


def test_many_runs_lose_no_more_energy_than_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the judge of one run refuses, that of many does not let pass."""
    path = CONFIGS / "double_pendulum.yaml"
    settings = [
        "simulate.error_estimate=false",
        "simulate.rtol=1e-4",
        "simulate.atol=1e-4",
        "simulate.duration=1",
    ]
    mechanism = Mechanism(load_scene(path, settings), ["initial.q.theta1"])
    assert mechanism.simulate_many({"initial.q.theta1": [0.1, 0.2]}).code.tolist() == [0, 0]
    monkeypatch.setattr(self_check, "BEYOND", 1e-9)
    assert mechanism.simulate_many({"initial.q.theta1": [0.1, 0.2]}).code.tolist() == [3, 3]
    with pytest.raises(NumericalError, match="balance of energy") as caught:
        simulate(load_scene(path, settings))
    summary = caught.value.result.summary  # type: ignore[union-attr]
    assert caught.value.details["energy_drift"] == summary["energy_drift"] > 0.0
    assert "multipliers" not in summary and "constraint_residual" not in summary


def test_many_runs_by_several_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each row has the end of a run by its own method."""
    mechanism = Mechanism(
        load_scene_text(ARM, overrides=["simulate.duration=0.2", "simulate.samples=3"]), ["initial.q.a"]
    )
    values = {"initial.q.a": [0.1, 0.2, 0.3, 0.4, 0.5]}
    alone = mechanism.simulate_many(values, of=["counters.steps"])
    methods = np.array(["gauss", "dopri5", "gauss", "gauss", "dopri5"])
    monkeypatch.setattr(many_simulate, "method_of", lambda batch: (methods, methods == ""))
    mixed = mechanism.simulate_many(values)
    assert mixed.code.tolist() == [0] * 5
    np.testing.assert_allclose(mixed.q, alone.q, rtol=1e-5)
    assert (mixed.steps == alone.steps).tolist() == (methods == "gauss").tolist()


def test_an_estimate_that_is_not_asked_for_is_not_made() -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml", ["simulate.error_estimate=false"])
    found = Mechanism(scene).deploy_many(of=["lock.time", "lock.time_error"])
    assert found.code.tolist() == [0] and np.isnan(found.outputs["lock.time_error"]).all()
    assert found.outputs["lock.time"][0] == pytest.approx(12.282995609, abs=1e-5)


def test_a_loop_that_is_open_by_so_much_at_rest() -> None:
    problem = Problem(load_scene_text("schema: 1\n" + SLIDER, overrides=["actuated=[crank]", "torques=null"]))
    rod = -np.arcsin(0.3 * np.sin(0.2) / 0.9) - 0.2
    q = np.array([0.2, rod, 0.3 * np.cos(0.2) + 0.9 * np.cos(0.2 + rod)])
    state = held(problem, q)
    for off in (0.0, 0.01):
        told: Any = summarise(dataclasses.replace(state, q=q + np.array([0.0, 0.0, off])), None, ABSENT)
        assert told.constraint_residual.position == pytest.approx(off, abs=1e-15)


@pytest.mark.parametrize("method", ["verlet", "implicit_midpoint"])
def test_an_oscillator_by_a_method_of_second_order(method: str) -> None:
    """The second run's own error is a fifth of the first's: an estimate that forgets it is a fifth too small."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: body, mass: 1}]
torques: {x: "-q.x"}
initial: {q: {x: 1}}
"""
    settings = [
        f"simulate.integrator={method}",
        "simulate.step=0.05",
        "simulate.duration=10",
        "simulate.samples=41",
    ]
    found = simulate(load_scene_text(text, overrides=settings))
    estimate = found.summary["error_estimate"]
    for path, exact in (("q", np.cos(found.time)), ("qd", -np.sin(found.time))):
        assert estimate[f"{path}_max"] == pytest.approx(
            MARGIN * np.abs(found[path][:, 0] - exact).max(), rel=0.03
        )


def test_what_the_second_run_hides() -> None:
    """MARGIN / (1 - (n1/n2)^p) for an order p, of the dense output where that is lower, and the quotient at most 2."""
    for name, method in methods.items():
        first = First(Options(rtol=1e-7, atol=1e-9), name, np.array([100]), np.array([1.0]))
        p = min(method.order, method.dense_order + 1)
        for more in (100, 110, 150, 300):
            exact = min(1.0 / (1.0 - (100 / more) ** p) if more > 100 else 2.0, 2.0)
            assert remainder(first, np.array([more]))[0] == pytest.approx(MARGIN * exact, rel=1e-12), name


def test_closing_loops_near_a_dead_point_is_ill_conditioned() -> None:
    """A slider-crank, its crank in line with the rod but for an angle: the rows hardly determine the crank."""
    closing = []
    for angle in (0.3, 0.003):
        scene = load_scene_text("schema: 1\n" + SLIDER, overrides=[f"initial.q.crank={angle}"])
        problem = Problem(scene)
        rod = -np.arcsin(0.3 * np.sin(angle) / 0.9) - angle
        q = np.array([[angle, rod, 0.3 * np.cos(angle) + 0.9 * np.cos(angle + rod)]])
        nothing = np.zeros((1, 1, 3)), np.zeros((1, 1, 0))
        slide = problem.model.v_names.index("slide")
        found = Conditioning.of(problem, [slide], np.zeros((1, 1)), (q[None], *nothing))
        psi = problem.numbers(list(problem.psi.ravel()), q[0]).reshape(-1, 3)
        least = np.linalg.svd(np.delete(psi, [slide], axis=1), compute_uv=False)[-1]
        # three terms, of which the largest is 1.2
        assert 1.5e-16 < found.closing[0] * least < 1e-15
        closing.append(found.closing[0])
    assert 20.0 * closing[0] < closing[1] < 400.0 * closing[0]


# -- limits --------------------------------------------------------------------------------------------------------
def test_a_limit_is_passed_beyond_rounding() -> None:
    """By more than 1e-9 of it, or of 1 where it is smaller; the sentence begins with the first sample that is."""
    for limit, over, passed in [
        (0.01, 0.5e-9, False),
        (0.01, 1.5e-9, True),
        (-3.0, 2.5e-9, False),
        (-3.0, 3.5e-9, True),
        (200.0, 1.5e-7, False),
        (200.0, 2.5e-7, True),
        (0.01, -1.0, False),
    ]:
        beyond = np.array([-1.0, 0.3 * over if over > 0.0 else -1.0, over, over])
        times = np.arange(4.0)
        bound = Bound("speed", limit, limit + beyond, beyond, "rad/s", times)
        assert bound.passed is passed
        if passed:
            assert f"limit of {limit:g} rad/s from t = 2 s" in bound.sentence("j", ())


def test_limits_that_are_kept_are_not_told() -> None:
    limits = "limits: {lower: -10, upper: 10, speed: 100, acceleration: 1000, jerk: 1e5, effort: 1e4}"
    text = ARM.replace("axis: [0, 0, 1]}", f"axis: [0, 0, 1], {limits}}}")
    assert "warnings" not in inverse(load_scene_text(text)).summary
    tight = inverse(
        load_scene_text(text.replace("upper: 10", "upper: 0.5").replace("jerk: 1e5", "jerk: 20"))
    ).summary
    assert [w.split("'")[1] + w.split(" its ")[1][:5] for w in tight["warnings"]] == ["aupper", "ajerk "]


# -- control -------------------------------------------------------------------------------------------------------
def test_figures_of_a_controller() -> None:
    """Errors, torques at their limits, work and updates, from the samples of the run; limits that are not there."""
    for period in ["", ", period: 0.02, delay: 0.01"]:
        text = ARM.replace(
            "{name: a, type: revolute, axis: [0, 0, 1]}",
            "{name: a, type: revolute, axis: [0, 0, 1], limits: {effort: 30}}",
        )
        control = f"control: {{type: pd, joints: [a, b], gains: {{kp: 60, kd: 6}}{period}}}\n"
        found = simulate(load_scene_text(text + control, overrides=["simulate.samples=4001"]))
        told, t = found.summary["control"], found.time
        wanted = np.column_stack([0.7 * t + np.sin(3.0 * t), np.cos(4.0 * t)])
        np.testing.assert_allclose(found["control/error"], wanted - found["q"], atol=1e-12)
        for k, name in enumerate("ab"):
            one = told["tracking"][name]
            assert one["peak"] == pytest.approx(np.abs(found["control/error"][:, k]).max(), rel=1e-3)
            assert one["rms"] == pytest.approx(
                np.sqrt(trapezoid(found["control/error"][:, k] ** 2, t) / 2.0), rel=1e-3
            )
        at = np.abs(found["control/torque"][:, 0]) > 30.0 * (1.0 - 1e-9)
        assert 20 < at.sum() < 3990
        assert told["saturated"] == {"a": pytest.approx(at.sum() * 5e-4, abs=0.01)}
        # held torques jump: trapezia miss half a sample at each update
        power = found["control/torque"] * found["qd"]
        assert told["energy"]["driving"] == pytest.approx(
            trapezoid(np.maximum(power, 0.0), t, axis=0).sum(), rel=1e-2
        )
        assert (told.get("delay"), told.get("period"), told.get("updates")) == (
            (0.01, 0.02, 101) if period else (None,) * 3
        )


def test_rounding_of_what_payloads_change_is_not_told() -> None:
    """Their parameters change on the way; loops are judged all the same, and there are none here."""
    problem = build_motion(load_scene(CONFIGS / "catching_arm.yaml")).problem
    nq, nv = problem.model.nq, problem.model.nv
    found = Conditioning.of(problem, [], np.zeros(1), (np.ones((1, nq)), np.ones((1, nv)), np.zeros((1, 0))))
    assert found == Conditioning(0.0, 0.0, 0.0)


# -- datasets ------------------------------------------------------------------------------------------------------
def test_what_stands_on_what() -> None:
    found = inverse(load_scene_text(ARM + "outputs: {reactions: true}\n"))
    meanings = {name: found.variables[f"reactions/{name}"].long_name for name in "ab"}
    assert meanings["a"].startswith("what base exerts on A,") and meanings["b"].startswith(
        "what A exerts on B,"
    )
    assert found.variables["q"].dims == found.variables["qd"].dims == ("time", "joint")


def test_positions_of_a_ball_are_more_than_its_rates() -> None:
    text = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{name: ball, type: spherical}]
  links: [{name: body, mass: 1, com: [0, 0, -1], inertia: {xx: 1, yy: 2, zz: 3}}]
initial: {q: {ball: [1, 0, 0, 0]}, qd: {ball: [1, 2, 3]}}
simulate: {duration: 0.1, samples: 3, integrator: rk4, step: 0.05}
"""
    found = simulate(load_scene_text(text))
    dims = {path: (found.variables[path].dims, found[path].shape) for path in ("q", "qd")}
    assert dims == {"q": (("time", "position"), (3, 4)), "qd": (("time", "joint"), (3, 3))}


def test_least_norm_is_the_pseudo_inverse() -> None:
    """Of rows of which one follows from the others, and of a pose in which one more does."""
    rng = np.random.default_rng(6)
    rows = rng.normal(size=(2, 4))
    A = np.stack([np.vstack([rows, rows.sum(axis=0)]), np.vstack([rows[:1], rows[:1], 2.0 * rows[:1]])])
    solver = object.__new__(LeastNorm)
    solver.rank = 2
    residual = rng.normal(size=(2, 3))
    for k in range(2):
        assert np.allclose(
            solver._solve(A, residual)[k], np.linalg.pinv(A[k], rcond=1e-9) @ residual[k], atol=1e-12
        )


# -- records of summaries ------------------------------------------------------------------------------------------
def test_the_larger_of_two_loads() -> None:
    """Force and moment each for themselves; the error covers the smaller one with its own."""
    one, other = PeakLoad(5.0, 1.0, 0.1, 0.2), PeakLoad(4.0, 2.0, 1.5, 0.1)
    for found in (one.or_larger(other), other.or_larger(one)):
        assert (found.peak_force, found.peak_moment) == (5.0, 2.0)
        assert (found.force_error, found.moment_error) == pytest.approx((0.5, 0.1))


def test_definitions_are_those_of_what_there_is() -> None:
    assert "virtual_work_residual" in definitions_of(True) and "virtual_work_residual" not in definitions_of(
        False
    )
    assert "round_trip" in definitions_of(False)


def test_kinds_of_names_of_a_map() -> None:
    for names, kinds in (("LINK", ("LINK",)), (("JOINT", "base"), ("JOINT", "base"))):
        assert fact("", names=names).metadata["fact"].names == kinds


def test_the_stroke_and_the_attempts() -> None:
    """A slider-crank: from b - a to b + a; steps that were refused are attempts, too."""
    text = "schema: 1\n" + SLIDER.replace("torques: {crank: 5}", 'prescribed: {crank: "0.2 + 2*pi*t"}')
    text = text.replace("duration: 3, samples: 31", "duration: 1") + "kinematics: {samples: 61}\n"
    summary = kinematics(load_scene_text(text)).summary
    ranges = summary["joints"]["slide"]
    assert 0.0 < summary["singular_ratio"]["smallest"] < 1.0
    assert (ranges["smallest"], ranges["largest"]) == pytest.approx((0.6, 1.2), rel=1e-6)
    one = simulate(load_scene_text(ARM, overrides=["simulate.duration=0.1"])).summary["counters"]
    assert Counters(**{**one, "steps": 7, "rejected": 2}).attempts == 9


def test_prescribed_joints_alone_close_no_loop() -> None:
    text = ARM.replace("trajectory:", "outputs: {}\ntrajectory:")
    settings = [
        "prescribed={a: 0.3*t}",
        "simulate.duration=0.1",
        "simulate.samples=3",
        "initial={q: {b: 0.4}}",
    ]
    found = simulate(load_scene_text(text, overrides=settings))
    assert "constraints/multipliers" in found and not [
        path for path in found.variables if path.startswith("singularity")
    ]


def test_who_holds_a_mechanism() -> None:
    """In an open chain all joints; in loops those with a torque, or all where none has one."""
    chain = Problem(load_scene_text(ARM, overrides=["torques={a: 1}"]))
    assert holding_joints(chain) == ("a", "b")
    loops = "schema: 1\n" + SLIDER
    assert holding_joints(Problem(load_scene_text(loops))) == ("crank",)
    free = Problem(load_scene_text(loops, overrides=["torques=null", "initial.hold=[]"]))
    assert holding_joints(free) == ("crank", "rod", "slide")

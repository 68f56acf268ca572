"""Numbers that are not finite: refused by name, time and cause, never written into a result, never a warning."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import assemble, deploy, inverse, kinematics, load_scene, load_scene_text, simulate, statics
from robodyn_cli.errors import NumericalError, RobodynError, SceneError
from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.observe.evaluation import cause
from robodyn_cli.over.findings import findings
from robodyn_cli.results.result import Result
from tests.mechanisms import CONFIGS

ARM = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [%(length)s, 0, 0]}}
  links:
    - {name: l, mass: %(mass)s, com: [%(com)s, 0, 0], inertia: {zz: 0.1}}
    - {name: m, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}
initial: {q: {a: 0, b: 0}}
simulate: {duration: 0.1, samples: 11}
inverse: {samples: 11}
"""
PLAIN = ARM % {"length": 1, "mass": 1, "com": 0.5}
SWING = "trajectory: {type: joint, duration: 1, q: {a: sin(t), b: 0.3*t}}\n"


def numbers_of(value: Any) -> list[float]:
    if isinstance(value, float):
        return [value]
    entries = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [x for entry in entries for x in numbers_of(entry)]


def is_finite(result: Result) -> bool:
    arrays = [item.data for item in result.variables.values()]
    return all(np.isfinite(x).all() for x in (*arrays, numbers_of(result.summary)))


@pytest.mark.parametrize("command", [inverse, kinematics, statics])
@pytest.mark.parametrize("seed", range(8))
def test_huge_numbers_give_finite_results_or_a_refusal(command: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scales = {key: f"1e{rng.choice([0, 100, 160, 200, 300])}" for key in ("length", "mass", "com")}
    scene = load_scene_text(ARM % scales + SWING)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            assert is_finite(command(scene))
        except RobodynError as error:
            assert error.exit_code in (3, 4)


@pytest.mark.parametrize("command", [inverse, kinematics, statics, assemble])
@pytest.mark.parametrize(
    "name", ["four_bar_prescribed", "benchmarks/adams_distance", "benchmarks/simple_pendulum"]
)
def test_huge_masses_in_loops_do_not_stop_the_linear_algebra(name: str, command: Any) -> None:
    path = CONFIGS / f"{name}.yaml"
    links = [link.name for link in load_scene(path).robot.links if link.mass]
    options = ["inverse.samples=11", "kinematics.samples=11"]
    scene = load_scene(path, [*options, *(f"robot.links.{link}.mass=1e155" for link in links)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            assert is_finite(command(scene))
        except RobodynError as error:
            assert error.exit_code in (2, 3, 4)


def test_the_refusal_names_dataset_time_and_cause() -> None:
    huge = load_scene_text(ARM % {"length": 1, "mass": "1e200", "com": "1e150"} + SWING)
    with pytest.raises(
        NumericalError, match=r"torque_terms/\w+ is not finite at t = 0 s: .*1.8e308"
    ) as found:
        inverse(huge)
    assert found.value.exit_code == 3
    assert found.value.details["dataset"].startswith("torque_terms/") and found.value.details["time"] == 0.0


@pytest.mark.parametrize("command", [inverse, kinematics])
def test_a_removable_singularity_on_a_sample_is_refused(command: Any) -> None:
    """sin(x)/x at x = 0, and between the samples it is none."""
    text = PLAIN + "trajectory: {type: joint, duration: 1, q: {a: sin(t-0.5)/(t-0.5), b: 0}}\n"
    name = command.__name__
    with pytest.raises(
        NumericalError, match=r"a = 'sin\(t-0.5\)/\(t-0.5\)' has no finite value at t = 0.5 s"
    ):
        command(load_scene_text(text, overrides=[f"{name}.samples=11"]))
    assert is_finite(command(load_scene_text(text, overrides=[f"{name}.samples=10"])))


def test_the_cause_is_the_first_operation_without_a_value() -> None:
    graph = Graph()
    x, y = graph.symbols(["x", "y"], "q")
    values = {"q": [0.0, -1.0]}
    assert cause([1.0 / x + y * y], values) == "1 / 0 has no value"
    assert cause([y + graph.unary("sqrt", y) * x], values) == "sqrt(-1) has no value"
    assert "1e+200 * 1e+200 exceeds" in cause([x * y], {"q": [1e200, 1e200]})


def test_expressions_without_a_value_are_evaluated_as_compiled_code_does() -> None:
    """A branch that is not taken may divide by zero; elsewhere the result is an infinity or NaN."""
    graph = Graph()
    x, y = graph.symbols(["x", "y"], "q")
    taken = graph.where(x, y / x, 2.0)
    found = evaluate([taken, y / x, graph.unary("log", x), graph.unary("sqrt", -y), 3.0], {"q": [0.0, 1.0]})
    assert (
        found[0] == 2.0
        and found[1] == np.inf
        and found[2] == -np.inf
        and np.isnan(found[3])
        and found[4] == 3.0
    )
    assert all(isinstance(value, float) for value in found)


FORMULAS = ["1/b", "log(b)", "sqrt(b-1)", "b/t", "acos(2+a)", "exp(1000+a)"]
PLACES = [
    "torques: {a: %s}",
    "forces: [{name: f, type: force, at: m.com, force: [0, %s, 0]}]",
]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("formula", FORMULAS)
def test_formulas_without_a_value_at_the_start_are_refused(formula: str, place: str, tmp_path: Path) -> None:
    text = PLAIN + place % f"'{formula}'" + "\n"
    for command in (simulate, statics):
        with pytest.raises(SceneError, match="at the start") as found:
            command(load_scene_text(text))
        assert formula in found.value.message and found.value.exit_code == 2
    path = tmp_path / "scene.yaml"
    path.write_text(text + "command: simulate\n")
    (only,) = findings(path)
    assert only.exit_code == 2 and formula in only.message
    assert only.line == text[: text.index(place[:6])].count("\n") + 1


def test_a_balance_is_not_sought_where_a_force_has_no_slope() -> None:
    text = PLAIN + "forces: [{name: f, type: force, at: m.com, force: [0, sqrt(a), 0]}]\n"
    with pytest.raises(NumericalError, match="no finite slope at a = 0, b = 0.* / 0 has no value"):
        statics(load_scene_text(text))


@pytest.mark.parametrize("at", [0.2, 0.5])
def test_a_sample_of_a_simulation_without_a_value_ends_it_by_name(at: float) -> None:
    """A torque with a removable singularity on a sample: the integration passes it, the dataset would have NaN."""
    text = PLAIN.replace("duration: 0.1, samples: 11", "duration: 1, samples: 11")
    torque = f"torques: {{a: 'sin(t-{at})/(t-{at})'}}\n"
    with pytest.raises(
        NumericalError, match=rf"^qdd of 'a' is not finite at t = {at} s: .*torques.a: formula"
    ) as found:
        simulate(load_scene_text(text + torque))
    assert found.value.exit_code == 3 and found.value.details["dataset"] == "qdd"
    assert isinstance(found.value.result, Result) and found.value.result.status == "failed"
    assert is_finite(simulate(load_scene_text(text + torque, overrides=["simulate.samples=10"])))


@pytest.mark.parametrize("command", [simulate, inverse])
def test_a_gear_ratio_whose_square_no_double_holds_is_refused(command: Any) -> None:
    scene = load_scene_text(
        PLAIN + SWING, overrides=["robot.joints.a.gear_ratio=-1e300", "robot.joints.a.rotor_inertia=1"]
    )
    with pytest.raises(NumericalError), np.errstate(all="ignore"):
        command(scene)


def test_an_overflow_of_python_s_own_numbers_is_an_error_of_the_scene(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from robodyn_cli.over import commands
    from robodyn_cli.tools.progress import Stopwatch, no_progress

    def overflows(*_: Any, **__: Any) -> None:
        float(10) ** 400

    monkeypatch.setattr(commands, "functions", {"inverse": overflows})
    with pytest.raises(NumericalError, match="exceeds the range of a double"):
        commands.execute("inverse", load_scene_text(PLAIN + SWING), no_progress, Stopwatch())


class TestFormulasAtTheEdge:
    """A formula may start at the edge of what it is defined on only if the motion goes inwards."""

    def test_one_that_the_motion_leaves_at_once_is_named(self) -> None:
        for formula in ("sqrt(a)", "(0 + a)^1.5", "asin(1 - a)", "-log(1e-14 + a)"):
            with pytest.raises(SceneError, match=r"right after the start"):
                simulate(load_scene_text(PLAIN, overrides=[f"torques={{b: '{formula}'}}"]))

    def test_validate_finds_it(self, tmp_path: Path) -> None:
        path = tmp_path / "scene.yaml"
        path.write_text(PLAIN + "torques: {b: sqrt(a)}\n")
        assert [f.exit_code for f in findings(path)] == [2]

    def test_one_that_the_motion_enters_runs(self) -> None:
        # upwards from a = 0, with a torque of 3 sqrt(a) that no analytic slope belongs to
        result = simulate(
            load_scene_text(PLAIN, overrides=["gravity=[0, 0, 0]", "torques={a: 1 + 3*sqrt(a)}"])
        )
        assert result.status == "ok" and result["q"][-1, 0] > 0.0

    def test_time_before_the_start_does_not_count(self) -> None:
        result = simulate(load_scene_text(PLAIN, overrides=["torques={a: sqrt(t)}"]))
        assert result.status == "ok"


@pytest.mark.parametrize("command", [deploy, simulate])
@pytest.mark.parametrize(("value", "g"), [("mass=1.7976931348623157e+308", 0), ("com=[1.2, 1e300, 0]", 0.01)])
def test_energies_that_overflow_are_no_drift_of_nothing(command: Any, value: str, g: float) -> None:
    options = [f"gravity=[0, {-g}, 0]", "simulate.duration=0.3", "simulate.samples=31"]
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml", [*options, f"robot.links.crank.{value}"])
    with pytest.raises(NumericalError, match="energy/kinetic is not finite") as caught:
        command(scene)
    assert isinstance(caught.value.result, Result)
    assert np.isnan(caught.value.result.summary["energy_drift"])


SLIDE = """\
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: m, mass: 1, com: [0, 0, 0], inertia: {xx: 1, yy: 1, zz: 1}}]
simulate: {duration: 2, samples: 11}
"""
AWAY, BACK = "initial: {q: {x: 0.5}, qd: {x: 1}}\n", "initial: {q: {x: 1}, qd: {x: -1}}\n"
TORQUE = "torques: {x: '%s'}\n"
LAW = "control: {type: formulas, joints: [x], law: {x: '%s'}, state: {u: {start: 1, rate: -1}}}\n"
SPRING = "forces: [{name: k, type: nonlinear_spring, between: [base.origin, m.origin], tension: '%s'}]\n"
PUSH = "forces: [{name: k, type: force, at: m.origin, force: ['%s', 0, 0]}]\n"
LED = "prescribed: {x: '%s'}\n"


@pytest.mark.parametrize(
    "start, written, formula, key",
    [
        (BACK, TORQUE, "log(q.x)", "torques.x"),
        (BACK, TORQUE, "-0.5*sqrt(q.x - 0.5)", "torques.x"),
        (AWAY, TORQUE, "asin(q.x)", "torques.x"),
        (AWAY, TORQUE, "acos(q.x)", "torques.x"),
        (BACK, TORQUE, "-1/q.x", "torques.x"),
        (AWAY, TORQUE, "tan(q.x)", "torques.x"),
        (BACK, TORQUE, "-(q.x - 0.5)^0.5", "torques.x"),
        (BACK, TORQUE, "-q.x^-1.5", "torques.x"),
        (BACK, TORQUE, "log(1 - t)", "torques.x"),
        (BACK, TORQUE, "1/(1 - t)", "torques.x"),
        (BACK, LAW, "log(q.x)", "control.law.x"),
        (BACK, LAW, "log(s.u)", "control.law.x"),
        (BACK, SPRING, "sqrt(length - 0.5)", "forces.0.tension"),
        (BACK, PUSH, "sqrt(q.x - 0.3)", "forces.0.force.0"),
        ("", LED, "sqrt(1 - t)", "prescribed.x"),
    ],
)
def test_a_formula_that_ends_on_the_way_is_named(start: str, written: str, formula: str, key: str) -> None:
    """With its key, the time, and its value where it ends: not the step that got too small, alone."""
    with pytest.raises(NumericalError) as caught:
        simulate(load_scene_text(SLIDE + start + written % formula))
    told = caught.value.message
    assert f"{key}: formula {formula!r} " in told and " at t = " in told, told
    assert "has no finite value next to it" in told or "has no value at " in told, told


def test_a_run_that_only_gets_too_fast_names_no_formula() -> None:
    with pytest.raises(NumericalError, match="the largest acceleration there") as caught:
        simulate(load_scene_text(SLIDE + AWAY + TORQUE % "5*q.x^3"))
    assert "formula" not in caught.value.message


@pytest.mark.parametrize("command, name", [(simulate, "double_pendulum"), (deploy, "four_bar_deploy")])
def test_a_duration_beyond_the_motion_is_told(command: Any, name: str) -> None:
    for duration, said in (("1e300", "is so long that no step"), ("1e40", "% of simulate.duration")):
        more = ["simulate.max_steps=1000", "deploy.criterion=multipliers"][: 1 + (command is deploy)]
        scene = load_scene(CONFIGS / f"{name}.yaml", [f"simulate.duration={duration}", *more])
        try:
            command(scene)
        except NumericalError as error:
            assert said in error.message and "simulate.duration" in error.message, error.message
        else:
            assert command is deploy and duration == "1e40"  # it ends before

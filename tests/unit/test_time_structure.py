"""What formulas of time hide: jumps and kinks behind roots and angles, pulses shorter than steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.equations.time_structure import TimeStructure, functions_of_time, structure
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.formula import parse
from robodyn_cli.expr.graph import Expr, Graph, reachable
from robodyn_cli.expr.intervals import bounds
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.results.result import Result
from tests.mechanisms import close
from tests.property.formulas import formulas, on_graph

SLIDER = """
schema: 1
command: simulate
gravity: [0, 0, 0]
robot:
  joints: [{{name: x, type: prismatic, axis: [1, 0, 0]}}]
  links: [{{name: b, mass: 1, com: [0, 0, 0]}}]
torques: {{x: "{torque}"}}
initial: {{q: {{x: 0}}}}
simulate: {{duration: 10, samples: 101}}
"""


def found(text: str, duration: float = 10.0) -> TimeStructure:
    t = Graph().symbol("t", "t")
    function = parse(text).evaluate({"t": t})
    assert isinstance(function, Expr)
    return structure(function, t, duration)


HIDDEN = {
    "sqrt((t-1)^2)": [1.0],
    "((t-1)^2)^0.5": [1.0],
    "atan2(sin(t), cos(t))": [math.pi, 3 * math.pi],
    "(t-3.3)/sqrt((t-3.3)^2)": [3.3],
    "asin(sin(t))": [math.pi / 2, 3 * math.pi / 2, 5 * math.pi / 2],
    "acos(cos(2*t))": [k * math.pi / 2 for k in range(1, 7)],
    "t*sqrt((t^2-4)^2)": [2.0],
    "abs(t-2)*3": [2.0],
}


@pytest.mark.parametrize("text", HIDDEN)
def test_jumps_and_kinks_are_found_where_they_are(text: str) -> None:
    structure = found(text)
    assert structure.resolved
    close(np.array(structure.points), np.array(HIDDEN[text]), 1e-8)


@pytest.mark.parametrize(
    "text",
    [
        "sin(t)", "sin(1000*t)", "1.96 - 0.1*t", "t^2*sin(3*t) + exp(-t)", "sin(t)*cos(7*t) + 0.3*sin(t*t)",
        "16*(t/1.4)^2*(1-t/1.4)^2", "sin(2*pi*t)^2", "(t^2)^1.5",
    ],
)  # fmt: skip
def test_smooth_functions_have_nothing_to_show(text: str) -> None:
    assert found(text) == TimeStructure((), ())


@given(st.floats(0.5, 9.5), st.floats(1e-6, 1e-3))
@settings(max_examples=30, deadline=None)
def test_a_pulse_is_enclosed_however_short_it_is(centre: float, width: float) -> None:
    edges = np.array(found(f"exp(-((t-{centre!r})/{width!r})^2/2)").edges)
    # steps end close to it on either side, so that those between have their stages in the pulse
    assert edges[edges < centre - width].max() > centre - 50 * width
    assert edges[edges > centre + width].min() < centre + 50 * width


def test_only_what_depends_on_time_alone_is_looked_at() -> None:
    graph = Graph()
    t, q = graph.symbol("t", "t"), graph.symbol("q.x", "q")
    value = parse("q.x*exp(-t) + sqrt((q.x - t)^2) + sin(cos(t))").evaluate({"t": t, "q.x": q})
    assert {node.op for node in functions_of_time([value], t)} == {"exp", "sin"}


@given(formulas(), st.floats(-3.0, 3.0), st.floats(0.0, 2.0))
@settings(max_examples=300, deadline=None)
def test_bounds_hold_what_they_enclose(formula: Any, low: float, width: float) -> None:
    t = Graph().symbol("t", "t")
    times = np.linspace(low, low + width, 57)
    try:
        function = on_graph(formula, [t, t, t])
        with np.errstate(all="ignore"):
            parts = evaluate([function, *reachable([function])], {"t": [times]})
    except (ArithmeticError, ValueError):
        assume(False)  # a part without t that has no value
    values, *inner = (np.asarray(x, dtype=float) * np.ones(len(times)) for x in parts)
    # where a part has no value, as sin(1/t) at 0, a choice that depends on it goes the second way by chance
    known = np.isfinite(values) & ~np.any([np.isnan(x) for x in inner], axis=0)
    values = values[known]
    limits = bounds(function, t, np.array([low]), np.array([low + width]))
    slack = 1e-9 * (1.0 + np.abs(values))
    assert np.all(limits.low[0] <= values + slack) and np.all(values - slack <= limits.high[0])


@pytest.mark.parametrize("method", ["gauss", "dop853", "radau13", "bdf"])
@pytest.mark.parametrize("sigma", [3e-4, 3e-3, 1e-2])
def test_a_short_pulse_gives_its_impulse(method: str, sigma: float) -> None:
    torque = f"exp(-((t-5.13)/{sigma})^2/2)/({sigma}*sqrt(2*pi))"
    result = simulate(
        load_scene_text(SLIDER.format(torque=torque), overrides=[f"simulate.integrator={method}"])
    )
    tolerance = 1e-4 if method == "bdf" else 1e-7
    close(result["qd"][-1, 0], 1.0, tolerance)
    close(result["q"][-1, 0], 4.87, tolerance)
    estimate = result.summary["error_estimate"]
    assert estimate["q_max"] >= 0.1 * abs(result["q"][-1, 0] - 4.87) or estimate["at_rounding"]


@pytest.mark.parametrize("method", ["gauss", "dop853", "radau13"])
def test_a_jump_behind_a_root_is_met(method: str) -> None:
    result = simulate(
        load_scene_text(
            SLIDER.format(torque="(t-3.3)/sqrt((t-3.3)^2)"), overrides=[f"simulate.integrator={method}"]
        )
    )
    close(result["q"][-1, 0], -5.11, 1e-8)


@pytest.mark.parametrize(
    "motion", ["sqrt((t-1)^2)", "((t-1)^2)^0.5", "acos(cos(t+1))", "atan2(sin(t), cos(t))"]
)
def test_a_prescribed_motion_that_jumps_is_refused_however_it_is_written(motion: str) -> None:
    text = SLIDER.format(torque="0").replace('torques: {x: "0"}', f'prescribed: {{x: "{motion}"}}')
    text = text.replace("initial: {q: {x: 0}}", "")
    with pytest.raises(SceneError, match="jumps at t = "):
        simulate(load_scene_text(text))


def test_the_longest_step_can_be_set() -> None:
    scene = SLIDER.format(torque="sin(t)")
    free, bound = (
        simulate(load_scene_text(scene, overrides=more)).summary["counters"]["steps"]
        for more in ([], ["simulate.max_step=0.01"])
    )
    assert free < 200 <= 1000 <= bound


class TestSidesOfBreakpoints:
    """Stages at the ends of steps see the side of a jump on which their step lies, whatever the formula is at the jump."""

    MASS = """\
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: block, mass: 2, com: [0, 0, 0]}]
initial: {q: {x: 0}}
"""
    ON, OFF = 0.3122, 0.3127
    FORCE = 400.0
    FORMULAS = (
        "{F}*(step(t - {a}) - step(t - {b}))",
        "if(t < {a}, 0, if(t < {b}, {F}, 0))",
        "if(t <= {a}, 0, if(t <= {b}, {F}, 0))",
        "{F}/2*(sign(t - {a}) - sign(t - {b}))",
    )

    def run(self, formula: str, *options: str) -> Result:
        text = formula.format(F=self.FORCE, a=self.ON, b=self.OFF)
        simulation = ["simulate.duration=1", "simulate.samples=11", f"torques={{x: '{text}'}}"]
        return simulate(load_scene_text(self.MASS, overrides=[*simulation, *options]))

    @pytest.mark.parametrize("formula", FORMULAS)
    @pytest.mark.parametrize(
        "method", ["rk4", "gauss4", "gauss", "dop853", "dopri5", "rodas5p", "radau", "radau13"]
    )
    def test_a_pulse_of_constant_force_is_met_exactly(self, method: str, formula: str) -> None:
        step = "simulate.step=0.01" if method in ("rk4", "gauss4") else "simulate.rtol=1e-8"
        found = self.run(formula, f"simulate.integrator={method}", step)
        speed = self.FORCE / 2 * (self.OFF - self.ON)
        moved = np.where(found.time < self.ON, 0.0, speed * (found.time - 0.5 * (self.ON + self.OFF)))
        # a polynomial of degree 2 in each piece, so every method is exact but for rounding
        assert np.abs(found["q"][:, 0] - moved).max() < 1e-13
        assert np.abs(found["qd"][found.time > self.OFF, 0] - speed).max() < 1e-12
        assert found.summary["counters"]["steps"] < 130

    @pytest.mark.parametrize("method", ["rk4", "dop853", "radau13"])
    @pytest.mark.parametrize("formula", ["if(t > 0, {F}, 0)", "{F}*sign(t)", "if(t < 1, {F}, 0)"])
    def test_jumps_at_the_ends_of_a_run_have_no_part_in_it(self, formula: str, method: str) -> None:
        step = "simulate.step=0.1" if method == "rk4" else "simulate.rtol=1e-8"
        found = self.run(formula, f"simulate.integrator={method}", step)
        assert np.abs(found["q"][:, 0] - 0.25 * self.FORCE * found.time**2).max() < 1e-12 * self.FORCE

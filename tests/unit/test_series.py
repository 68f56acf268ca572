"""Taylor series that are written out of a program, against those of 60 digits and exact motions."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from robodyn_cli import Mechanism, load_scene_text, simulate
from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.rebuild import APPLY
from robodyn_cli.formulations.system import System
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.ir import RELAXED, Function, module
from robodyn_cli.kernels.lower import loaded, values_of
from robodyn_cli.kernels.program import NUMBERS, Program
from robodyn_cli.kernels.series.jets import Jets
from robodyn_cli.kernels.series.rules import Series
from tests import systems

ORDER = 9
KNOTS = (0.0, 0.5, 1.5)
ROWS = ((0.3, -0.7), (1.1, 0.4), (-0.9, 1.3), (0.8, -0.2))  # coefficients of each power in both segments


def jets_of(function: Function, program: Program, inputs: dict[str, Any], x: Array, body: System) -> Jets:
    """Return the series of a system at a state in memory."""
    series = Series.of(program)
    read = loaded(function, series.program, inputs, x.width)
    start = values_of(function, series.program, read, x.width, machine().fused)
    return Jets(
        function, series, {k: start[k] for k in series.read}, [x[k] for k in range(body.size)], body.nv
    )


def coefficients(body: System, start: Sequence[float], time: float, order: int, width: int = 1) -> np.ndarray:
    """Return the Taylor coefficients (size, order + 1) of a system's motion from a start, from every lane."""
    program, size = body.dynamics.program, body.size
    function = Function("series", ["ptr %x", f"ptr %{NUMBERS}", "ptr %t", "ptr %out"], flags=RELAXED)
    x = Array(function, "%x", width)
    first = {"q": 0, "v": body.nv, "z": 2 * body.nv}
    inputs: dict[str, Any] = {group: x.part(first[group]) for group in program.inputs if group in first}
    inputs |= {"t": [function.splat(function.load("%t"), width)], NUMBERS: Array(function, f"%{NUMBERS}")}
    jets = jets_of(function, program, inputs, x, body)
    out = Array(function, "%out", width)
    found_there = jets.up_to(order)
    for k in range(size):
        for n in range(order + 1):
            out[k * (order + 1) + n] = found_there.at(k, n)
    function.ret()
    compiled = compile_module(f"series {program.digest} {order} {width}", lambda: module([function]))
    memory = np.zeros((size, width + 8)), np.zeros((size * (order + 1)) * width + 8)
    states, found = (m.ravel()[(-m.ctypes.data // 8) % 8 :] for m in memory)
    states = states[: size * width].reshape(size, width)
    states[:] = np.array(start)[:, None]
    table = program.table
    arrays = states, table, np.array([time]), found
    compiled.function("series", *[ctypes.c_void_p] * 4)(*(a.ctypes.data for a in arrays))
    rows = found[: size * (order + 1) * width].reshape(size, order + 1, width)
    np.testing.assert_array_equal(rows, rows[:, :, :1].repeat(width, axis=2))
    return rows[:, :, 0]


def polynomial(x: Any) -> Any:
    """The second segment of the table, which the time of the test lies in."""
    return sum(row[1] * (x - KNOTS[1]) ** k for k, row in enumerate(ROWS))


# each operation of a graph: of two functions u and w of time, in the graph and in many digits
OPERATIONS: dict[str, tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]] = {
    "add": (lambda u, w: u + w, lambda u, w: u + w),
    "sub": (lambda u, w: u - w, lambda u, w: u - w),
    "mul": (lambda u, w: u * w, lambda u, w: u * w),
    "square": (lambda u, w: u * u, lambda u, w: u * u),
    "div": (lambda u, w: u / w, lambda u, w: u / w),
    "reciprocal": (lambda u, w: (1.0 / w) * u + (1.0 / w) * f.sin(u), lambda u, w: (u + mp.sin(u)) / w),
    "inverse": (lambda u, w: 2.0 / w, lambda u, w: 2 / w),
    "neg": (lambda u, w: -(u * w), lambda u, w: -u * w),
    "pow": (lambda u, w: f.power(u, 2.3), lambda u, w: u ** mp.mpf(2.3)),
    "powers": (lambda u, w: f.power(u, w), lambda u, w: u**w),
    "sin": (lambda u, w: f.sin(u), lambda u, w: mp.sin(u)),
    "cos": (lambda u, w: f.cos(u), lambda u, w: mp.cos(u)),
    "both": (lambda u, w: f.sin(w) + f.cos(w), lambda u, w: mp.sin(w) + mp.cos(w)),
    "tan": (lambda u, w: f.tan(u), lambda u, w: mp.tan(u)),
    "asin": (lambda u, w: f.asin(u), lambda u, w: mp.asin(u)),
    "acos": (lambda u, w: f.acos(u), lambda u, w: mp.acos(u)),
    "atan": (lambda u, w: f.atan(w), lambda u, w: mp.atan(w)),
    "sinh": (lambda u, w: f.sinh(u), lambda u, w: mp.sinh(u)),
    "cosh": (lambda u, w: f.cosh(u), lambda u, w: mp.cosh(u)),
    "tanh": (lambda u, w: f.tanh(u), lambda u, w: mp.tanh(u)),
    "exp": (lambda u, w: f.exp(u), lambda u, w: mp.exp(u)),
    "log": (lambda u, w: f.log(u), lambda u, w: mp.log(u)),
    "sqrt": (lambda u, w: f.sqrt(u), lambda u, w: mp.sqrt(u)),
    "atan2": (lambda u, w: f.atan2(u, w), lambda u, w: mp.atan2(u, w)),
    "abs": (lambda u, w: f.absolute(u - 2.0), lambda u, w: 2 - u),
    "sign": (lambda u, w: f.sign(u) * w, lambda u, w: w),
    "round": (lambda u, w: f.nearest(u) + w, lambda u, w: 1 + w),
    "min": (lambda u, w: f.minimum(u, w), lambda u, w: u),
    "max": (lambda u, w: f.maximum(u, w), lambda u, w: w),
    "where": (lambda u, w: f.where(u - 2.0, u, w * w), lambda u, w: w * w),
    "table": (lambda u, w: w.graph.piecewise(u, KNOTS, ROWS, None), lambda u, w: polynomial(u)),
    "held": (lambda u, w: w.graph.piecewise(u, KNOTS, ROWS, (1.0, 2.0)), lambda u, w: polynomial(u)),
    "beyond": (lambda u, w: u * w.graph.piecewise(w, KNOTS, ROWS, (1.0, 2.0)), lambda u, w: 2 * u),
}
TIME = 0.4


def test_every_operation_of_a_graph_is_tried() -> None:
    assert set(APPLY) | {"table"} <= set(OPERATIONS)


@pytest.mark.parametrize("width", [1, machine().lanes])
def test_series_of_each_operation(width: int) -> None:
    """z' = operation(u(t), w(t)): its coefficients are those of the integral."""

    def inner(sin: Callable[[Any], Any], t: Any) -> tuple[Any, Any]:
        return 0.55 + 0.2 * sin(1.3 * t + 0.2), 2.0 + t * t - 0.4 * t

    body = systems.system(
        0,
        lambda t, q, v, z, p: ([], [op(*inner(f.sin, t)) for op, _ in OPERATIONS.values()]),
        nz=len(OPERATIONS),
    )
    found = coefficients(body, [0.0] * len(OPERATIONS), TIME, ORDER, width)
    with mp.workdps(60):
        for row, (name, (_, exact)) in zip(found, OPERATIONS.items()):
            series = mp.taylor(lambda t, exact=exact: exact(*inner(mp.sin, t)), mp.mpf(TIME), ORDER - 1)
            expected = np.array([0.0, *(float(c / (n + 1)) for n, c in enumerate(series))])
            scale = np.abs(expected) + 3.0 ** np.arange(
                ORDER + 1
            )  # poles of these functions are a third away
            assert np.all(np.abs(row - expected) < 1e-13 * scale), (name, row, expected)


def test_kinks_and_constants_take_no_room() -> None:
    body = systems.system(1, lambda t, q, v, z, p: ([f.sign(v[0]) * 2.0], [3.0, v[0]]), nz=2)
    found = coefficients(body, [0.1, 0.5, 0.0, 0.0], 0.0, 4)
    expected = [[0.1, 0.5, 1.0, 0, 0], [0.5, 2.0, 0, 0, 0], [0, 3.0, 0, 0, 0], [0, 0.5, 1.0, 0, 0]]
    np.testing.assert_allclose(found, expected, rtol=0, atol=0)


@pytest.mark.parametrize("order", [1, 2, 3, 8, 12])
def test_a_step_leaves_what_its_order_says(order: int) -> None:
    """Half the step leaves a part 2^-(order + 1) of the error, of q 2^-(order + 2)."""
    case = systems.pendulums(1.0, 2.0)
    found, size = coefficients(case.system, case.start, 0.0, order), case.system.nv
    steps = np.array([0.2, 0.1]) * (4.0 if order > 3 else 1.0)
    exact = case.exact(steps).T
    powers = steps[None, :] ** np.arange(order + 1)[:, None]
    errors = np.abs(found @ powers - exact)[size:].max(axis=0)
    assert errors[0] > 1e-13
    assert math.log2(errors[0] / errors[1]) > order + 0.5


def test_reciprocals_cost_no_convolution_of_their_own() -> None:
    q = Graph().symbols(["a", "b"], "q")
    body = systems.system(
        2, lambda t, q, v, z, p: [(1.0 / (q[0] + q[1])) * q[0], (1.0 / (q[0] + q[1])) * q[1]]
    )
    series = Series.of(body.dynamics.program)
    divisions = [i for i in series.program.instructions if i.op == "div"]
    assert len(q) == len(divisions) == 2 and not any(i.op == "mul" for i in series.program.instructions)
    assert not any(isinstance(x, float) for i in divisions for x in i.args)


def written(order: int) -> tuple[Program, str]:
    """Return a program of two joints and the code of its series up to an order."""

    def rates(t: Any, q: Any, v: Any, z: Any, p: Any) -> Any:
        a, b = f.sin(q[0]), f.cos(q[0] - q[1])
        return [a * b * v[1] * v[1] / (2.0 - b * b), f.tanh(v[1]) - 3.0 * q[1] + 2.0 * v[0]], []

    body = systems.system(2, rates)
    program = body.dynamics.program
    function = Function("series", ["ptr %x", f"ptr %{NUMBERS}", "ptr %t"], flags=RELAXED)
    x = Array(function, "%x", 8)
    inputs = {"q": x.part(0), "v": x.part(2), "t": [function.splat(function.load("%t"), 8)]}
    inputs[NUMBERS] = Array(function, f"%{NUMBERS}")
    jets = jets_of(function, program, inputs, x, body)
    before = len(function.lines)
    jets.up_to(order)
    return program, "\n".join(function.lines[before:])


@pytest.mark.parametrize("order", [6, 16])
def test_work_is_about_what_is_done(order: int) -> None:
    """Between equations of many convolutions and of few it tells apart what the instructions do."""
    program, text = written(order)
    # of each convolution a term of two orders in a loop, and one behind it
    convolutions = text.count("@llvm.fmuladd") / 3
    # three orders are written, and a product and a sum are one operation
    others = sum(text.count(f" {op} ") for op in ("fmul", "fadd", "fsub", "fneg")) / 6
    done = others * order + convolutions * 0.5 * order**2
    assert 0.7 < Series.of(program).work(order) / done < 1.5


def test_code_is_as_long_at_every_order() -> None:
    """Long code is not kept by the processor, and takes long to compile."""
    assert len({len(written(order)[1].splitlines()) for order in (6, 12, 16)}) == 1


# -- the methods --------------------------------------------------------------------------------------------
def random_scene(rng: np.random.Generator, method: str) -> str:
    """Return an open chain of one or two joints with springs, dampers, friction and a spring between bodies."""
    count = int(rng.integers(1, 3))
    extra = [
        "",
        ", friction: {viscous: 0.4}",
        ", friction: {coulomb: 0.3, transition_speed: 0.2}",
        ", spring: {stiffness: 30}",
    ]
    joints = ", ".join(
        f"{{name: j{k}, type: {'prismatic' if rng.random() < 0.3 else 'revolute'}, "
        f"axis: {np.round(rng.normal(size=3), 2).tolist()}{rng.choice(extra)}}}"
        for k in range(count)
    )
    links = ", ".join(
        f"{{name: l{k}, mass: {rng.uniform(1, 3):.3f}, com: {np.round(rng.normal(size=3) * 0.4, 2).tolist()}, "
        f"inertia: {{xx: 0.11, yy: 0.12, zz: 0.13, xy: 0.01}}}}"
        for k in range(count)
    )
    torque = ["", "torques: {j0: 0.4*sin(3*t) - 0.1*tanh(j0)}", "torques: {j0: exp(-t)*cos(j0)}"][
        int(rng.integers(3))
    ]
    start = ", ".join(f"j{k}: {rng.uniform(-0.5, 0.5):.3f}" for k in range(count))
    return f"""
schema: 1
command: simulate
gravity: [0.3, -0.2, -9.81]
robot: {{joints: [{joints}], links: [{links}]}}
{torque}
initial: {{q: {{{start}}}}}
simulate: {{duration: 2, samples: 5, integrator: {method}, rtol: 1e-9, atol: 1e-10}}
"""


@pytest.mark.parametrize("seed", range(6))
def test_random_scenes_agree_with_another_method_within_their_errors(seed: int) -> None:
    results = [
        simulate(load_scene_text(random_scene(np.random.default_rng(seed), method)))
        for method in ("taylor12", "dop853")
    ]
    first, second = (result.summary["error_estimate"]["q_max"] for result in results)
    apart = np.abs(results[0]["q"] - results[1]["q"]).max()
    assert apart <= first + second and first < 1e-6


def test_runs_in_lanes_are_those_of_the_scalar_loop() -> None:
    scene = random_scene(np.random.default_rng(3), "taylor12")
    mechanism = Mechanism(load_scene_text(scene), ["robot.links.l0.mass"])
    masses = np.linspace(1.0, 3.0, 11)[:, None]
    together = mechanism.simulate_many(masses)
    assert together.ok.all() and not together.one_by_one.any()
    for k in (0, 10):
        alone = simulate(load_scene_text(scene, overrides=[f"robot.links.l0.mass={masses[k, 0]}"]))
        assert np.abs(together.q[k] - alone["q"][-1]).max() <= together.q_error[k].max() + 1e-9


def test_the_bits_of_a_run_do_not_depend_on_those_beside_it() -> None:
    """Where one lane begins anew the others go on with what they have, not with the same from other code."""
    texts = (random_scene(np.random.default_rng(seed), "taylor12") for seed in range(30))
    scene = next(text for text in texts if "sin(3*t)" in text)
    mechanism = Mechanism(load_scene_text(scene), ["robot.links.l0.mass"])
    masses = np.linspace(1.0, 3.0, 23)[:, None]
    together = mechanism.simulate_many(masses)
    assert together.ok.all() and not together.one_by_one.any()
    for k in (0, 9, 15, 22):
        alone = mechanism.simulate_many(masses[k : k + 1])
        np.testing.assert_array_equal(
            np.hstack([alone.q, alone.qd])[0], np.hstack([together.q, together.qd])[k]
        )

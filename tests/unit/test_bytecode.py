"""Programs as data: the same numbers as machine code, in kernels of samples and in runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Graph
from robodyn_cli.integrators.runtime import engine
from robodyn_cli.kernels import bytecode, samples
from robodyn_cli.kernels.bytecode import KINDS, SHAPE, InterpretedSamples, encode, kinds_of
from robodyn_cli.kernels.compiler import LASTING, QUICK
from robodyn_cli.kernels.program import make_program
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.scene.load import load_scene
from robodyn_cli.works.simulate import simulate
from tests.kernels import SPECIAL, symbols
from tests.source import ROOT

RNG = np.random.default_rng(5)
UNARY = [kind for kind, count in KINDS.items() if count == 1 and kind not in SHAPE]
BINARY = [kind for kind, count in KINDS.items() if count == 2]


def both(outputs: dict[str, list[Any]], known: list[str], **groups: np.ndarray) -> tuple[Any, Any]:
    """Return the results of a program as data and as machine code."""
    kernel = SampleKernel(outputs, known)
    found = []
    for seen in (0, samples.MANY):
        kernel._seen = seen
        kernel.__dict__["_first"] = InterpretedSamples(kernel.program)
        found.append(kernel(**groups))
    assert "_compiled" in kernel.__dict__
    return found[0], found[1]


def test_each_kind_of_operation_equals_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bytecode, "LITTLE", 0)  # a lasting loop rounds as lasting code does
    graph = Graph()
    x, y = graph.symbols(["x0", "x1"], "x")
    entries = [graph.unary(kind, x) for kind in UNARY]
    entries += [graph._binary(kind, x, y) for kind in BINARY]
    entries.append(graph.where(x, y, 3.0))
    for n, degree, held in ((2, 0, None), (3, 1, (7.0, -8.0)), (9, 5, None), (40, 3, (0.5, 1.5))):
        knots = np.cumsum(RNG.uniform(0.01, 0.3, n)) - 2.0
        rows = RNG.uniform(-1, 1, (degree + 1, n - 1))
        entries.append(graph.piecewise(x, tuple(knots.tolist()), tuple(map(tuple, rows.tolist())), held))
    pairs = [(a, b) for a in SPECIAL for b in SPECIAL]
    rows = np.array([*pairs, *RNG.uniform(-3, 3, (200, 2))])
    interpreted, compiled = both({"r": entries}, ["x"], x=rows)
    assert len(kinds_of(make_program({"r": entries}, ["x"]))) == len(KINDS)
    np.testing.assert_array_equal(interpreted["r"], compiled["r"])


def random_entries(count: int, graph: Graph) -> list[Any]:
    """Return random sums and products of values so far, most of them recent, some of them old."""
    values: list[Any] = [
        *graph.symbols([f"q{k}" for k in range(5)], "q"),
        graph.symbol("p", "p", 2),
        0.7,
        -1.3,
    ]
    for _ in range(count):
        a, b = (values[-1 - min(int(RNG.exponential(8)), len(values) - 1)] for _ in range(2))
        old = values[RNG.integers(len(values))]
        found = [a + old, a - b, 0.5 * a * old, -b, f.sin(a), f.cos(old), a / (2.0 + f.cos(b))]
        values.append(found[RNG.integers(len(found))])
    return values


@pytest.mark.parametrize("count", [1, 7, 8, 61])
def test_random_programs_agree(count: int) -> None:
    entries = random_entries(600, Graph())
    outputs = {"first": entries[::7], "none": [], "last": [*entries[-3:], 2.5], "whole": [1.0, -2.0]}
    groups = {"q": RNG.uniform(-1, 1, (count, 5)), "p": np.array([np.nan, np.nan, 0.3])}
    interpreted, compiled = both(outputs, ["q", "p"], **groups)
    for name in outputs:
        np.testing.assert_allclose(interpreted[name], compiled[name], rtol=1e-11, atol=1e-11, err_msg=name)


def test_registers_are_used_again() -> None:
    (x,) = symbols(1)
    total: Any = x
    for k in range(1000):
        total = f.sin(total) + 1.0 / (k + 2.0)
    program = make_program({"r": [total]}, ["x"])
    found = encode(program, kinds_of(program))
    # the input, a thousand constants, and not more than a few for all sums and sines
    assert found.registers < 1010


RUNS = {
    "configs/double_pendulum.yaml": ["gauss", "dop853", "radau13", "bdf", "rodas5p"],
    "configs/stick_slip.yaml": ["auto"],
    "configs/bouncing_pendulum.yaml": ["auto"],
    "configs/tumbling_body.yaml": ["gauss"],
    "configs/benchmarks/slider_crank.yaml": ["gauss", "generalized_alpha"],
    "configs/benchmarks/four_bar_n2.yaml": ["auto"],
    "configs/controlled_arm.yaml": ["auto"],
}


@pytest.mark.parametrize(("scene", "method"), [(s, m) for s, methods in RUNS.items() for m in methods])
def test_interpreted_runs_equal_compiled_ones(
    scene: str, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interpreted from the first step, machine code from the 20th: the same motion but for rounding."""
    changes = [f"simulate.integrator={method}", "simulate.duration=1", "simulate.samples=40"]
    changes += ["simulate.step=0.002"] * (method == "generalized_alpha")
    if "controlled" in scene:  # an encoder would read motions that differ by rounding differently
        changes += ["control.sensors=null"]
    expected = simulate(load_scene(ROOT / scene, changes))
    monkeypatch.setattr(engine, "MANY", 0)
    monkeypatch.setattr(engine, "PATIENCE", 20)
    monkeypatch.setattr(engine, "STEPS_PER_OPERATION", 0.0)
    monkeypatch.setattr("robodyn_cli.kernels.lower.INLINE_LIMIT", 0)
    monkeypatch.setattr(samples, "LONG", 0)
    # code written with other limits is not kept for runs with the usual ones
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    monkeypatch.setattr("robodyn_cli.kernels.compiler._loaded", {})
    found = simulate(load_scene(ROOT / scene, changes))
    for name in ("q", "qd"):
        np.testing.assert_allclose(
            found.variables[name].data, expected.variables[name].data, rtol=1e-7, atol=1e-7, err_msg=name
        )


@pytest.mark.parametrize("work", [0, 10**9])
def test_loops_that_are_made_quickly_work_off_programs_like_others(
    work: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = Graph()
    outputs = {"r": random_entries(300, graph)}
    rows = {"q": RNG.uniform(-1, 1, (50, 5)), "p": RNG.uniform(-1, 1, 3)}
    monkeypatch.setattr(bytecode, "LITTLE", work)
    kernel = SampleKernel(outputs, ["q", "p"], stepwise=True)
    found = kernel(**rows)["r"]
    assert list(kernel._first._loops) == [LASTING if work == 0 else QUICK]
    monkeypatch.setattr(bytecode, "LITTLE", 10**9 - work)
    other = SampleKernel(outputs, ["q", "p"], stepwise=True)
    np.testing.assert_allclose(found, other(**rows)["r"], rtol=1e-11, atol=1e-11)

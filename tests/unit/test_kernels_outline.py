"""Programs too long to be repeated in place become functions; they compute the same."""

from __future__ import annotations

import ctypes
import hashlib
from typing import Any

import numpy as np
import pytest

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Graph
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.integrators.stepping.loop import write_run
from robodyn_cli.kernels.arrays import Array as Rows
from robodyn_cli.kernels.compiler import compile_module
from robodyn_cli.kernels.ir import RELAXED, Function, module
from robodyn_cli.kernels.lower import Programs, call_program, lower, outline
from robodyn_cli.kernels.program import NUMBERS, Program, make_program
from tests.kernels import WIDTHS
from tests.systems import pendulums

RNG = np.random.default_rng(11)


def program(graph: Graph) -> Program:
    """Several inputs and outputs, gaps in the inputs, constants, an empty output, a table, shared sines."""
    t, q, p = graph.symbol("t", "t"), graph.symbols(["q0", "q1", "q2"], "q"), graph.symbol("p1", "p", 1)
    table = f.interpolate(t, (0.0, 0.3, 1.0), (1.0, -1.0, 2.0))
    outputs: dict[str, list[Any]] = {
        "a": [f.sin(q[0]) * q[2] + p, f.cos(q[0]) * f.cos(f.sin(q[1])), 2.5],
        "z": [table * q[1] / (1.0 + q[0] * q[0])],
        "none": [],
    }
    return make_program(outputs, ["t", "q", "p"])


def kernel(body: Program, width: int, fused: bool, outlined: bool) -> Any:
    """Return ``f(t, q, p, numbers, out)`` for one vector of samples; p is a number a parameter."""
    g = Function("f", [f"ptr %{n}" for n in ("t", "q", "p", "numbers", "out")], flags=RELAXED)
    inputs = {
        "t": [g.load("%t", width)],
        "q": [g.load(g.offset("%q", k * width), width) for k in range(3)],
        "p": [g.load(g.offset("%p", k)) for k in range(2)],
        NUMBERS: Rows(g, "%numbers"),
    }
    functions = [g]
    if outlined:
        functions.append(outline("body", body, width, Programs(fused), RELAXED))
        found = call_program(g, "body", body, inputs, width)
    else:
        found = lower(g, body, inputs, width, fused)
    for k, value in enumerate([*found["a"], *found["z"], *found["none"]]):
        g.store(g.splat(value, width), g.offset("%out", k * width))
    g.ret()
    text = module(functions)
    key = f"test outline {hashlib.sha256(text.encode()).hexdigest()}"
    return compile_module(key, lambda: text).function("f", *[ctypes.c_void_p] * 5)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("fused", [True, False])
def test_called_and_written_in_place_agree(width: int, fused: bool) -> None:
    body = program(Graph())
    data = [RNG.uniform(-0.5, 1.5, width), RNG.standard_normal((3, width)), np.array([np.nan, 0.75])]
    results = []
    for outlined in (False, True):
        out = np.full((5, width), -99.0)
        kernel(body, width, fused, outlined)(*[x.ctypes.data for x in (*data, body.table)], out.ctypes.data)
        results.append(out)
    np.testing.assert_allclose(results[1], results[0], rtol=4e-16, atol=1e-16)
    t, q, (_, p) = data
    expected = [
        np.sin(q[0]) * q[2] + p,
        np.cos(q[0]) * np.cos(np.sin(q[1])),
        np.full(width, 2.5),
        np.interp(t, (0.0, 0.3, 1.0), (1.0, -1.0, 2.0)) * q[1] / (1.0 + q[0] ** 2),
    ]
    np.testing.assert_allclose(results[0][:4], expected, rtol=1e-14, atol=1e-15)
    assert (results[0][4] == -99.0).all(), "an empty output writes nothing"


@pytest.mark.parametrize("method", ["gauss", "dop853"])
def test_where_rates_are_a_call_velocities_are_a_loop(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each further velocity is some lines around the call, not a copy of the step; the motion is the same."""
    monkeypatch.setattr("robodyn_cli.kernels.lower.INLINE_LIMIT", 0)
    monkeypatch.setenv("ROBODYN_CACHE", "off")  # code written with this limit is not kept
    monkeypatch.setattr("robodyn_cli.kernels.compiler._loaded", {})
    cases = [pendulums(*(0.2 * (k + 1) for k in range(n))) for n in (4, 8)]
    lines = [write_run(case.system, methods[method], Programs(True)).count("\n") for case in cases]
    assert lines[1] - lines[0] < 4 * 100  # copies: 700 and more
    case = cases[0]
    integrator = Integrator(case.system, method)
    integrator.reset(0.0, case.start, Options(1e-11, 1e-13))
    integrator.advance(case.end)
    np.testing.assert_allclose(integrator.state, case.exact(np.array([case.end]))[0], atol=1e-9)

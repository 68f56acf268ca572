"""Kernels over samples: any number of samples, any memory order, parameters, constants, missing data."""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.expr import functions as f
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.fixed import literal
from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.kernels import samples
from robodyn_cli.kernels.arrays import address
from robodyn_cli.kernels.cache import REPORT
from robodyn_cli.kernels.compiler import machine
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.kernels.samples import SampleKernel, compile_together

RNG = np.random.default_rng(3)
KNOWN = ("t", "q", "v", "p")
LENGTHS = [0, 1, 2, 7, 8, 9, 16, 17, 1001]


def outputs(graph: Graph) -> dict[str, list[Any]]:
    t, (q0, q1, q2) = graph.symbol("t", "t"), graph.symbols(["q0", "q1", "q2"], "q")
    v1, p0, p2 = graph.symbol("v1", "v", 1), graph.symbol("p0", "p", 0), graph.symbol("p2", "p", 2)
    return {
        "a": [q0 * q1 + f.sin(q2) * p0, f.where(v1, q0, t), q0 - q1],
        "b": [f.exp(-t) * p2 / (1.0 + q1 * q1)],
        "constant": [3.0, -0.5],
        "nothing": [],
    }


def inputs(samples: int) -> dict[str, np.ndarray]:
    return {
        "t": RNG.uniform(0, 1, samples), "q": RNG.standard_normal((samples, 3)),
        "v": RNG.standard_normal((samples, 2)), "p": np.array([2.0, np.nan, 0.25]),
    }  # fmt: skip


def expected(data: dict[str, np.ndarray], names: dict[str, list[Any]]) -> dict[str, np.ndarray]:
    groups = {"t": [data["t"]], "q": data["q"].T, "v": data["v"].T, "p": data["p"]}
    count = len(data["t"])
    return {
        k: np.array([np.broadcast_to(x, count) for x in evaluate(e, groups)]).reshape(len(e), count).T
        for k, e in names.items()
    }


def check(kernel: SampleKernel, data: dict[str, np.ndarray], names: dict[str, list[Any]]) -> None:
    got = kernel.evaluate(len(data["t"]), data)
    for name, value in expected(data, names).items():
        assert got[name].shape == value.shape
        np.testing.assert_allclose(got[name], value, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("lanes", [1, 2, 4, 8])
@pytest.mark.parametrize("fused", [True, False])
def test_every_number_of_samples(lanes: int, fused: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    host = machine()
    monkeypatch.setattr(
        samples, "machine", lambda: dataclasses.replace(host, lanes=lanes, fused=fused and host.fused)
    )
    names = outputs(Graph())
    kernel = SampleKernel(names, KNOWN)
    for count in LENGTHS:
        check(kernel, inputs(count), names)


@pytest.mark.parametrize("count", [1, 9, 40])
def test_memory_order_and_number_types_do_not_matter(count: int) -> None:
    names = outputs(Graph())
    kernel = SampleKernel(names, KNOWN)
    data = inputs(count)
    wide = np.concatenate([data["q"], np.full((count, 2), np.nan)], axis=1)
    layouts = {
        "rows": data["q"],
        "columns": np.asfortranarray(data["q"]),
        "more columns than are read": np.asfortranarray(wide),
        "a strided view": np.repeat(data["q"], 2, axis=0)[::2],
        "reversed twice": data["q"][::-1].copy()[::-1],
        "a list": data["q"].tolist(),
    }
    for name, q in layouts.items():
        before = np.array(q, copy=True)
        got = kernel(**{**data, "q": q})  # type: ignore[arg-type]
        np.testing.assert_array_equal(got["a"], kernel(**data)["a"], err_msg=name)
        np.testing.assert_array_equal(q, before, err_msg="inputs stay as they are")
    single = np.float32(0.5) * np.ones((count, 3), dtype=np.float32)
    np.testing.assert_array_equal(
        kernel(**{**data, "q": single})["a"], kernel(**{**data, "q": 0.5 + 0 * data["q"]})["a"]
    )


def test_results_are_columns_and_belong_to_the_caller() -> None:
    kernel = SampleKernel(outputs(Graph()), KNOWN)
    first, second = kernel(**inputs(16))["a"], kernel(**inputs(16))["a"]
    assert first.flags.f_contiguous and not np.shares_memory(first, second)


def test_a_program_of_constants_needs_no_input() -> None:
    kernel = SampleKernel({"c": [1.5, -2.0]}, KNOWN)
    assert kernel.program.operations == 0
    np.testing.assert_array_equal(kernel.evaluate(5, {})["c"], np.tile([1.5, -2.0], (5, 1)))


def test_not_a_number_stays_in_its_own_sample() -> None:
    q = Graph().symbols(["q0"], "q")
    x = RNG.standard_normal((33, 1))
    x[[0, 13, 32]] = np.nan
    got = SampleKernel({"r": [f.sin(q[0]) + f.maximum(q[0], 0.0)]}, KNOWN)(q=x)["r"]
    assert np.array_equal(np.isnan(got), np.isnan(x))


def test_short_kernels_of_one_module_give_what_each_gives_alone() -> None:
    """They are compiled once for all, with tables of constants of their own; a long one is not among them."""

    def kernels() -> list[SampleKernel]:
        graph = Graph()
        q0, q1, q2 = graph.symbols(["q0", "q1", "q2"], "q")
        long = q0
        for _ in range(samples.LONG):
            long = f.sin(long) + q1
        shared = {"c": [q0 * q1 + f.cos(q2), 7.0], "b": [1.25]}
        return [SampleKernel(x, KNOWN) for x in (outputs(graph), shared, {"long": [long]})]

    data = inputs(17)
    alone = [kernel.evaluate(17, data) for kernel in kernels()]
    together = kernels()
    compile_together(None, *together)
    before = REPORT.compiled + REPORT.cached
    for kernel, other in zip(together[:2], alone):
        for name, array in kernel.evaluate(17, data).items():
            np.testing.assert_array_equal(array, other[name])
    assert REPORT.compiled + REPORT.cached == before + 1
    assert together[2]._module == [together[2].program]


def test_what_the_scene_does_not_say_is_an_error_that_names_it() -> None:
    graph = Graph()
    q, mass, xx = (
        graph.symbol("q", "q"),
        graph.symbol("mass of link2", "unknown"),
        graph.symbol("inertia.xx of link1", "unknown"),
    )
    with pytest.raises(
        SceneError, match=r"need inertia\.xx of link1, mass of link2.*leaves the plane"
    ) as caught:
        SampleKernel({"r": [q * mass, xx + mass]}, KNOWN)
    assert caught.value.details["missing"] == ["inertia.xx of link1", "mass of link2"]
    with pytest.raises(SceneError, match=r"need mass of link2, which the scene does not give$"):
        SampleKernel({"r": [q * mass]}, KNOWN)
    # what drops out of the equations is not asked for
    SampleKernel({"r": [q + 0.0 * mass]}, KNOWN)


def test_wrong_inputs_are_errors() -> None:
    kernel = SampleKernel(outputs(Graph()), KNOWN)
    data = inputs(10)
    with pytest.raises(CapabilityError, match="input q: 2 columns, but 3 are needed"):
        kernel(**{**data, "q": data["q"][:, :2]})
    with pytest.raises(CapabilityError, match="input p: 1 columns, but 3 are needed"):
        kernel(**{**data, "p": np.zeros(1)})
    with pytest.raises(ValueError, match="different lengths"):
        kernel(**{**data, "t": data["t"][:4]})
    with pytest.raises(ValueError, match=r"input t: 4 samples, but 10 are needed"):
        kernel.evaluate(10, {**data, "t": data["t"][:4]})
    with pytest.raises(CapabilityError, match="input v is missing"):
        kernel.evaluate(10, {k: x for k, x in data.items() if k != "v"})


# -- programs -------------------------------------------------------------------------------------------
def equations(graph: Graph) -> dict[str, list[Any]]:
    q = graph.symbols(["a", "b"], "q")
    return {"r": [f.sin(q[0]) * q[1] + 0.1, f.cos(q[0] + q[1]) / q[1]], "s": [q[1] * q[1]]}


def test_equal_equations_have_equal_digests() -> None:
    digest = make_program(equations(Graph()), KNOWN).digest
    assert make_program(equations(Graph()), KNOWN).digest == digest
    busy = Graph()
    x = busy.symbols(["x", "y"], "v")
    _ = [f.tan(x[0]) * k + x[1] for k in range(5)]
    assert make_program(equations(busy), KNOWN).digest == digest, "nodes that nobody asked for"
    renamed = Graph()
    renamed.symbols(["other", "names"], "q")
    assert make_program(equations(renamed), KNOWN).digest == digest, "names of symbols"


def test_digests_tell_apart_what_is_different() -> None:
    graph = Graph()
    x, y = graph.symbols(["x", "y"], "q")
    z = graph.symbol("x", "v")
    table = (0.0, 1.0), (1.0, 2.0)
    variants = [
        {"r": [x + y]}, {"r": [x - y]}, {"r": [y - x]}, {"r": [x + z]}, {"s": [x + y]}, {"r": [x, y]}, {"r": [y, x]},
        {"r": [x], "s": [y]}, {"r": [x + 1.0]}, {"r": [x + (1.0 + 2.0**-52)]}, {"r": [1.0]}, {"r": [1.0 + 2.0**-52]},
        {"r": [f.interpolate(x, *table)]}, {"r": [jacobian([f.interpolate(x, *table)], [x])[0][0]]},
        {"r": [f.interpolate(x, (0.0, 1.0, 2.0), (1.0, 2.0, 5.0))]}, {"r": [0.0]},
    ]  # fmt: skip
    digests = [make_program(v, KNOWN).digest for v in variants]
    assert len(set(digests)) == len(variants)


def test_digests_leave_out_numbers_of_the_scene() -> None:
    def program(mass: float, second: float, knot: float) -> Program:
        graph = Graph()
        x, y = graph.symbols(["x", "y"], "q")
        m, n = literal(mass, "m"), literal(second, "n")
        outputs = [m * x + n * y, (m * n) * x, m / n, f.interpolate(x, (0.0, knot), (1.0, mass))]
        return make_program({"r": outputs}, KNOWN)

    one, other = program(1.0, -1.0, 1.0), program(3.0, 3.0, 0.5)
    assert one.digest == other.digest
    assert one.instructions == other.instructions
    assert one.numbers != other.numbers


def test_programs_count_what_they_read_and_do() -> None:
    graph = Graph()
    q, p = graph.symbols(["q0", "q1", "q2"], "q"), graph.symbols(["p0", "p1"], "p")
    program = make_program({"r": [q[2] * p[0] + 1.0, 4.0]}, KNOWN)
    assert program.inputs == {"q": 3, "p": 1}
    assert program.operations == 2


def test_arrays_of_any_kind_have_an_address() -> None:
    sealed = np.asfortranarray(RNG.normal(size=(5, 2)))
    sealed.flags.writeable = False
    arrays = (
        RNG.normal(size=3),
        np.zeros((0, 2)),
        sealed,
        RNG.normal(size=(5, 2)),
        RNG.normal(size=(9, 4))[1::2],
    )
    assert [address(a) for a in arrays] == [a.ctypes.data for a in arrays]


def test_a_call_asks_no_array_for_its_address_in_numpys_way(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = Graph()
    kernel = SampleKernel(outputs(graph), KNOWN)
    columns = {name: np.asfortranarray(array) for name, array in inputs(64).items()}
    kernel(**columns)
    asked: list[Any] = []

    def noted(frame: Any, event: str, arg: Any) -> None:
        if event == "call" and frame.f_code.co_filename.endswith("_internal.py"):
            asked.append(frame)

    sys.setprofile(noted)
    try:
        kernel(**columns)
    finally:
        sys.setprofile(None)
    # an output without columns has no address in the buffer's sense
    assert len(asked) <= 2

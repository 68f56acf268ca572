"""Programs as C99: every operation gives what it gives in Python, in few and readable statements."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Graph, Scalar
from robodyn_cli.expr.rebuild import APPLY, evaluate
from robodyn_cli.kernels.bytecode import KINDS
from robodyn_cli.kernels.c99 import Statements, comment, helpers_text, identifier, literal, wrapped
from robodyn_cli.kernels.program import make_program
from tests.exported_c import compiled, needs_compiler


class Plain:
    """Inputs x[k], numbers as literals."""

    real = "real"

    def __init__(self, numbers: Sequence[float]) -> None:
        self.numbers = numbers

    def symbol(self, group: str, position: int) -> str:
        return f"{group}[{position}]"

    def label(self, group: str, position: int) -> str:
        return f"{group}{position}"

    def number(self, place: int) -> str:
        return literal(self.numbers[place])

    def block(self, first: int, count: int) -> str:
        return f"numbers + {first}"

    def literal(self, value: float) -> str:
        return literal(value)


def values(folder: Path, outputs: Sequence[Scalar], x: Sequence[float]) -> np.ndarray:
    """Return what C computes of outputs at x."""
    program = make_program({"out": outputs}, ["x"])
    written = Statements(program, Plain(program.numbers))
    stores = [wrapped(f"out[{k}] = {text};") for k, text in enumerate(written.values["out"])]
    table = ", ".join(map(literal, program.numbers or (0.0,)))
    uses = "    (void)numbers;"
    source = "\n".join([
        "#include <math.h>", "#define F(x) x", "typedef double real;", helpers_text(written.helpers),
        "void f(const real *x, real *out);", "void f(const real *x, real *out)", "{",
        f"    static const real numbers[] = {{{table}}};", *written.lines, *stores, uses, "}",
    ])  # fmt: skip
    folder.mkdir()
    (folder / "f.c").write_text(source, encoding="utf-8")
    code = ctypes.CDLL(str(compiled(folder, "-shared", "-fPIC", out="f.so")))
    out, given = np.zeros(len(outputs)), np.array(x, dtype=float)
    pointer = ctypes.POINTER(ctypes.c_double)
    code.f(given.ctypes.data_as(pointer), out.ctypes.data_as(pointer))
    return out


def operations(x: Scalar, y: Scalar) -> dict[str, Scalar]:
    """Return every operation that a graph can have, of 0 < x, y < 1."""
    made: dict[str, Scalar] = {
        "add": x + y, "sub": x - (y - x), "mul": x * (y * 3.0), "div": x / (y / x), "neg": -(x + y), "pow": f.power(x, 1.7),
        "atan2": f.atan2(x, -y), "min": f.minimum(x, y), "max": f.maximum(x, y), "where": f.where(x - y, x, y),
        "round": f.nearest(5.0 * x), "sign": f.sign(x - y), "abs": f.absolute(x - y),
        "table": f.interpolate(x, (0.0, 0.3, 0.5), (1.0, -2.0, 4.0)),
    }  # fmt: skip
    return made | {
        op: APPLY[op](x) for op in KINDS if op not in made
    }  # functions of one argument between 0 and 1


@needs_compiler
@pytest.mark.parametrize("x", [(0.2, 0.7), (0.45, 0.1), (0.9, 0.9)])
def test_every_operation(x: tuple[float, float], tmp_path: Path) -> None:
    graph = Graph()
    made = operations(*graph.symbols(["x", "y"], "x"))
    assert set(made) == set(KINDS)
    outputs = list(made.values())
    assert values(tmp_path / "f", outputs, x) == pytest.approx(
        evaluate(outputs, {"x": x}), rel=1e-15, abs=1e-16
    )


@needs_compiler
def test_what_is_no_number_stays_none(tmp_path: Path) -> None:
    graph = Graph()
    x, y = graph.symbols(["x", "y"], "x")
    outputs = [f.minimum(x, y), f.maximum(y, x), f.sign(x), f.interpolate(x, (0.0, 1.0), (2.0, 3.0))]
    assert np.isnan(values(tmp_path / "f", outputs, (np.nan, 1.0))).all()


@needs_compiler
def test_random_expressions_keep_their_signs_and_brackets(tmp_path: Path) -> None:
    rng, graph = np.random.default_rng(3), Graph()
    pool: list[Scalar] = list(graph.symbols(["a", "b", "c"], "x"))
    for _ in range(200):
        a, b = (pool[int(k)] for k in rng.integers(max(0, len(pool) - 12), len(pool), 2))
        step = (a + b, a - b, a * b, b - 0.5 * a, -a, f.sin(a), a / (2.0 + b * b), a * -1.5)[
            int(rng.integers(8))
        ]
        pool.append(step)
    outputs, x = pool[-40:], rng.normal(size=3)
    assert values(tmp_path / "f", outputs, x.tolist()) == pytest.approx(
        evaluate(outputs, {"x": x.tolist()}), rel=1e-12
    )


def test_a_value_that_is_used_once_stands_where_it_is_used() -> None:
    graph = Graph()
    a, b = graph.symbols(["a", "b"], "x")
    program = make_program({"out": [f.sin(a) * (a + b), f.sin(a) - 2.0 * b]}, ["x"])
    written = Statements(program, Plain(()))
    assert written.lines == ["    const real sin_x0 = F(sin)(x[0]);"]
    assert written.values["out"] == ["sin_x0 * (x[0] + x[1])", "sin_x0 - x[1] * 2.0"]


def test_texts_are_safe_in_c() -> None:
    assert comment("a */ b /* \n?? \\ ö") == "a * / b / *  ? ? / ?"
    assert identifier("a-b.c#2") == "a_b_c_2"
    assert literal(0.1) == "0.1" and literal(float("-inf")) == "-HUGE_VAL" and literal(float("nan")) == "NAN"

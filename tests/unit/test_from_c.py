"""The C that robodyn writes as LLVM IR: it computes what a compiler of C makes of it."""

from __future__ import annotations

import ctypes
import hashlib
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import Mechanism
from robodyn_cli.cli.app import run
from robodyn_cli.expr.graph import Graph, Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.kernels.c99 import Statements, helpers_text, wrapped
from robodyn_cli.kernels.compiler import CompiledModule, compile_module
from robodyn_cli.kernels.from_c.module import ir_of_c
from robodyn_cli.kernels.program import make_program
from tests.unit.test_c99 import Plain, operations

CONFIGS = Path(__file__).parents[2] / "configs"
PRECISIONS = "#ifdef SINGLE\ntypedef float real;\n#define F(x) x##f\n#else\ntypedef double real;\n#define F(x) x\n#endif"
# sections of Apple's object files have names of another form
pytestmark = pytest.mark.skipif(sys.platform == "darwin", reason="objects are those of ELF")


def loaded(texts: Sequence[str], defined: Sequence[str] = ()) -> CompiledModule:
    text = ir_of_c(texts, defined)
    return compile_module(hashlib.sha256(text.encode()).hexdigest(), lambda: text)


def values(outputs: Sequence[Scalar], x: Sequence[float], single: bool) -> np.ndarray:
    """Return what the C of outputs gives at x."""
    program = make_program({"out": outputs}, ["x"])
    written = Statements(program, Plain(program.numbers))
    table = ", ".join(f"(real){x!r}" for x in program.numbers or (0.0,))
    source = "\n".join([
        PRECISIONS, helpers_text(written.helpers), "void f(const real *x, real *out)", "{",
        f"    static const real numbers[] = {{{table}}};", *written.lines,
        *(wrapped(f"out[{k}] = {text};") for k, text in enumerate(written.values["out"])), "}",
    ])  # fmt: skip
    kind = np.float32 if single else np.float64
    out, given = np.zeros(len(outputs), kind), np.array(x, kind)
    function = loaded([source], ["SINGLE"] * single).function("f", ctypes.c_void_p, ctypes.c_void_p)
    function(given.ctypes.data, out.ctypes.data)
    return out


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("x", [(0.2, 0.7), (0.45, 0.1), (0.9, 0.9)])
def test_every_operation(x: tuple[float, float], single: bool) -> None:
    outputs = list(operations(*Graph().symbols(["x", "y"], "x")).values())
    given = np.array(x, np.float32 if single else np.float64).astype(float).tolist()
    expected = evaluate(outputs, {"x": given})
    rel, least = (1e-5, 1e-6) if single else (2e-15, 1e-15)
    assert values(outputs, x, single) == pytest.approx(expected, rel=rel, abs=least)


CONTROL = """
/* words of all kinds: "if", F(1) */
enum kind { FIRST, SECOND = 4, THIRD, COUNT };
typedef struct { double key[2]; real n[3]; } numbers;
static const char *name_of(int k);
static int passed(int *count) { return ++*count > 0; }
int f(int n, const char *text, numbers *a)
{
    numbers b = *a;
    int i, j, total = 0, calls = 0, M[2][3];

    for (i = 0; i < 2; ++i)
        for (j = 0; j < 3; ++j) {
            M[i][j] = 10 * i + j;
            if (j == 2 && i)
                continue;
            total += M[i][j];
        }
    while (1) {
        if (--n < 0)
            break;
        else if (n == 1 || passed(&calls))
            total += n ? THIRD : 100;
    }
    b.n[0] = (real)(sizeof b.n / sizeof *b.n);
    b.key[1] = n > 0 ? 1 : -F(2.5);
    *a = b;
    return !calls ? -1 : strcmp(text, "a\\"\\303\\266") == 0 ? 1000 * calls + total : (int)(2 * fabs(-1.5));
}
"""


def test_statements_and_records() -> None:
    record = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    source = PRECISIONS + CONTROL.replace("static const char *name_of(int k);\n", "")
    f = loaded([source]).function("f", ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p, result=ctypes.c_int)
    total = 0 + 1 + 2 + 10 + 11 + 5 + 5 + 5 + 100  # n = 3, 2, 1, 0; n = 1 needs no call
    assert f(4, 'a"ö'.encode(), record.ctypes.data) == 3000 + total
    assert record.tolist() == [1.0, -2.5, 3.0, 4.0, 5.0]
    assert f(4, b"other", record.ctypes.data) == 3 and f(0, b"", record.ctypes.data) == -1


@pytest.mark.parametrize(
    "text", ["int f(int n) { goto end; }", "int f(int n) { return hypot(n); }", "long f(int n);"]
)
def test_other_c_is_an_error(text: str) -> None:
    with pytest.raises(NotImplementedError, match="not written here"):
        ir_of_c([text])


def test_the_library_of_a_loop(tmp_path: Path) -> None:
    """Keys, comparisons and the elimination of dependent rows."""
    scene = CONFIGS / "benchmarks" / "bennett.yaml"
    assert run(["export", str(scene), "--c", str(tmp_path / "c"), "--quiet"]) == 0
    header, source = ((tmp_path / "c" / f"bennett.{x}").read_text("utf-8") for x in "hc")
    code, mechanism = loaded([header, source]), Mechanism(scene)
    sizes = re.search(r"double key\[(\d+)\];\s+\w+ n\[(\d+)\];", header)
    rows = re.search(r"lambda\[(\d+)\]", header)
    assert sizes and rows
    numbers = np.zeros(int(sizes[1]) + int(sizes[2]))
    nq, nv = len(mechanism.q_names), len(mechanism.qd_names)
    q, qd, qdd, lam = np.zeros(nq), np.zeros(nv), np.zeros(nv), np.zeros(int(rows[1]))
    tau = np.random.default_rng(2).normal(size=nv)

    def call(name: str, *arrays: np.ndarray) -> int:
        function = code.function(f"bennett_{name}", *[ctypes.c_void_p] * len(arrays), result=ctypes.c_int)
        return int(function(*(x.ctypes.data for x in arrays)))

    call("nominal", numbers)
    call("start", q, qd)
    assert call("forward_dynamics", numbers, q, qd, tau, qdd, lam) == 0
    assert qdd == pytest.approx(mechanism.forward_dynamics(q, qd, tau), rel=1e-8, abs=1e-8)
    key = code.function("bennett_key", ctypes.c_char_p, result=ctypes.c_int)
    change = code.function("bennett_set", ctypes.c_void_p, ctypes.c_int, ctypes.c_double, result=ctypes.c_int)
    name = next(x for x in re.findall(r"/\* (robot\.\S+mass)", header))
    before = numbers.copy()
    assert key(b"no such key") == -1 and change(numbers.ctypes.data, key(name.encode()), -1.0) == 1
    assert np.array_equal(numbers, before)
    assert change(numbers.ctypes.data, key(name.encode()), 3.25) == 0 and 3.25 in numbers

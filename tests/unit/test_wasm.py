"""WebAssembly of LLVM IR: modules that node loads, and the bits that they compute."""

from __future__ import annotations

import base64
import ctypes
from pathlib import Path

import llvmlite
import numpy as np
import pytest

from robodyn_cli.errors import CapabilityError
from robodyn_cli.kernels.compiler import compile_module
from robodyn_cli.kernels.ir import Function, module
from robodyn_cli.kernels.mathematics import sincos
from robodyn_cli.kernels.wasm import WasmModule, write_wasm
from tests.kernels import without_fma
from tests.node import needs_node, run_node

LOAD = """
const memory = new WebAssembly.Memory({ initial: 64 }), env = { __linear_memory: memory };
env.__stack_pointer = new WebAssembly.Global({ value: 'i32', mutable: true }, 1 << 20);
env.__indirect_function_table = new WebAssembly.Table({ initial: 8, element: 'anyfunc' });
for (const name of data.imports) env[name] = Math[name];
const bytes = Uint8Array.from(Buffer.from(data.code, 'base64'));
const code = new WebAssembly.Instance(new WebAssembly.Module(bytes), { env }).exports;
const doubles = new Float64Array(memory.buffer);
const x = 1 << 20, y = 2 << 20;
doubles.set(data.x, x / 8);
"""


def pairs() -> str:
    """Return IR that writes sines and cosines of pairs of numbers, by another function, with a table of its own."""
    inner = Function("pair", ["ptr %x", "ptr %y"])
    factors = inner.table("factors", [1.0, -1.0])
    sine, cosine = sincos(inner, inner.load("%x", 2), fused=False)
    inner.store(sine * inner.load(factors), "%y")
    inner.store(cosine, inner.offset("%y", 2))
    inner.store(inner.intrinsic("exp", [inner.load("%x") * 1e-6]), inner.offset("%y", 4))
    inner.ret()
    outer = Function("pairs", ["ptr %x", "ptr %y", "i64 %n"])
    with outer.count(outer.int_argument("n")) as k:
        outer.call("pair", [f"ptr {outer.offset('%x', k * 2)}", f"ptr {outer.offset('%y', k * 5)}"])
    outer.ret()
    return module([inner, outer])


def loaded(made: WasmModule, x: np.ndarray, script: str, folder: Path) -> np.ndarray:
    data = {"code": base64.b64encode(made.code).decode(), "imports": made.imports, "x": x.tolist()}
    return np.array(run_node(LOAD + script, data, folder))


@needs_node
def test_sine_and_cosine_have_the_bits_of_a_processor_without_fused_multiply_add(tmp_path: Path) -> None:
    x = np.random.default_rng(3).uniform(-1e6, 1e6, 10_000)
    made = write_wasm([pairs()], ["pairs"])
    assert made.imports == ("exp",) and made.constants >= 16
    count = len(x) // 2
    got = loaded(made, x, f"code.pairs(x, y, {count}n); return Array.from(doubles.subarray(y / 8, y / 8 + {5 * count}));",
                 tmp_path)  # fmt: skip
    own = np.zeros(5 * count)
    native = compile_module("test of wasm", pairs, target=without_fma())
    native.function("pairs", ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)(
        x.ctypes.data, own.ctypes.data, count
    )
    got, own = got.reshape(-1, 5), own.reshape(-1, 5)
    np.testing.assert_array_equal(got[:, :4], own[:, :4])
    np.testing.assert_allclose(got[:, 4], own[:, 4], rtol=4e-16)  # that of the C library


@needs_node
def test_modules_call_each_other(tmp_path: Path) -> None:
    f = Function("twice", ["ptr %x", "ptr %y"], result="i64")
    f.call("pair", ["ptr %x", "ptr %y"])
    f.ret(f.integer(7))
    caller = "declare void @pair(ptr, ptr)\n" + module([f])
    made = write_wasm([caller, pairs()], ["twice", "pairs"])
    got = loaded(
        made, np.array([0.0, np.pi / 2]), "return [Number(code.twice(x, y)), doubles[y / 8 + 1]];", tmp_path
    )
    assert got.tolist() == [7.0, 1.0]


def test_an_older_library_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llvmlite, "__version__", "0.49.1")
    with pytest.raises(
        CapabilityError, match=r"wasm32-unknown-unknown takes llvmlite 0\.50 or newer; here it is 0\.49\.1"
    ):
        write_wasm([pairs()], ["pairs"])

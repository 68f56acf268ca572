"""What tests of compiled code share: programs at a chosen lane width, extreme numbers, errors in units in the last place."""

from __future__ import annotations

import ctypes
import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import mpmath as mp
import numpy as np

from robodyn_cli.expr.graph import Expr, Graph, Scalar
from robodyn_cli.kernels.compiler import Target, compile_module, machine
from robodyn_cli.kernels.ir import module
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.kernels.samples import sample_function

WIDTHS = (1, 2, 4, 8)
TINY, HUGE = 5e-324, float(np.finfo(float).max)
SPECIAL = (
    0.0, -0.0, TINY, -TINY, 1e-310, -2.2e-308, 2.2250738585072014e-308, 1e-300, -1e-160, 1e-17, 0.5, -0.5, 1.0, -1.0,
    1.0 + 2.0**-52, 2.0, -3.0, np.pi, 709.0, -745.0, 1e5, -1e15, 1e160, -1e300, HUGE, -HUGE, np.inf, -np.inf, np.nan,
)  # fmt: skip


def symbols(count: int, group: str = "x") -> list[Expr]:
    return Graph().symbols([f"{group}{k}" for k in range(count)], group)


def without_fma() -> Target:
    """Return this processor without fused multiply-add, which code may not use then; Arm always has it."""
    host = machine()
    plain = {"cpu": "x86-64", "features": ""} if host.triple.startswith("x86_64") else {}
    return dataclasses.replace(host, fused=False, **plain)


def at_width(
    program: Program, width: int, x: np.ndarray, fused: bool = True, level: int = 1
) -> dict[str, np.ndarray]:
    """Compile a program of the inputs ``x`` for a lane width and evaluate it at the samples x (T, n)."""
    text = module([sample_function("kernel", program, width, fused)])
    key = f"test {width} {fused} {hashlib.sha256(text.encode()).hexdigest()}"
    count = len(program.inputs) + len(program.outputs) + 1
    target = None if fused else without_fma()
    call = compile_module(key, lambda: text, level, target).function(
        "kernel", *[ctypes.c_void_p] * count, ctypes.c_int64
    )
    samples = len(x)
    padded = np.asfortranarray(np.concatenate([x, np.repeat(x[-1:], max(0, width - samples), axis=0)]))
    results = {k: np.empty((len(padded), len(v)), order="F") for k, v in program.outputs.items()}
    call(
        *[padded.ctypes.data for _ in program.inputs],
        *[r.ctypes.data for r in results.values()],
        program.table.ctypes.data,
        len(padded),
    )
    return {k: r[:samples] for k, r in results.items()}


def compiled(
    outputs: Mapping[str, Sequence[Scalar]], width: int, x: np.ndarray, **options: Any
) -> dict[str, np.ndarray]:
    return at_width(make_program(dict(outputs), ["x"]), width, x, **options)


def ulps(got: float, exact: Any) -> float:
    """Return the error of ``got`` in units in the last place of the exact value."""
    nearest = float(exact)
    if np.isnan(nearest) or np.isnan(got):
        return 0.0 if np.isnan(nearest) and np.isnan(got) else np.inf
    if np.isinf(nearest) or np.isinf(got):
        return 0.0 if got == nearest else np.inf
    return float(abs(mp.mpf(got) - exact) / mp.mpf(float(np.spacing(abs(nearest)))))

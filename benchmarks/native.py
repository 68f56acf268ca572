"""robodyn's compiled right-hand side as a plain function of Python, for integrators written in Python."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.system import System
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.ir import Function, Value, module
from robodyn_cli.kernels.lower import lower
from robodyn_cli.kernels.program import NUMBERS, make_program
from robodyn_cli.model.model import STATE_GROUPS


def rates(system: System) -> Callable[[float, np.ndarray], np.ndarray]:
    """Return f(t, y) of y' = f, with y = (q, v)."""
    return _compiled(system, system.acceleration, system.nq)


def switching(system: System) -> Callable[[float, np.ndarray], float]:
    """Return g(t, y), the first event function."""
    g = _compiled(system, [system.events[0].value], 0)

    def first(t: float, y: np.ndarray) -> float:
        return float(g(t, y)[0])

    return first


def _compiled(system: System, entries: Sequence[Scalar], carried: int) -> Any:
    """Return a function of (t, y) whose result is the first ``carried`` of v followed by the entries."""
    host = machine()
    program = make_program({"out": entries}, STATE_GROUPS)

    def write() -> str:
        f = Function("rhs", ["ptr %t", "ptr %y", "ptr %out", f"ptr %{NUMBERS}"])

        def values(address: str, first: int, count: int) -> list[Value]:
            return [f.load(f.offset(address, first + k)) for k in range(count)]

        q, v = values("%y", 0, system.nq), values("%y", system.nq, system.nv)
        inputs: dict[str, Any] = {"t": values("%t", 0, 1), "q": q, "v": v}
        inputs[NUMBERS] = Array(f, f"%{NUMBERS}")
        results = lower(f, program, inputs, 1, host.fused)["out"]
        for k, value in enumerate([*v[:carried], *results]):
            f.store(value, f.offset("%out", k))
        f.ret()
        return module([f])

    code = compile_module(f"benchmark {carried} {program.digest}", write)
    call = code.function("rhs", *[ctypes.c_void_p] * 4)
    t, y, out = np.zeros(1), np.zeros(system.size), np.zeros(carried + len(entries))
    numbers = program.table
    places = t.ctypes.data, y.ctypes.data, out.ctypes.data, numbers.ctypes.data

    def function(time: float, state: np.ndarray) -> np.ndarray:
        t[0] = time
        y[:] = state
        call(*places)
        return out.copy()

    function.keep = code, t, y, out, numbers  # type: ignore[attr-defined]
    return function

"""The compiled functions with which events are located: their values at a state, and a trial run up to a time."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.layout import Real, Status, Whole
from robodyn_cli.integrators.writer import ARGUMENTS
from robodyn_cli.kernels.compiler import CompiledModule
from robodyn_cli.kernels.ir import Function, Int, Value
from robodyn_cli.kernels.lower import lower

# after the run's own arguments: a copy of its memory block and its bytes, where to go, the fixed step or 0, the last
# sample to be written, results
TRIAL_ARGUMENTS = (*ARGUMENTS, "saved", "bytes", "time", "step", "last", "values")
SWITCHING_ARGUMENTS = ("n", "t", "y", "p", "values")
KINDS = {"bytes": "i64", "last": "i64", "time": "double", "step": "double"}
TYPES = {"i64": ctypes.c_int64, "double": ctypes.c_double, "ptr": ctypes.c_void_p}
COUNTERS = [Whole.ACCEPTED, Whole.REJECTED, Whole.EVALUATIONS, Whole.PROJECTIONS]
PATIENCE = 256  # steps; a trial that takes more goes on in Python, which hears interrupts


def switching_function(system: System, fused: bool) -> Function:
    """Return ``switching(n, t, y, p, values)``: the event functions at time t and state y."""
    program = system.switching
    assert program is not None
    f = Function("switching", [f"ptr %{a}" for a in SWITCHING_ARGUMENTS])
    nq: Int | int = system.nq
    nv: Int | int = system.nv
    if system.dynamics.any_size:
        nq = nv = f.load_int(f.offset("%n", int(Whole.VELOCITIES)))
    first: dict[str, tuple[str, Int | int]] = {
        "t": ("%t", 0), "q": ("%y", 0), "v": ("%y", nq), "z": ("%y", nq + nv), "p": ("%p", 0)
    }  # fmt: skip
    inputs: dict[str, list[Value]] = {}
    for group, count in program.inputs.items():
        base, start = first[group]
        row = f.offset(base, start)
        inputs[group] = [f.load(f.offset(row, k)) for k in range(count)]
    for k, value in enumerate(lower(f, program, inputs, 1, fused)["g"]):
        f.store(value, f.offset("%values", k))
    f.ret()
    return f


def trial_function() -> Function:
    """Return ``i64 trial(...)`` with ``TRIAL_ARGUMENTS``, whose result is a ``Status``.

    The run goes back to what was saved, the counters excepted, and from there to ``time``, past any events; where it
    arrives (``DONE``) the values of the event functions are stored.
    """
    f = Function("trial", [f"{KINDS.get(a, 'ptr')} %{a}" for a in TRIAL_ARGUMENTS], result="i64")
    counters = [f.offset("%n", int(c)) for c in COUNTERS]
    counted = [f.load_int(c) for c in counters]
    f.declarations.add("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")
    f.raw("call void @llvm.memcpy.p0.p0.i64(ptr %w, ptr %saved, i64 %bytes, i1 false)")
    for value, place in zip(counted, counters):
        f.store_int(value, place)
    f.store_int(0, f.offset("%n", int(Whole.WATCH)))
    f.store_int(f.int_argument("last"), f.offset("%n", int(Whole.LAST_SAMPLE)))
    f.store_int(counted[0] + counted[1] + PATIENCE, f.offset("%n", int(Whole.MAX_STEPS)))
    f.store(f.argument("time"), f.offset("%w", int(Real.T_END)))
    step = f.argument("step")
    with f.when(f.compare("ogt", step, 0.0)):
        f.store(step, f.offset("%w", int(Real.H)))
    status = f.emit_int(f"call i64 @run({', '.join(f'ptr %{a}' for a in ARGUMENTS)})")
    with f.when(f.compare_int("eq", status, int(Status.DONE))):
        time = f.offset("%w", int(Real.T))
        f.raw(f"call void @switching(ptr %n, ptr {time}, ptr %y, ptr %p, ptr %values)")
    f.ret(status)
    return f


def bind(compiled: CompiledModule) -> tuple[Callable[..., None], Callable[..., int]]:
    """Return ``switching`` and ``trial`` of a module as ctypes callables."""
    return (
        compiled.function("switching", *[ctypes.c_void_p] * len(SWITCHING_ARGUMENTS)),
        compiled.function(
            "trial", *(TYPES[KINDS.get(a, "ptr")] for a in TRIAL_ARGUMENTS), result=ctypes.c_int64
        ),
    )

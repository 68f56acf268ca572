"""The compiled functions with which events are located: their values at a state, and a trial run up to a time.

All compiled functions that Python calls take one address, of a row that says where everything lies (``PLACES``): a
call from Python costs by its arguments.
"""

from __future__ import annotations

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.stepping.writer import ARGUMENTS
from robodyn_cli.kernels.ir import Function, Int, Value
from robodyn_cli.kernels.lower import lower

# the run's own arguments, room for a copy of its memory block and its bytes, for values of the event functions, and
# for what ``locate_event`` finds
PLACES = (*ARGUMENTS, "saved", "bytes", "values", "bracket")
TRIAL_STEP_ARGUMENTS = ("ptr %places", "double %time", "i64 %last")
COUNTERS = [IntegerSlot.ACCEPTED, IntegerSlot.REJECTED, IntegerSlot.EVALUATIONS, IntegerSlot.PROJECTIONS]
PATIENCE = 256  # steps; a trial that takes more goes on in Python, which hears interrupts
COPY = "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)"


def load_places(f: Function, *names: str) -> None:
    """Load entries of ``%places`` into registers that are called after them."""
    for name in names:
        address = f.offset("%places", PLACES.index(name))
        f.raw(f"%{name} = load {'i64' if name == 'bytes' else 'ptr'}, ptr {address}, align 8")


def copy_block(f: Function, target: str, source: str) -> None:
    """Copy a memory block."""
    f.declarations.add(COPY)
    f.raw(f"call void @llvm.memcpy.p0.p0.i64(ptr {target}, ptr {source}, i64 %bytes, i1 false)")


def call_run(f: Function) -> Int:
    """Call ``run`` and return its ``Status``."""
    return f.emit_int(f"call i64 @run({', '.join(f'ptr %{a}' for a in ARGUMENTS)})")


def switching_function(system: System, fused: bool) -> Function:
    """Return ``switching(places)``: the event functions at the current time and state."""
    program = system.switching
    assert program is not None
    f = Function("switching", ["ptr %places"])
    load_places(f, "w", "n", "y", "p", "values")
    nq: Int | int = system.nq
    nv: Int | int = system.nv
    if system.dynamics.any_size:
        nq = nv = f.load_int(f.offset("%n", int(IntegerSlot.VELOCITIES)))
    first: dict[str, tuple[str, Int | int]] = {
        "t": ("%w", DoubleSlot.T), "q": ("%y", 0), "v": ("%y", nq), "z": ("%y", nq + nv), "p": ("%p", 0)
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


def trial_step_function() -> Function:
    """Return ``i64 trial_step(places, time, last)``, whose result is a ``Status``.

    The run goes back to what was saved, the counters excepted, and from there to ``time``, past any events, writing
    samples up to number ``last``; where it arrives (``DONE``) the values of the event functions are stored.
    """
    f = Function("trial_step", TRIAL_STEP_ARGUMENTS, result="i64")
    load_places(f, *ARGUMENTS, "saved", "bytes")
    counters = [f.offset("%n", int(c)) for c in COUNTERS]
    counted = [f.load_int(c) for c in counters]
    copy_block(f, "%w", "%saved")
    for value, place in zip(counted, counters):
        f.store_int(value, place)
    f.store_int(0, f.offset("%n", int(IntegerSlot.WATCH)))
    f.store_int(f.int_argument("last"), f.offset("%n", int(IntegerSlot.LAST_SAMPLE)))
    f.store_int(counted[0] + counted[1] + PATIENCE, f.offset("%n", int(IntegerSlot.MAX_STEPS)))
    f.store(f.argument("time"), f.offset("%w", int(DoubleSlot.T_END)))
    status = call_run(f)
    with f.when(f.compare_int("eq", status, int(Status.DONE))):
        f.raw("call void @switching(ptr %places)")
    f.ret(status)
    return f

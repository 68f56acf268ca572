"""The compiled loop over many runs of one system: restore its memory, set the numbers, drive, keep the end.

It calls the functions of the run's own module by address, so it is one small module for all systems.
"""

from __future__ import annotations

from robodyn_cli.integrators.event_location.locate_event import PLACES, copy_block, load_places
from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.stepping.stepper import SLACK
from robodyn_cli.kernels.ir import Condition, Function, Int, Loop, module
from robodyn_cli.kernels.program import NUMBERS

# A table of addresses and numbers.
# run, trial : ``run_to_event`` and ``trial_step``. stop : a count that is not zero ends the loop. clear : empty memory.
# events : how many functions there are; passing : those at which a run goes on, by bit.
# Rows of the runs, with the bytes of each: w, n, y and numbers as in ``PLACES``, and blocks of samples.
JOB = (
    "run", "trial", "stop", "clear", "events", "passing",
    "all.w", "bytes.w", "all.n", "bytes.n", "all.y", "bytes.y",
    f"all.{NUMBERS}", f"bytes.{NUMBERS}", "all.out", "bytes.out", "all.status",
)  # fmt: skip
INTEGERS = ("bytes", "events", "passing")
KEPT = ("w", "n", "y")  # rows that are restored before a run and kept after it
ARGUMENTS = ("ptr %places", "ptr %job", "i64 %first", "i64 %last")
MOST_EVENTS = 1000  # of a run: with more it may be chattering


def write_many() -> str:
    """Return the IR of ``i64 many(places, job, first, last)``, which makes the runs first .. last - 1.

    Rows of ``KEPT`` hold a run's start before, and its end after; ``all.status`` holds the ``Status`` of each. The
    result is the number of the first run that was not made.
    """
    f = Function("many", ARGUMENTS, result="i64")
    load_places(f, *KEPT, NUMBERS, "bytes", "values")
    load_job(f)
    run, status, events = f.int_slot(), f.int_slot(), f.int_slot()
    f.store_int(f.int_argument("first"), run)
    with f.loop() as runs:
        k = f.load_int(run)
        runs.leave(unless=f.compare_int("slt", k, f.int_argument("last")))
        runs.leave(f.compare_int("ne", f.load_int("%stop"), 0))
        copy_block(f, "%w", "%clear")
        for name in (*KEPT, NUMBERS):
            f.copy(f"%{name}", row_of(f, name, k), f"%bytes.{name}")
        f.store_address(row_of(f, "out", k), f.offset("%places", PLACES.index("out")))
        f.store_int(0, events)
        with f.loop() as stretches:
            f.store_int(f.emit_int("call i64 %run(ptr %places)"), status)
            stretches.leave(f.compare_int("ne", f.load_int(status), int(Status.EVENT)))
            stretches.leave(f.compare_int("sgt", f.bump(events), MOST_EVENTS))
            stretches.leave(unless=_is_passed(f))
            _write_passed_samples(f, k, stretches)
            _restore(f, k)
        for name in KEPT:
            f.copy(row_of(f, name, k), f"%{name}", f"%bytes.{name}")
        f.store_int(f.load_int(status), f.offset("%all.status", k))
        f.store_int(k + 1, run)
    f.ret(f.load_int(run))
    return module([f])


def load_job(f: Function) -> None:
    """Load the entries of ``%job`` into registers of the same names."""
    for place, name in enumerate(JOB):
        f.load_argument(name, "i64" if name.startswith(INTEGERS) else "ptr", f.offset("%job", place))


def row_of(f: Function, name: str, k: Int | int) -> str:
    """Return the address of the row of run k."""
    return f.name(f"getelementptr i8, ptr %all.{name}, i64 {(f.int_argument(f'bytes.{name}') * k).ref}")


def _is_passed(f: Function) -> Condition:
    """Return whether the state is at the event that was met, alone, and the run goes on there."""
    located = f.compare_int("ne", f.load_int(f.offset("%n", IntegerSlot.LOCATED)), 0)
    event = f.load_int(f.offset("%n", IntegerSlot.EVENT))
    bit = f.emit_int(f"lshr i64 %passing, {event.ref}") & 1
    return located & f.compare_int("ne", bit, 0)


def _write_passed_samples(f: Function, k: Int, stretches: Loop) -> None:
    """Take the step up to the event again where samples lie in it: trial steps write none."""
    following = f.load_int(f.offset("%n", IntegerSlot.NEXT_SAMPLE))
    last = f.load_int(f.offset(row_of(f, "n", k), IntegerSlot.LAST_SAMPLE))
    time, start, step = (
        f.load(f.offset("%w", place))
        for place in (DoubleSlot.T, DoubleSlot.SAMPLE_START, DoubleSlot.SAMPLE_STEP)
    )
    with f.strict():
        sample = start + f.to_double(following) * step
        due = f.compare("ole", sample, time + (f.abs(time) + f.abs(start)) * SLACK)
    with f.when(due & f.compare_int("sle", following, last)):
        arrived = f.emit_int(f"call i64 %trial(ptr %places, double {time.ref}, i64 {last.ref})")
        stretches.leave(f.compare_int("ne", arrived, int(Status.DONE)))
        with f.count(f.int_argument("events")) as event:
            f.store(f.load(f.offset("%values", event)), f.offset(f.offset("%w", DoubleSlot.SIZE), event))
        f.store_int(1, f.offset("%n", IntegerSlot.WATCH))


def _restore(f: Function, k: Int) -> None:
    """Set again what trial steps have used for themselves."""
    places = (("w", DoubleSlot.T_END), ("n", IntegerSlot.MAX_STEPS), ("n", IntegerSlot.LAST_SAMPLE))
    for array, place in places:
        f.store_int(f.load_int(f.offset(row_of(f, array, k), place)), f.offset(f"%{array}", place))

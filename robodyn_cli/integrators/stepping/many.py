"""The compiled loop over many runs of one system: restore its memory, set the numbers, drive, keep the end.

It calls the functions of the run's own module by address, so it is one small module for all systems.
"""

from __future__ import annotations

from robodyn_cli.integrators.event_location.locate_event import PLACES, copy_block, load_places
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, LatchAnswer, Location, Status
from robodyn_cli.integrators.stepping.stepper import SLACK
from robodyn_cli.kernels.ir import Condition, Function, Int, LoopBlock, Value, module
from robodyn_cli.kernels.program import NUMBERS

# A table of addresses and numbers.
# run, trial, close : ``run_to_event``, ``trial_step`` and ``close_latch``, where there is one. stop : a count that is
# not zero ends the loop. clear : empty memory.
# events : how many functions there are; passing : those at which a run goes on, by bit.
# stops : how many stretches there are between breakpoints; stretches : of each, as ``options.stretches`` gives them.
# Rows of the runs, with the bytes of each: w, n, y, p and numbers as in ``PLACES``, and blocks of samples.
JOB = (
    "run", "trial", "close", "stop", "clear", "events", "passing", "stops", "stretches",
    "all.w", "bytes.w", "all.n", "bytes.n", "all.y", "bytes.y", "all.p", "bytes.p",
    f"all.{NUMBERS}", f"bytes.{NUMBERS}", "all.out", "bytes.out", "all.status",
)  # fmt: skip
INTEGERS = ("bytes", "events", "passing", "stops")
KEPT = ("w", "n", "y", "p")  # rows that are restored before a run and kept after it
FOUND = (IntegerSlot.EVENT, IntegerSlot.LOCATED, IntegerSlot.WATCH)  # at an event, as it was located
ARGUMENTS = ("ptr %places", "ptr %job", "i64 %first", "i64 %last")
STRETCH = 3  # doubles of a stretch
MOST_FUNCTIONS = 63  # events that fit into the bits of a number
MOST_EVENTS = 1000  # of a run: with more it may be chattering


def write_many() -> str:
    """Return the IR of ``i64 many(places, job, first, last)``, which makes the runs first .. last - 1.

    Rows of ``KEPT`` hold a run's start before, and its end after; ``all.status`` holds the ``Status`` of each. The
    result is the number of the first run that was not made.
    """
    f = Function("many", ARGUMENTS, result="i64")
    load_places(f, *KEPT, NUMBERS, "bytes", "bracket")
    load_job(f)
    run, status, events, stretch = (f.int_slot() for _ in range(4))
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
        f.store_int(0, stretch)
        _enter(f, k, stretch)
        with f.loop() as parts:
            f.store_int(f.emit_int("call i64 %run(ptr %places)"), status)
            with f.when(f.compare_int("eq", f.load_int(status), int(Status.DONE)) & _has_more(f, k, stretch)):
                f.bump(stretch)
                _enter(f, k, stretch)
                parts.again()
            parts.leave(f.compare_int("ne", f.load_int(status), int(Status.EVENT)))
            parts.leave(f.compare_int("sgt", f.bump(events), MOST_EVENTS))
            parts.leave(unless=_is_passed(f))
            _write_passed_samples(f, k, parts)
            _close_latch(f, status, parts)
            _restore(f, k)
            _enter(f, k, stretch)
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


def _stretch(f: Function, stretch: str, entry: int) -> Value:
    """Return an entry of the present stretch between breakpoints."""
    row = f.offset("%stretches", f.load_int(stretch) * STRETCH)
    return f.load(f.offset(row, entry))


def _enter(f: Function, k: Int, stretch: str) -> None:
    """Let run k go to the end of a stretch, or to its own before that; formulas of time are kept to the stretch."""
    end = f.load(f.offset(row_of(f, "w", k), DoubleSlot.T_END))
    f.store(f.min(_stretch(f, stretch, 0), end), f.offset("%w", DoubleSlot.T_END))
    for entry, place in ((1, DoubleSlot.T_AFTER), (2, DoubleSlot.T_BEFORE)):
        f.store(_stretch(f, stretch, entry), f.offset("%w", place))


def _has_more(f: Function, k: Int, stretch: str) -> Condition:
    """Tell whether run k has not come to its end with a stretch."""
    end = f.load(f.offset(row_of(f, "w", k), DoubleSlot.T_END))
    further = f.compare_int("slt", f.load_int(stretch) + 1, f.int_argument("stops"))
    return further & f.compare("olt", _stretch(f, stretch, 0), end)


def _is_at(f: Function, location: Location) -> Condition:
    """Return whether the state is there."""
    return f.compare_int("eq", f.load_int(f.offset("%n", IntegerSlot.LOCATED)), int(location))


def _is_passed(f: Function) -> Condition:
    """Return whether the state is at the event that was met, alone, and the run goes on there; or at none."""
    event = f.load_int(f.offset("%n", IntegerSlot.EVENT))
    event = f.select_int(f.compare_int("slt", event, MOST_FUNCTIONS), event, MOST_FUNCTIONS)
    bit = f.emit_int(f"lshr i64 %passing, {event.ref}") & 1
    return _is_at(f, Location.NOTHING) | (_is_at(f, Location.EVENT) & f.compare_int("ne", bit, 0))


def _write_passed_samples(f: Function, k: Int, parts: LoopBlock) -> None:
    """Take the step up to the event again where samples lie in it: trial steps write none.

    Such a step begins from what was saved before the event was located, so that what was found is put back behind it.
    """
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
        found = [(place, f.load_int(place)) for place in (f.offset("%n", x) for x in FOUND)]
        sides = f.offset("%w", DoubleSlot.SIZE)
        _copy_values(f, sides, "%bracket")
        arrived = f.emit_int(f"call i64 %trial(ptr %places, double {time.ref}, i64 {last.ref})")
        parts.leave(f.compare_int("ne", arrived, int(Status.DONE)))
        _copy_values(f, "%bracket", sides)
        for place, number in found:
            f.store_int(number, place)


def _copy_values(f: Function, source: str, target: str) -> None:
    """Copy a value of each event function."""
    with f.count(f.int_argument("events")) as event:
        f.store(f.load(f.offset(source, event)), f.offset(target, event))


def _close_latch(f: Function, status: str, parts: LoopBlock) -> None:
    """Answer the event of a latch where code does that; leave the run where it does not, or ends there."""
    answers = Condition(f, f.name("icmp ne ptr %close, null"), 1)
    with f.when(answers & _is_at(f, Location.EVENT)):
        verdict = f.emit_int("call i64 %close(ptr %places)")
        ends = f.compare_int("eq", verdict, int(LatchAnswer.ENDS))
        f.store_int(f.select_int(ends, int(Status.HALTED), int(Status.EVENT)), status)
        parts.leave(f.compare_int("ne", verdict, int(LatchAnswer.GOES_ON)))


def _restore(f: Function, k: Int) -> None:
    """Set again what trial steps have used for themselves, but for their end."""
    for place in (IntegerSlot.MAX_STEPS, IntegerSlot.LAST_SAMPLE):
        f.store_int(f.load_int(f.offset(row_of(f, "n", k), place)), f.offset("%n", place))

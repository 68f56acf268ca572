"""Many runs side by side in the lanes of vectors, each at its own time, with its own step.

A lane that is done takes the next run.

The step of the method, its error and the control of its length are those of the scalar loop, written for vectors. What
only the scalar loop has (events, corrections, samples) is not asked for here.

The compiled loop over many runs of one system: restore its memory, set the numbers, drive, keep the end.

It calls the functions of the run's own module by address, so it is one small module for all systems.
"""

from __future__ import annotations

from typing import Any

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.event_location.locate_event import PLACES, copy_block, load_places
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, LatchAnswer, Location, Status
from robodyn_cli.integrators.stepping.control import judge, shorter
from robodyn_cli.integrators.stepping.loop import REJECTIONS, RESOLUTION, end_of, is_too_small, step_over
from robodyn_cli.integrators.stepping.stepper import SLACK, Method, Stepper
from robodyn_cli.integrators.stepping.writer import LONG, Tables, Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import RELAXED, Condition, Function, Int, LoopBlock, Value, module
from robodyn_cli.kernels.lower import Programs
from robodyn_cli.kernels.program import NUMBERS, Program

# counts of a lane's run, as doubles behind its slots
ACCEPTED, REJECTED, EVALUATIONS, IN_ROW, MOST, STATUS, SIZE = (DoubleSlot.SIZE + k for k in range(7))
COUNTED = {
    ACCEPTED: IntegerSlot.ACCEPTED,
    REJECTED: IntegerSlot.REJECTED,
    EVALUATIONS: IntegerSlot.EVALUATIONS,
}
IDLE, UNUSED = -1, -2  # in place of the number of a run
NEVER = 1e300  # a time that no run comes to


def suits(system: System, method: Method) -> bool:
    """Tell whether runs of a system can be made in lanes by a method."""
    return (
        method.vectors
        and not (system.dynamics.any_size or system.events or method.moves_state(system))
        and not (system.breakpoints or system.partition or system.parameters or system.updates)
        and system.nv <= LONG
        and not any(step.program.has_tables for step in method.programs(system))
    )


def write_lanes(system: System, method: Method, fused: bool, width: int) -> str:
    """Return the IR of ``i64 many(places, job, first, last)``, which makes runs as that of ``write_many`` does."""
    programs = Programs(fused, number_lanes=width)
    w = LaneWriter(system, method.tables(system), programs, width)
    _write_loop(w, method.stepper(w))
    return module([w.f, *programs.functions.values()])


class LaneWriter(Writer):
    """A writer whose values are vectors, a lane a run.

    slots : the doubles of each lane's run, and its counts.
    """

    def __init__(self, system: System, tables: Tables, programs: Programs, width: int) -> None:
        self.width = width
        super().__init__(system, tables, programs, loops=False)
        f = self.f
        self.slots = Array(f, f.slot(width, SIZE), width)
        self.table = Array(f, f.slot(width, len(tables.numbers)), width)
        self._integer = f.int_slot()

    def _function(self) -> Function:
        return Function("many", list(ARGUMENTS), result="i64", flags=RELAXED)

    def array(self, velocities: int, others: int, width: int = 1) -> Array:
        assert isinstance(self.system.nv, int)
        count = velocities * self.system.nv + others * self.system.nz
        return Array(self.f, self.f.slot(self.width, max(1, count)), self.width)

    def behind_dense(self, first: Int | int) -> Array:
        return self.array(2, 1)

    def get(self, place: int) -> Value:
        return self.slots[int(place)]

    def put(self, place: int, value: Value | float) -> None:
        self.slots[int(place)] = value

    def integer_at(self, place: int) -> str:
        """Return room for what a step notes: whether the rate is known, which no lane says of all."""
        return self._integer

    def count(self, place: int, by: int = 1, where: Condition | None = None) -> None:
        if place == IntegerSlot.EVALUATIONS:
            more = self.f.constant(float(by), self.width)
            if where is not None:
                more = self.f.select(where, more, self.f.constant(0.0, self.width))
            self.slots[EVALUATIONS] = self.slots[EVALUATIONS] + more

    def begins_anew(self) -> Condition:
        tried = self.slots[ACCEPTED] + self.slots[REJECTED]
        return self.rejected_before() | self.f.compare("oeq", tried, 0.0)

    def rejected_before(self) -> Condition:
        return self.f.compare("ogt", self.slots[IN_ROW], 0.0)

    def numbers(self, program: Program) -> Array:
        return self.table.part(self.tables.start(program))


def _write_loop(w: LaneWriter, stepper: Stepper[Any]) -> None:
    f = w.f
    load_job(f)
    queue = _Queue(w)
    f.store_int(0, w.integer_at(IntegerSlot.RATE_KNOWN))
    with f.loop() as rounds:
        queue.turn_over()
        rounds.leave(f.compare_int("eq", f.load_int(queue.busy), 0))
        t, end = w.get(DoubleSlot.T), w.get(DoubleSlot.T_END)
        with f.strict():
            left = end - t
        step = step_over(w, stepper, t, left)
        with f.block() as failed:
            attempt = stepper.attempt(step.t, step.h, failed)
        verdict = judge(w, True, stepper.control, step.h, attempt)
        counts = f.compare("olt", verdict.square, 1.0)
        reached, rest = end_of(w, step)
        length = f.select(counts, step.h * verdict.factor, shorter(w, verdict, step.h))
        changes = {DoubleSlot.T_REST: rest, DoubleSlot.H_OLD: step.h, DoubleSlot.T: reached}
        assert verdict.log_error is not None
        for place, value in {**changes, DoubleSlot.LAST_ERROR: verdict.log_error}.items():
            w.put(place, f.select(counts, value, w.get(place)))
        w.put(DoubleSlot.H, length)
        for k in w.each(w.size):
            w.state[k] = f.select(counts, w.new[k], w.state[k])
        _count(w, counts)
        over = _is_over(w, counts)
        queue.note(over)
        goes_on = ~((~counts) | over).any()
        f.store_int(goes_on.mask() if stepper.knows_end else 0, w.integer_at(IntegerSlot.RATE_KNOWN))
    f.ret(f.load_int(queue.following))


def _count(w: LaneWriter, counts: Condition) -> None:
    """Count the steps that were taken and rejected."""
    f, one = w.f, w.f.constant(1.0, w.width)
    zero = f.constant(0.0, w.width)
    w.put(ACCEPTED, w.get(ACCEPTED) + f.select(counts, one, zero))
    w.put(REJECTED, w.get(REJECTED) + f.select(counts, zero, one))
    w.put(IN_ROW, f.select(counts, zero, w.get(IN_ROW) + 1.0))


def _is_over(w: LaneWriter, counts: Condition) -> Condition:
    """Return which lanes have come to their end, and note with which ``Status``."""
    f = w.f
    with f.strict():
        end = w.get(DoubleSlot.T_END)
        arrived = counts & ~f.compare("ogt", end - w.get(DoubleSlot.T), f.abs(end) * RESOLUTION)
        small = ~counts & (
            is_too_small(w, w.get(DoubleSlot.H)) | f.compare("ogt", w.get(IN_ROW), float(REJECTIONS))
        )
        many = f.compare("oge", w.get(ACCEPTED) + w.get(REJECTED), w.get(MOST))
        status = f.select(small, float(Status.STEP_TOO_SMALL), f.constant(float(Status.MAX_STEPS), w.width))
        w.put(STATUS, f.select(arrived, float(Status.DONE), status))
    return arrived | small | many


class _Queue:
    """The runs that are to be made, and the lanes that make them.

    following : the next run. busy : lanes with a run. runs : of each lane its run, ``IDLE`` or ``UNUSED``. over : lanes
    to turn over, as bits; all of them at first.
    """

    def __init__(self, w: LaneWriter) -> None:
        self.w, self.f = w, w.f
        f = self.f
        self.following, self.busy, self.over = f.int_slot(), f.int_slot(), f.int_slot()
        self.runs = f.slot(1, w.width)
        f.store_int(f.int_argument("first"), self.following)
        f.store_int(0, self.busy)
        f.store_int(2**w.width - 1, self.over)
        for lane in range(w.width):
            f.store_int(UNUSED, f.offset(self.runs, lane))

    def note(self, over: Condition) -> None:
        self.f.store_int(over.mask(), self.over)

    def turn_over(self) -> None:
        """Keep the ends of the lanes that are over, and give them the next runs."""
        f = self.f
        with f.when(f.compare_int("ne", f.load_int(self.over), 0)), f.count(self.w.width) as lane:
            bit = f.emit_int(f"lshr i64 {f.load_int(self.over).ref}, {lane.ref}") & 1
            with f.when(f.compare_int("ne", bit, 0)):
                place = f.offset(self.runs, lane)
                with f.when(f.compare_int("sge", f.load_int(place), 0)):
                    self._keep(f.load_int(place), lane)
                    f.bump(self.busy, -1)
                self._take_next(place, lane)

    def _take_next(self, place: str, lane: Int) -> None:
        """Give a lane the next run; one without goes on with the last it had, of which nothing is kept.

        At first that is the first run: numbers of no meaning take many times as long.
        """
        f, w = self.f, self.w
        with f.when(f.compare_int("eq", f.load_int(place), UNUSED)):
            self._load(f.int_argument("first"), lane)
        f.store_int(IDLE, place)
        f.store(NEVER, self._entry(w.slots, DoubleSlot.T_END, lane))
        f.store(NEVER, self._entry(w.slots, MOST, lane))
        following = f.load_int(self.following)
        wanted = f.compare_int("eq", f.load_int("%stop"), 0)
        with f.when(f.compare_int("slt", following, f.int_argument("last")) & wanted):
            f.store_int(following, place)
            f.bump(self.following)
            f.bump(self.busy)
            self._load(following, lane)

    def _load(self, run: Int, lane: Int) -> None:
        """Put a run into a lane."""
        f, w = self.f, self.w
        sources = {
            "w": (w.slots, DoubleSlot.SIZE),
            "y": (w.state, w.size),
            NUMBERS: (w.table, len(w.tables.numbers)),
        }
        for name, (target, count) in sources.items():
            row = row_of(f, name, run)
            with f.count(count) as k:
                f.store(f.load(f.offset(row, k)), self._entry(target, k, lane))
        for place in (ACCEPTED, REJECTED, EVALUATIONS, IN_ROW):
            f.store(0.0, self._entry(w.slots, place, lane))
        most = f.load_int(f.offset(row_of(f, "n", run), IntegerSlot.MAX_STEPS))
        f.store(f.to_double(most), self._entry(w.slots, MOST, lane))

    def _keep(self, run: Int, lane: Int) -> None:
        """Store what a lane's run has come to."""
        f, w = self.f, self.w
        for name, (source, count) in {"w": (w.slots, DoubleSlot.SIZE), "y": (w.state, w.size)}.items():
            row = row_of(f, name, run)
            with f.count(count) as k:
                f.store(f.load(self._entry(source, k, lane)), f.offset(row, k))
        for place, slot in COUNTED.items():
            counted = f.to_int(f.load(self._entry(w.slots, place, lane)))
            f.store_int(counted, f.offset(row_of(f, "n", run), slot))
        f.store_int(f.to_int(f.load(self._entry(w.slots, STATUS, lane))), f.offset("%all.status", run))

    def _entry(self, vectors: Array, k: Int | int, lane: Int) -> str:
        """Return the address of one lane of a vector."""
        return self.f.offset(vectors.at(k), lane)


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
    load_places(f, *KEPT, NUMBERS, "bytes", "values")
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
        parts.leave(f.compare_int("ne", arrived, int(Status.DONE)))
        with f.count(f.int_argument("events")) as event:
            f.store(f.load(f.offset("%values", event)), f.offset(f.offset("%w", DoubleSlot.SIZE), event))
        f.store_int(1, f.offset("%n", IntegerSlot.WATCH))


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

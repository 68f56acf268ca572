"""Many runs side by side in the lanes of vectors, each at its own time, with its own step.

A lane that is done takes the next run.

The step of the method, its error and the control of its length are those of the scalar loop, written for vectors. What
only the scalar loop has (events, corrections, samples) is not asked for here.
"""

from __future__ import annotations

from typing import Any

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.stepping.control import judge, shorter
from robodyn_cli.integrators.stepping.loop import REJECTIONS, RESOLUTION, end_of, is_too_small, step_over
from robodyn_cli.integrators.stepping.many import ARGUMENTS, load_job, row_of
from robodyn_cli.integrators.stepping.stepper import Method, Stepper
from robodyn_cli.integrators.stepping.writer import LONG, Tables, Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import RELAXED, Condition, Function, Int, Value, module
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
        and not system.is_rounded
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

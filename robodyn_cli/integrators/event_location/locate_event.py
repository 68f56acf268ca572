"""The compiled functions that run to an event and locate it by trial steps.

A crossing of one function alone is located here. In all other cases these functions return a bracket with all values
at its ends, and ``first_roots`` finds from these values which functions cross, or where one of them cannot be
followed.

Each compiled function takes one address, that of a table of addresses (``PLACES``), because a call from Python takes
longer with every argument.
"""

from __future__ import annotations

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.memory import FINE, UNARMED, DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.stepping.writer import ARGUMENTS, Tables
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Condition, Function, Int, Value
from robodyn_cli.kernels.lower import INLINE_LIMIT, LANES, REGISTERS, Programs
from robodyn_cli.kernels.program import NUMBERS, Program

# the run's own arguments, room for a copy of its memory block and its bytes, for values of the event functions, and
# for what ``locate_event`` finds
PLACES = (*ARGUMENTS, "saved", "bytes", "values", "bracket")
COUNTERS = [IntegerSlot.ACCEPTED, IntegerSlot.REJECTED, IntegerSlot.EVALUATIONS, IntegerSlot.PROJECTIONS]
PATIENCE = 256  # steps; a trial step that takes more goes on in Python, where interrupts are handled
TELLING = 16.0  # a secant is used if its two times differ by at least so many resolutions
TRIALS = 10  # a simple root takes three, one that is shared four
MORE_TRIALS = 20  # where rounding hides a root behind which the run could go on without Python
STEEPEST = 1e300
RESTART = 1 / 16  # first step after a jump, as a part of the time since the last one


def load_places(f: Function, *names: str) -> None:
    """Load entries of ``%places`` into registers of the same names."""
    for name in names:
        address = f.offset("%places", PLACES.index(name))
        f.load_argument(name, "i64" if name == "bytes" else "ptr", address)


def copy_block(f: Function, target: str, source: str) -> None:
    """Copy a memory block."""
    f.copy(target, source, "%bytes")


def call_run(f: Function) -> Int:
    """Call ``run`` and return its ``Status``."""
    return f.call_int("run", [f"ptr %{a}" for a in ARGUMENTS])


def switching_function(system: System, tables: Tables, programs: Programs) -> Function:
    """Return ``switching(places)``: the event functions at the current time and state."""
    program = system.switching
    assert program is not None
    f = Function("switching", ["ptr %places"])
    load_places(f, "w", "n", "y", "p", NUMBERS, REGISTERS, "values")
    # eight at once like in the search, so that a long program is in the module but once
    width = 1 if program.operations <= INLINE_LIMIT else LANES
    values = programs.evaluate(f, program, inputs_at(f, system, tables, program), width)
    for k, value in enumerate(values["g"]):
        f.store(f.lane(value, 0), f.offset("%values", k))
    f.ret()
    return f


def inputs_at(f: Function, system: System, tables: Tables, program: Program) -> dict[str, Array]:
    """Return the inputs of a program at the current time and state; places are loaded."""
    nq: Int | int = system.nq
    nv: Int | int = system.nv
    if system.dynamics.any_size:
        nq = nv = f.load_int(f.offset("%n", IntegerSlot.VELOCITIES))
    first: dict[str, tuple[str, Int | int]] = {
        "t": ("%w", DoubleSlot.T), "q": ("%y", 0), "v": ("%y", nq), "z": ("%y", nq + nv), "p": ("%p", 0)
    }  # fmt: skip
    inputs = {group: Array(f, f.offset(*first[group])) for group in program.inputs}
    return {**inputs, NUMBERS: Array(f, f.offset(f"%{NUMBERS}", tables.start(program)))}


def trial_step_function() -> Function:
    """Return ``i64 trial_step(places, time, last)``, whose result is a ``Status``.

    The run goes back to what was saved, the counters excepted, and from there to ``time``, past any events, writing
    samples up to number ``last``; where it arrives (``DONE``) the values of the event functions are stored.
    """
    f = Function("trial_step", ["ptr %places", "double %time", "i64 %last"], result="i64")
    load_places(f, *ARGUMENTS, "saved", "bytes")
    counters = [f.offset("%n", c) for c in COUNTERS]
    counted = [f.load_int(c) for c in counters]
    copy_block(f, "%w", "%saved")
    for value, place in zip(counted, counters):
        f.store_int(value, place)
    f.store_int(0, f.offset("%n", IntegerSlot.WATCH))
    f.store_int(f.int_argument("last"), f.offset("%n", IntegerSlot.LAST_SAMPLE))
    f.store_int(counted[0] + counted[1] + PATIENCE, f.offset("%n", IntegerSlot.MAX_STEPS))
    f.store(f.argument("time"), f.offset("%w", DoubleSlot.T_END))
    status = call_run(f)
    with f.when(f.compare_int("eq", status, int(Status.DONE))):
        f.call("switching", ["ptr %places"])
    f.ret(status)
    return f


def restart_function(count: int) -> Function:
    """Return ``restart(places, step)``: the run goes on from a state that has been replaced, with a step that is at
    most so long, and its event functions are to be armed anew."""
    f = Function("restart", ["ptr %places", "double %step"], flags="")
    load_places(f, "w", "n")
    t, since = (f.load(f.offset("%w", slot)) for slot in (DoubleSlot.T, DoubleSlot.SINCE))
    # the next event may come sooner than the last one did, so the step starts short again
    with f.when(f.compare("ogt", t, since)):
        f.store((t - since) * RESTART, f.offset("%w", DoubleSlot.RESTART))
        f.store(t, f.offset("%w", DoubleSlot.SINCE))
    part = f.min(f.load(f.offset("%w", DoubleSlot.RESTART)), f.argument("step"))
    step = f.min(f.load(f.offset("%w", DoubleSlot.H)), f.load(f.offset("%w", DoubleSlot.FIRST)) * part)
    f.store(step, f.offset("%w", DoubleSlot.H))
    with f.count(count) as k:
        f.store(0.0, f.offset(f.offset("%w", DoubleSlot.SIZE), k))
    f.store_int(UNARMED, f.offset("%n", IntegerSlot.WATCH))
    f.store_int(0, f.offset("%n", IntegerSlot.RATE_KNOWN))
    f.ret()
    return f


def run_to_event_function(count: int) -> Function:
    """Return ``i64 run_to_event(places)``, which calls ``run``, and ``locate_event`` where that meets an event.

    Its result is the ``Status`` of ``run``. At an event, ``%saved`` holds the run as it was before the step. Functions
    that are to be watched from the start are armed first.
    """
    f = Function("run_to_event", ["ptr %places"], result="i64", flags="")
    load_places(f, *(PLACES if count else ARGUMENTS))
    if count:
        watch = f.load_int(f.offset("%n", IntegerSlot.WATCH))
        with f.when(f.compare_int("eq", watch, UNARMED)):
            f.call("switching", ["ptr %places"])
            _arm(f, count)
    status = call_run(f)
    if count:
        with f.when(f.compare_int("eq", status, int(Status.EVENT))):
            copy_block(f, "%saved", "%w")
            located = f.call_int("locate_event", ["ptr %places"])
            f.store_int(located, f.offset("%n", IntegerSlot.LOCATED))
    f.ret(status)
    return f


def locate_event_function(count: int, closings: bool) -> Function:
    """Return ``i64 locate_event(places)`` for so many event functions; 1 if the state is at an event of one function
    alone.

    Secants, each going a little beyond its root, until one lies beyond it by less than the resolution, or the last two
    lie on either side of it so near. If no other function has changed its sign on the way there, that is the event, and
    the run may go on from there; else the secants go on until the bracket is so short, with bisection where a secant
    leaves it. They give up where a trial step fails or meets values of zero, or beyond (T, T_END).

    closings : whether latches close by themselves; a function that stays zero is then one of a closed latch.
    bracket : two rows of 1 + count, a time and the values there, before and after the sign change; the time is NaN
    where no trial step was on that side.
    """
    f = Function("locate_event", ["ptr %places"], result="i64", flags="")
    load_places(f, "w", "n", "values", "bracket")
    samples = f.load_int(f.offset("%n", IntegerSlot.LAST_SAMPLE))
    secants = _Secants(f, count, MORE_TRIALS if closings else TRIALS)
    with f.block() as given_up:
        with f.loop() as rounds:
            x, g = secants.try_next(given_up)
            with f.when(f.compare("oeq", g, 0.0)):
                # zero belongs to neither side
                f.store(x + secants.half, secants.x)
                rounds.again()
            after, beyond = secants.note(x, g)
            near = f.compare("ole", beyond, secants.resolution) | secants.is_short()
            with f.when(after & near):
                rounds.leave(_alone(f, count, closings))
                given_up.leave(secants.is_short())
            secants.aim(x, after, beyond)
        _arm(f, count)
        f.store_int(samples, f.offset("%n", IntegerSlot.LAST_SAMPLE))
        f.ret(1)
    f.ret(0)
    return f


class _Secants:
    """Secants of the event function that changed sign; x is the time of the next trial step."""

    def __init__(self, f: Function, count: int, trials: int) -> None:
        self.f, self.count, self.trials = f, count, trials
        self.before, self.after = "%bracket", f.offset("%bracket", 1 + count)
        self.x, self.slope, self.old_x, self.old_g = f.slot(), f.slot(), f.slot(), f.slot()
        self.rounds = f.int_slot()
        self.start = f.load(f.offset("%w", DoubleSlot.T))
        high = f.load(f.offset("%w", DoubleSlot.EVENT_HIGH))
        self.end = f.min(high, f.load(f.offset("%w", DoubleSlot.T_END)))
        self.resolution = f.max(f.abs(self.start), f.abs(self.end)) * FINE
        self.half = self.resolution * 0.5
        self.which = f.load_int(f.offset("%n", IntegerSlot.EVENT))
        slope = f.load(f.offset("%w", DoubleSlot.EVENT_SLOPE))
        self.rising = f.compare("ogt", slope, 0.0)
        f.store(f.load(f.offset("%w", DoubleSlot.EVENT_GUESS)), self.x)
        f.store(slope, self.slope)
        for place in (self.before, self.after, self.old_x):
            f.store(float("nan"), place)
        f.store(0.0, self.old_g)
        f.store_int(0, self.rounds)

    def try_next(self, given_up: Block) -> tuple[Value, Value]:
        """Return the time of a trial step to x, and the function there."""
        f = self.f
        x = f.load(self.x)
        inside = f.compare("ogt", x, self.start) & f.compare("ole", x, self.end)
        given_up.leave(unless=inside & f.compare_int("sle", f.bump(self.rounds), self.trials))
        status = f.call_int("trial_step", ["ptr %places", f"double {x.ref}", "i64 -1"])
        g = f.load(f.offset("%values", self.which))
        arrived = f.compare_int("eq", status, int(Status.DONE)) & f.compare("ord", g, 0.0)
        given_up.leave(unless=arrived)
        return x, g

    def note(self, x: Value, g: Value) -> tuple[Condition, Value]:
        """Take a trial step into the bracket; return whether it lies beyond the root, and how far from it."""
        f = self.f
        after = f.compare("ogt", f.select(self.rising, g, -g), 0.0)
        row = f.select_address(after, self.after, self.before)
        f.store(x, row)
        with f.count(self.count) as k:
            f.store(f.load(f.offset("%values", k)), f.offset(f.offset(row, 1), k))
        moved = x - f.load(self.old_x)
        secant = (g - f.load(self.old_g)) / moved
        # a secant between two values of rounding has no meaning: keep the last one
        sound = f.compare("ogt", f.select(self.rising, secant, -secant), 0.0)
        sound = sound & f.compare("olt", f.abs(secant), STEEPEST)
        sound = sound & f.compare("ogt", f.abs(moved), self.resolution * TELLING)
        slope = f.select(sound, secant, f.load(self.slope))
        f.store(slope, self.slope)
        f.store(x, self.old_x)
        f.store(g, self.old_g)
        return after, f.abs(g / slope)

    def is_short(self) -> Condition:
        """Return whether the bracket is as short as rounding allows."""
        f = self.f
        return f.compare("ole", f.load(self.after) - f.load(self.before), self.resolution)

    def aim(self, x: Value, after: Condition, beyond: Value) -> None:
        """Choose the next time: the end of a bracket that is as short as rounding allows."""
        f = self.f
        a, b = f.load(self.before), f.load(self.after)
        distance = beyond + self.half
        aim = f.select(after, x - distance, x + distance)
        # comparisons with an end that is not known yet are false
        out = f.compare("ole", aim, a) | f.compare("oge", aim, b)
        f.store(f.select(self.is_short(), b, f.select(out, (a + b) * 0.5, aim)), self.x)


def _arm(f: Function, count: int) -> None:
    """Watch the event functions from the side that their values are on; one at zero keeps the side it came from."""
    with f.count(count) as k:
        g, armed = f.load(f.offset("%values", k)), f.offset(f.offset("%w", DoubleSlot.SIZE), k)
        f.store(f.select(f.compare("oeq", g, 0.0), f.load(armed), g), armed)
    f.store_int(1, f.offset("%n", IntegerSlot.WATCH))


def _alone(f: Function, count: int, closings: bool) -> Condition:
    """Return whether just one event function has changed its sign since before the step."""
    changed = f.int_slot()
    f.store_int(0, changed)
    with f.count(count) as k:
        before = f.load(f.offset(f.offset("%w", DoubleSlot.SIZE), k))
        g: Value = f.load(f.offset("%values", k))
        above = f.compare("ogt", before, 0.0) & f.compare("ogt", g, 0.0)
        below = f.compare("olt", before, 0.0) & f.compare("olt", g, 0.0)
        stays = above | below
        if closings:
            stays = stays | (f.compare("oeq", before, 0.0) & f.compare("oeq", g, 0.0))
        f.store_int(f.load_int(changed) + f.select_int(stays, 0, 1), changed)
    return f.compare_int("eq", f.load_int(changed), 1)

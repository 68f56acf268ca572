"""The compiled functions that run to an event and locate it by trial steps.

A crossing of one function alone is located here. In all other cases these functions return a bracket with all values
at its ends, and ``first_roots`` finds from these values which functions cross, or where one of them cannot be
followed.

Each compiled function takes one address, that of a table of addresses (``PLACES``), because a call from Python takes
longer with every argument.
"""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.memory import UNARMED, DoubleSlot, IntegerSlot, Location, Status
from robodyn_cli.integrators.stepping.writer import ARGUMENTS, Tables
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Function, Int
from robodyn_cli.kernels.lower import INLINE_LIMIT, LANES, REGISTERS, Programs
from robodyn_cli.kernels.program import NUMBERS, Program

# the run's own arguments, room for a copy of its memory block and its bytes, for values of the event functions, and
# for what ``locate_event`` finds
PLACES = (*ARGUMENTS, "saved", "bytes", "values", "bracket")
COUNTERS = [IntegerSlot.ACCEPTED, IntegerSlot.REJECTED, IntegerSlot.EVALUATIONS, IntegerSlot.PROJECTIONS]
PATIENCE = 256  # steps; a trial step that takes more goes on in Python, where interrupts are handled
TRIALS = 10  # by secants: a simple root takes three, one that is shared four
MORE_TRIALS = 20  # where rounding hides a root
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
    f.store(0.0, f.offset("%w", DoubleSlot.CHECKED))
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
        from robodyn_cli.integrators.event_location.root_search import arm

        watch = f.load_int(f.offset("%n", IntegerSlot.WATCH))
        with f.when(f.compare_int("eq", watch, UNARMED)):
            f.call("switching", ["ptr %places"])
            arm(f, count)
    status = call_run(f)
    if count:
        with f.when(f.compare_int("eq", status, int(Status.EVENT))):
            copy_block(f, "%saved", "%w")
            located = f.call_int("locate_event", ["ptr %places"])
            f.store_int(located, f.offset("%n", IntegerSlot.LOCATED))
    f.ret(status)
    return f


def locate_event_function(events: Sequence[EventFunction], closings: bool) -> Function:
    """Return ``locate_event(places)`` for these functions, whose result is a ``Location``.

    Secants, each going a little beyond its root, until one lies beyond it by less than the resolution, or the last two
    lie on either side of it so near. If no other function has changed its sign on the way there, that is the event, and
    the run may go on from there. Where another has, it comes first, or at the same time: it is looked for then. Jumps
    at the same time are met one after another; other functions are left to Python.

    Where secants leave the bracket, or take too many trials, it is bisected. It begins at the start of the step, where
    the function may have changed its sign already, by rounding, and ends where dense output has it. Trial steps differ
    from that by rounding: a function that jumps is looked for a little beyond. One that has the same sign all the way,
    or is zero before, changes none.

    closings : whether latches close by themselves.
    bracket : two rows of 1 + count, a time and the values there, before and after the sign change; the time is NaN
    where no trial step was on that side.
    """
    from robodyn_cli.integrators.event_location.root_search import RootSearch

    f = Function("locate_event", ["ptr %places"], result="i64", flags="")
    load_places(f, "w", "n", "values", "bracket")
    samples = f.load_int(f.offset("%n", IntegerSlot.LAST_SAMPLE))
    search = RootSearch(f, events, MORE_TRIALS if closings else TRIALS)
    with f.block() as given_up:
        with f.block() as unchanged:
            unchanged.leave(search.leaves_zero())
            with f.loop() as rounds:
                x, g = search.try_next(given_up)
                with f.when(f.compare("oeq", g, 0.0) & ~search.is_strict()):
                    # zero belongs to neither side
                    given_up.leave(search.is_late() | f.compare("ole", x, search.start))
                    f.store(x + search.half, search.x)
                    rounds.again()
                after, beyond = search.note(x, g)
                with f.when(after & search.is_near(x, beyond)):
                    first = search.other_change()
                    with f.when(f.compare_int("slt", first, 0)):
                        search.finish(samples, Location.EVENT)
                    with f.when(search.is_at_end_of_bracket(x)):
                        given_up.leave(unless=search.are_jumps())
                        search.finish(samples, Location.EVENT)
                    search.look_for(first, x)
                    rounds.again()
                with f.when(search.is_behind(x, after)):
                    unchanged.leave(search.has_no_room())
                    rounds.again()
                search.aim(x, g, after, beyond)
        resolved = search.is_resolved()
        place = f.select(resolved, search.end, search.start)
        status = f.call_int("trial_step", ["ptr %places", f"double {place.ref}", "i64 -1"])
        given_up.leave(unless=f.compare_int("eq", status, int(Status.DONE)))
        given_up.leave(f.compare_int("sge", search.other_change(), 0))
        with f.when(~resolved):
            # no trial step can end beyond the root: it is here
            search.turn()
            search.finish(samples, Location.EVENT)
        search.finish(samples, Location.NOTHING)
    f.ret(int(Location.DOUBTFUL))
    return f

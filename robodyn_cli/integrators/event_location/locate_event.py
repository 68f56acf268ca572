"""The compiled functions that run up to an event, go to where dense output has it, and close in on it by trials.

They decide little: a crossing that no other function shares is located here; of all others there is a bracket, with
all values at its ends. Which functions cross there, and where one of them cannot be followed, is told from these
values (``first_roots``).
"""

from __future__ import annotations

from robodyn_cli.integrators.event_location.trial_step import PLACES, call_run, copy_block, load_places
from robodyn_cli.integrators.runtime.layout import FINE, UNARMED, DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.stepping.writer import ARGUMENTS
from robodyn_cli.kernels.ir import Condition, Function, Value

TELLING = 16.0  # resolutions between two trials from which on their secant counts
TRIALS = 10  # a simple root takes three, one that is shared four


def run_to_event_function(count: int) -> Function:
    """Return ``i64 run_to_event(places)``, which calls ``run``, and ``locate_event`` where that meets an event.

    Its result is the ``Status`` of ``run``. At an event what the run was before the step lies in ``%saved``. Functions
    that are to be watched from the start are armed first.
    """
    f = Function("run_to_event", ["ptr %places"], result="i64", flags="")
    load_places(f, *(PLACES if count else ARGUMENTS))
    watch = f.offset("%n", IntegerSlot.WATCH)
    if count:
        with f.when(f.compare_int("eq", f.load_int(watch), UNARMED)):
            f.raw("call void @switching(ptr %places)")
            _arm(f, count)
    status = call_run(f)
    if count:
        with f.when(f.compare_int("eq", status, int(Status.EVENT))):
            copy_block(f, "%saved", "%w")
            located = f.emit_int("call i64 @locate_event(ptr %places)")
            f.store_int(located, f.offset("%n", int(IntegerSlot.LOCATED)))
    f.ret(status)
    return f


def locate_event_function(count: int) -> Function:
    """Return ``i64 locate_event(places)`` for so many event functions; 1 if the state is at an event that stands alone.

    Secants, each going a little beyond its root, until one lies beyond it by less than the resolution. If no other
    function has changed its sign on the way there, that is the event, and the run may go on from there; else the
    secants go on until the last two lie on either side, with bisection where a secant leaves the bracket. They give
    up where a trial fails or meets values of zero, or beyond (T, T_END).

    bracket : two rows of 1 + count, a time and the values there, before and after the sign change; the time is NaN
    where no trial was on that side.
    """
    f = Function("locate_event", ["ptr %places"], result="i64", flags="")
    load_places(f, "w", "n", "values", "bracket")
    a_row, b_row = "%bracket", f.offset("%bracket", 1 + count)
    x_slot, slope_slot, old_x, old_g = f.slot(), f.slot(), f.slot(), f.slot()
    start, high = f.load(f.offset("%w", DoubleSlot.T)), f.load(f.offset("%w", DoubleSlot.EVENT_HIGH))
    end = f.min(high, f.load(f.offset("%w", DoubleSlot.T_END)))
    resolution = f.max(f.abs(start), f.abs(end)) * FINE
    which, samples = (
        f.load_int(f.offset("%n", place)) for place in (IntegerSlot.EVENT, IntegerSlot.LAST_SAMPLE)
    )
    slope = f.load(f.offset("%w", DoubleSlot.EVENT_SLOPE))
    rising = f.compare("ogt", slope, 0.0)
    f.store(f.load(f.offset("%w", DoubleSlot.EVENT_GUESS)), x_slot)
    f.store(slope, slope_slot)
    for place in (a_row, b_row, old_x):
        f.store(float("nan"), place)
    f.store(0.0, old_g)
    rounds = f.int_slot()
    f.store_int(0, rounds)
    step, go, arrived, zero, aside, close, onward, leave, located = (
        f.label(x) for x in ("step", "go", "arrived", "zero", "aside", "close", "onward", "leave", "located")
    )
    f.jump(step)

    f.place(step)
    x = f.load(x_slot)
    inside = f.compare("ogt", x, start) & f.compare("ole", x, end)
    f.branch(inside & f.compare_int("slt", f.bump(rounds), TRIALS + 1), go, leave)
    f.place(go)
    status = f.emit_int(f"call i64 @trial_step(ptr %places, double {x.ref}, i64 -1)")
    g = f.load(f.offset("%values", which))
    f.branch(f.compare_int("eq", status, int(Status.DONE)) & f.compare("ord", g, 0.0), arrived, leave)

    f.place(arrived)
    half = resolution * 0.5
    f.branch(f.compare("oeq", g, 0.0), zero, aside)
    f.place(zero)
    # zero belongs to neither side
    f.store(x + half, x_slot)
    f.jump(step)

    f.place(aside)
    after = f.compare("ogt", f.select(rising, g, -g), 0.0)
    row = f.name(f"select i1 {after.ref}, ptr {b_row}, ptr {a_row}")
    f.store(x, row)
    with f.count(count) as k:
        f.store(f.load(f.offset("%values", k)), f.offset(f.offset(row, 1), k))
    moved = x - f.load(old_x)
    secant = (g - f.load(old_g)) / moved
    # between two values of rounding a secant says nothing: the last one stays
    sound = f.compare("ogt", f.select(rising, secant, -secant), 0.0) & f.compare("olt", f.abs(secant), 1e300)
    sound = sound & f.compare("ogt", f.abs(moved), resolution * TELLING)
    slope = f.select(sound, secant, f.load(slope_slot))
    f.store(slope, slope_slot)
    f.store(x, old_x)
    f.store(g, old_g)
    beyond = f.abs(g / slope)
    f.branch(after & f.compare("ole", beyond, resolution), close, onward)
    f.place(close)
    f.branch(_alone(f, count), located, onward)

    f.place(onward)
    a, b = f.load(a_row), f.load(b_row)
    bracketed, apart = f.compare("ole", b - a, resolution), f.label("apart")
    f.branch(bracketed, leave, apart)
    f.place(apart)
    distance = beyond + half
    aim = f.select(after, x - distance, x + distance)
    # comparisons with an end that is not known yet are false
    out = f.compare("ole", aim, a) | f.compare("oge", aim, b)
    f.store(f.select(out, (a + b) * 0.5, aim), x_slot)
    f.jump(step)
    f.place(located)
    _arm(f, count)
    f.store_int(samples, f.offset("%n", IntegerSlot.LAST_SAMPLE))
    f.ret(1)
    f.place(leave)
    f.ret(0)
    return f


def _arm(f: Function, count: int) -> None:
    """Watch the event functions from the side that their values are on."""
    with f.count(count) as k:
        f.store(f.load(f.offset("%values", k)), f.offset(f.offset("%w", DoubleSlot.SIZE), k))
    f.store_int(1, f.offset("%n", IntegerSlot.WATCH))


def _alone(f: Function, count: int) -> Condition:
    """Return whether just one event function has changed its sign since before the step."""
    changed = f.int_slot()
    f.store_int(0, changed)
    with f.count(count) as k:
        before = f.load(f.offset(f.offset("%w", DoubleSlot.SIZE), k))
        g: Value = f.load(f.offset("%values", k))
        above = f.compare("ogt", before, 0.0) & f.compare("ogt", g, 0.0)
        below = f.compare("olt", before, 0.0) & f.compare("olt", g, 0.0)
        f.store_int(f.load_int(changed) + f.select_int(above | below, 0, 1), changed)
    return f.compare_int("eq", f.load_int(changed), 1)

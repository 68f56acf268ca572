"""The compiled function that goes to where dense output has an event and closes in on it, trial by trial.

It decides nothing: what it returns is a bracket of the function that dense output saw change sign, with all values at
its ends. Which functions cross, and where one of them cannot be followed, is told from these values (``first_roots``).
"""

from __future__ import annotations

from collections.abc import Callable

from robodyn_cli.integrators.layout import Real, Status, Whole
from robodyn_cli.integrators.trial import KINDS, TRIAL_ARGUMENTS, TYPES
from robodyn_cli.kernels.compiler import CompiledModule
from robodyn_cli.kernels.ir import Function

# ``time`` is the latest time to look at, ``resolution`` the width that is wanted, ``bracket`` what comes of it
NARROW_ARGUMENTS = (*TRIAL_ARGUMENTS, "resolution", "bracket")
NARROW_KINDS = {**KINDS, "resolution": "double"}
TRIALS = 10  # a simple root takes four


def narrow_function(count: int) -> Function:
    """Return ``void narrow(...)`` with ``NARROW_ARGUMENTS``, for so many event functions.

    Secants, each going half a resolution beyond its root, so that the last two lie on either side; bisection where a
    secant leaves the bracket. It gives up where a trial fails or meets a value of zero, or beyond (T, ``time``).

    bracket : two rows of 1 + count, a time and the values there, before and after the sign change; the time is NaN
    where no trial was on that side.
    """
    f = Function("narrow", [f"{NARROW_KINDS.get(a, 'ptr')} %{a}" for a in NARROW_ARGUMENTS], flags="")
    a_row, b_row = "%bracket", f.offset("%bracket", 1 + count)
    x_slot, slope_slot, old_x, old_g = f.slot(), f.slot(), f.slot(), f.slot()
    step, leave = f.label("step"), f.label("leave")
    start, end, half = f.load(f.offset("%w", Real.T)), f.argument("time"), f.argument("resolution") * 0.5
    which = f.load_int(f.offset("%n", Whole.EVENT))
    slope = f.load(f.offset("%w", Real.EVENT_SLOPE))
    rising = f.compare("ogt", slope, 0.0)
    nan = float("nan")
    f.store(f.load(f.offset("%w", Real.EVENT_GUESS)), x_slot)
    f.store(slope, slope_slot)
    for place in (a_row, b_row, old_x):
        f.store(nan, place)
    f.store(0.0, old_g)
    rounds = f.int_slot()
    f.store_int(0, rounds)
    f.jump(step)

    f.place(step)
    x = f.load(x_slot)
    inside = f.compare("ogt", x, start) & f.compare("ole", x, end)
    inside = inside & f.compare_int("slt", f.bump(rounds), TRIALS + 1)
    go, arrived, beyond = f.label("go"), f.label("arrived"), f.label("beyond")
    f.branch(inside, go, leave)
    f.place(go)
    passed = ", ".join(f"{KINDS.get(a, 'ptr')} {x.ref if a == 'time' else f'%{a}'}" for a in TRIAL_ARGUMENTS)
    status = f.emit_int(f"call i64 @trial({passed})")
    g = f.load(f.offset("%values", which))
    useful = f.compare_int("eq", status, int(Status.DONE)) & f.compare("one", g, 0.0)
    f.branch(useful, arrived, leave)

    f.place(arrived)
    after = f.compare("ogt", f.select(rising, g, -g), 0.0)
    row = f.name(f"select i1 {after.ref}, ptr {b_row}, ptr {a_row}")
    f.store(x, row)
    with f.count(count) as k:
        f.store(f.load(f.offset("%values", k)), f.offset(f.offset(row, 1), k))
    a, b = f.load(a_row), f.load(b_row)
    f.branch(f.compare("ole", b - a, f.argument("resolution")), leave, beyond)

    f.place(beyond)
    secant = (g - f.load(old_g)) / (x - f.load(old_x))
    # between two values of rounding a secant says nothing: its sign is that of the crossing, or the last one stays
    sound = f.compare("ogt", f.select(rising, secant, -secant), 0.0) & f.compare("olt", f.abs(secant), 1e300)
    slope = f.select(sound, secant, f.load(slope_slot))
    f.store(slope, slope_slot)
    f.store(x, old_x)
    f.store(g, old_g)
    distance = f.abs(g / slope) + half
    onward = f.select(after, x - distance, x + distance)
    # comparisons with an end that is not known yet are false
    out = f.compare("ole", onward, a) | f.compare("oge", onward, b)
    f.store(f.select(out, (a + b) * 0.5, onward), x_slot)
    f.jump(step)
    f.place(leave)
    f.ret()
    return f


def bind_narrow(compiled: CompiledModule) -> Callable[..., None]:
    """Return ``narrow`` of a module as a ctypes callable."""
    kinds = (TYPES[NARROW_KINDS.get(a, "ptr")] for a in NARROW_ARGUMENTS)
    return compiled.function("narrow", *kinds)

"""Events in a step: the search for sign changes of event functions along dense output, all lanes at once, and the way
to the state at the event.

The compiled loop looks at dense output only to see that some function changes sign in a step. Here the motion
is integrated to trial times by steps that end there, which have the full order of the method, so that an event
is as accurate as the states themselves.

The functions are evaluated at ``LANES`` points of a window. Where one changes sign between two points, these two bound
the next window; where one comes so near to zero that it may cross and come back, the points beside it do. The search
returns a bracket and a guess. The event is then located by steps that end there, which have the full order of the
method.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Status, resolution
from robodyn_cli.integrators.stepping.stepper import Stepper
from robodyn_cli.integrators.stepping.writer import Exit, Writer
from robodyn_cli.kernels.arrays import Array as Rows
from robodyn_cli.kernels.ir import Condition, Function, Int, Value
from robodyn_cli.kernels.lower import LANES
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

Numbers = Sequence[float] | Array
Values = Callable[[float], Numbers]

Point = tuple[float, float]  # a time, and the value of a function there

TRIALS = 200
RISES = 8  # halvings of a bracket in which a function is looked for that rises from zero and falls again
PATIENCE = 3  # secant steps that may fail to halve the bracket before it is bisected; fewer each time


def chatter(event: EventFunction, time: float) -> NumericalError:
    """Return the error of a function that changes its sign again and again while time stands still."""
    advice = (
        "; make its jump a steep slope, as in tanh(x/0.001) for sign(x)" if event.is_discontinuity else ""
    )
    return NumericalError(
        f"{event.name} keeps switching back and forth (chattering) at t = {time:.6g} s{advice}",
        time=time, status="chatter",
    )  # fmt: skip


@record
class Root:
    """A sign change of function ``index`` in (low, high]; ``sign`` is the one beyond it."""

    index: int
    low: float
    high: float
    sign: float


@record
class LocatedRoots:
    """The time to go to, and the functions that change sign there (none: go there and search on)."""

    time: float
    roots: tuple[Root, ...] = ()


def first_roots(
    events: Sequence[EventFunction],
    values: Values,
    armed: Numbers,
    seen: int,
    times: tuple[float, float, float],
) -> LocatedRoots:
    """Find the first sign change in a step, and all that coincide with it.

    Parameters
    ----------
    values : the event functions at a time; NaN where the motion cannot be followed that far.
    armed : values before the step; at zero, any value of the side that the function came from.
    seen : the function that dense output saw change sign.
    times : start of the step, and the bracket in which dense output saw the change.
    """
    start, low, high = times
    before = armed
    for a, b in ((start, low), (low, high)):
        if b <= a:
            continue
        after = values(b)
        lost = math.isnan(after[seen])
        roots = []
        for k, event in enumerate(events):
            if event.crosses(before[k], after[k]) or (lost and k == seen and before[k] != 0.0):
                bracket = (a, float(before[k])), (b, float(after[k]))
                root = _root(k, values, *bracket, event.is_discontinuity)
                if root is None:
                    # no motion beyond the last time that still has the old sign
                    return LocatedRoots(_last_followed(k, values, a, float(before[k]), b))
                roots.append(root)
        if roots:
            bound = min(r.high for r in roots) + 2.0 * resolution(start, high)
            together = tuple(r for r in roots if r.high <= bound)
            return LocatedRoots(max(r.high for r in together), together)
        before = [x if y == 0.0 else y for x, y in zip(before, after)]
    return LocatedRoots(high)


def _root(index: int, values: Values, low: Point, high: Point, strict: bool = False) -> Root | None:
    """Bracket the sign change between two times by regula falsi; None where there is none.

    low, high : time and value of the function.
    strict : zero counts as the old side. ``where`` takes zero for negative, so a run that stopped exactly at zero
    would go on with the old right-hand side.
    """
    (a, g_a), (b, g_b) = low, high
    sign, side, exact = math.copysign(1.0, g_a) if g_a else 0.0, 0, False
    g_a = float(values(a)[index])
    if g_a * sign < 0.0 or (g_a * sign == 0.0 and not (strict and sign)):
        risen = _risen(index, values, a, b, sign) if g_a == 0.0 and sign else None
        if risen is None:
            return Root(index, a, a, -sign)  # it was zero from the start
        a, g_a = risen
    fine = resolution(a, b)
    goal, patience, wasted = 0.5 * (b - a), PATIENCE, 0
    for _ in range(TRIALS):
        if b - a <= fine or exact:
            break
        if b - a <= goal:
            goal, wasted = 0.5 * (b - a), 0
        middle = 0.5 * (a + b)
        if wasted >= patience:
            patience, wasted = max(patience - 1, 1), 0
        elif math.isfinite(g_b) and g_b != g_a:
            wasted += 1
            secant = b - g_b * (b - a) / (g_b - g_a)
            # a point too close to an end would not shorten the bracket
            middle = min(max(secant, a + 0.5 * fine), b - 0.5 * fine)
        if not a < middle < b:
            break
        g = float(values(middle)[index])
        if g * sign > 0.0 or (strict and g == 0.0):
            g_b *= _weight(g, g_a) if side < 0 else 1.0
            a, g_a, side = middle, g, -1
        else:
            g_a *= _weight(g, g_b) if side > 0 else 1.0
            b, g_b, exact, side = middle, g, g == 0.0, 1
    if exact:
        a = max(a, b - fine)  # the root itself was met
    return Root(index, a, b, -sign) if math.isfinite(g_b) else None


def _risen(index: int, values: Values, a: float, b: float, sign: float) -> Point | None:
    """Return where a function that is zero at ``a`` has taken this sign before it loses it until ``b``; None nowhere.

    A joint that has just bounced leaves its stop from zero and may be back within the step.
    """
    for k in range(1, RISES + 1):
        place = a + 0.5**k * (b - a)
        value = float(values(place)[index])
        if value * sign > 0.0:
            return place, value
    return None


def _weight(new: float, old: float) -> float:
    """Return by how much the value at the end that stayed counts less (Anderson and Bjorck 1973)."""
    weight = 1.0 - new / old if old else 0.5
    return weight if weight > 0.0 else 0.5


def _last_followed(index: int, values: Values, a: float, g_a: float, b: float) -> float:
    """Return the latest time up to which the function keeps its sign and the motion can be followed."""
    while True:
        middle = 0.5 * (a + b)
        if b - a <= resolution(a, b) or not a < middle < b:
            return a
        if values(middle)[index] * g_a > 0.0:
            a = middle
        else:
            b = middle


DIPS = 4  # windows around points where a function nearly touches zero
TOUCHING = 1e-9  # of its neighbours, below which a value says nothing about what lies beyond zero
CLOSER = 2  # windows around an event after the first
ROW = LANES + 1  # values of a function: before the window, and in it


def find_event(w: Writer, stepper: Stepper[Any], t: Value, h: Value, run: Exit) -> None:
    """Look for the first sign change of any event function in a step, if events are watched at all.

    Where there is one, the run ends without committing the step, with a guess of the time and of the slope there.
    """
    f = w.f
    with f.when(f.compare_int("ne", f.load_int(w.integer_at(IntegerSlot.WATCH)), 0)):
        search = EventSearch(w, stepper, t, h)
        with f.loop() as windows:
            search.look()
            with f.when(search.has_crossing()):
                search.close_in()
                windows.again(f.compare_int("sle", f.bump(search.closer), CLOSER))
                run.leave(Status.EVENT)
            with f.when(search.may_dip()):
                search.look_around_dip()
                windows.again()
            run.leave(Status.EVENT, f.compare_int("ne", f.load_int(search.closer), 0))
            windows.leave()
        search.arm()


class EventSearch:
    """The search in one step; u in [-1, 0] is the place in it.

    base, span : the window. rows : ROW values of each function. ends : their values at the end of the step. first,
    which : the first lane behind a sign change, and its function. dip : a lane in which some function nearly touches
    zero; both are LANES where there is none. closer, dips : windows so far around an event and around dips.
    """

    def __init__(self, w: Writer, stepper: Stepper[Any], t: Value, h: Value) -> None:
        self.w, self.f, self.stepper, self.t, self.h = w, w.f, stepper, t, h
        f, self.count = w.f, len(w.system.events)
        self.base, self.span = f.slot(), f.slot()
        self.closer, self.dips = f.int_slot(), f.int_slot()
        self.first, self.which, self.dip = f.int_slot(), f.int_slot(), f.int_slot()
        self.rows, self.ends = f.slot(1, ROW * self.count), f.slot(1, self.count)
        self.armed = f.offset("%w", DoubleSlot.SIZE)
        f.store(-1.0, self.base)
        f.store(1.0, self.span)
        f.store_int(0, self.closer)
        f.store_int(0, self.dips)
        with f.count(self.count) as k:
            f.store(f.load(f.offset(self.armed, k)), self._row(k))

    def _row(self, k: Int) -> str:
        """Return the address of the values of function k."""
        return self.f.offset(self.rows, ROW * k)

    def look(self) -> None:
        """Evaluate the functions in the window, and note sign changes and dips."""
        f, w = self.f, self.w
        assert w.system.switching is not None
        fractions = f.constant([k / LANES for k in range(1, LANES + 1)])
        u = f.splat(f.load(self.base), LANES) + f.splat(f.load(self.span), LANES) * fractions
        x = w.array(2, 1, LANES)
        self.stepper.dense(u, self.h, x)
        values = w.evaluate(w.system.switching, self.t + self.h + self.h * u, x)["g"]
        for place in (self.first, self.dip):
            f.store_int(LANES, place)
        f.store_int(0, self.which)
        functions = Rows(f, f.slot(LANES, self.count), LANES)
        for k, g in enumerate(values):
            functions[k] = f.splat(g, LANES)
        first = 0
        for direction, alike in itertools.groupby(event.direction for event in w.system.events):
            start, first = first, first + len(list(alike))
            with f.count(first, start=start) as j:
                self._note(j, functions[j], direction)

    def _note(self, k: Int, g: Value, direction: int) -> None:
        """Take the values of function k in the window."""
        f, row = self.f, self._row(k)
        start = f.load(row)
        f.store(g, f.offset(row, 1))
        before = f.shuffle(g, f.splat(start, LANES), [LANES, *range(LANES - 1)])
        lane = _lowest(f, _crossing(f, before, g, direction).mask())
        sooner = f.compare_int("slt", lane, f.load_int(self.first))
        f.store_int(f.select_int(sooner, lane, f.load_int(self.first)), self.first)
        f.store_int(f.select_int(sooner, k, f.load_int(self.which)), self.which)
        # neither a fixed step nor half of it (for the error estimate) resolves what is much shorter
        if self.stepper.method.adaptive:
            lane = _lowest(f, _dips(f, start, before, g))
            deeper = f.compare_int("slt", lane, LANES)
            f.store_int(f.select_int(deeper, lane, f.load_int(self.dip)), self.dip)
        whole = f.compare_int("eq", f.load_int(self.dips), 0)
        end = f.offset(self.ends, k)
        f.store(f.select(whole, f.lane(g, LANES - 1), f.load(end)), end)

    def has_crossing(self) -> Condition:
        return self.f.compare_int("slt", self.f.load_int(self.first), LANES)

    def close_in(self) -> None:
        """Guess where the function that crosses first is zero, and make the lanes on either side the window."""
        f, w, h = self.f, self.w, self.h
        part = f.load(self.span) * (1.0 / LANES)
        start = f.load(self.base) + part * f.to_double(f.load_int(self.first))
        low = self.t + h * (start + 1.0)
        with f.when(f.compare_int("eq", f.load_int(self.closer), 0)):
            w.put(DoubleSlot.EVENT_LOW, low)
            w.put(DoubleSlot.EVENT_HIGH, low + h * part)
        which = f.load_int(self.which)
        f.store_int(which, w.integer_at(IntegerSlot.EVENT))
        beside = f.offset(self.rows, which * ROW + f.load_int(self.first))
        g_low, g_high = f.load(beside), f.load(f.offset(beside, 1))
        slope = (g_high - g_low) / (h * part)
        w.put(DoubleSlot.EVENT_SLOPE, slope)
        w.put(DoubleSlot.EVENT_GUESS, low - g_low / slope)
        self._narrow_to(f.load_int(self.first), start, part)

    def may_dip(self) -> Condition:
        """Return whether some function nearly touches zero, and windows are left to examine it."""
        f = self.f
        may = f.compare_int("slt", f.load_int(self.dip), LANES)
        may = may & f.compare_int("eq", f.load_int(self.closer), 0)
        return may & f.compare_int("sle", f.bump(self.dips), DIPS)

    def look_around_dip(self) -> None:
        """Make the neighbours of the lane that is nearest to zero the window."""
        f = self.f
        lane, part = f.load_int(self.dip), f.load(self.span) * (1.0 / LANES)
        start = f.load(self.base) + part * f.to_double(lane)
        self._narrow_to(lane, start, f.min(part * 2.0, -start))

    def _narrow_to(self, lane: Int, start: Value, length: Value) -> None:
        """Take a window that starts right before a lane."""
        f = self.f
        with f.count(self.count) as k:
            f.store(f.load(f.offset(self._row(k), lane)), self._row(k))
        f.store(start, self.base)
        f.store(length, self.span)

    def arm(self) -> None:
        """Watch the functions on from where they are at the end of the step."""
        f = self.f
        with f.count(self.count) as k:
            g, armed = f.load(f.offset(self.ends, k)), f.offset(self.armed, k)
            # a function that is zero at the end of the step keeps its sign: the next step shows whether it crosses
            f.store(f.select(f.compare("oeq", g, 0.0), f.load(armed), g), armed)


def _lowest(f: Function, mask: Int) -> Int:
    """Return the lowest lane of a mask, or LANES."""
    return f.lowest_bit(mask | (1 << LANES))


def _crossing(f: Function, before: Value, g: Value, direction: int) -> Condition:
    """Return the lanes behind a sign change that counts."""
    rising = f.compare("ole", before, 0.0) & f.compare("ogt", g, 0.0)
    falling = f.compare("oge", before, 0.0) & f.compare("olt", g, 0.0)
    if direction > 0:
        return rising
    return falling if direction < 0 else rising | falling


def _dips(f: Function, first: Value, before: Value, g: Value) -> Int:
    """Return the lanes, as bits, in which a function comes nearest to zero and may cross it and come back.

    A parabola through the lane and its neighbours (the last neighbour, and that of the ``first`` value, by
    extrapolation) goes beyond zero, or most of the way.
    """
    width = g.width

    def extrapolated(a: Value, b: Value, c: Value) -> Value:
        return (a - b) * 3.0 + c

    def near(before: Value, g: Value, after: Value) -> Condition:
        size = f.abs(g)
        nearest = f.compare("ogt", f.abs(before), size) & f.compare("ogt", f.abs(after), size)
        together = f.compare("ogt", before * g, 0.0) & f.compare("ogt", after * g, 0.0)
        slope, bend = after - before, (before + after) - (g + g)
        # g - slope^2 / (8 bend) < g / 4, where g and bend have the same sign
        deep = f.compare("ogt", slope * slope, f.abs(bend) * size * 6.0)
        # the window before has examined a value that is zero within rounding
        return nearest & together & deep & f.compare("ogt", size, f.abs(after) * TOUCHING)

    lane = [f.lane(g, k) for k in (0, 1, width - 3, width - 2, width - 1)]
    beyond = f.splat(extrapolated(lane[4], lane[3], lane[2]), width)
    after = f.shuffle(g, beyond, range(1, width + 1))
    at_start = near(extrapolated(first, lane[0], lane[1]), first, lane[0])
    return near(before, g, after).mask() | f.select_int(at_start, 1, 0)

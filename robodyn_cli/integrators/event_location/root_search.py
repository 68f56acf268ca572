"""Trial steps to the root of an event function, in compiled code, and how functions are watched on from there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.integrators.runtime.memory import FINE, DoubleSlot, IntegerSlot, Location, Status
from robodyn_cli.kernels.ir import Block, Condition, Function, Int, Value
from robodyn_cli.kernels.lower import LANES

TELLING = 16.0  # a secant is used if its two times differ by at least so many resolutions
MOST_TRIALS = 200
BEYOND = 7  # doublings of the resolution within which a function that jumps is looked for beyond its bracket
STEEPEST = 1e300


class RootSearch:
    """The search for the root of the event function that changed sign; x is the time of the next trial step.

    start, end : of the bracket that dense output gave. last : where the run has to end.
    """

    def __init__(self, f: Function, events: Sequence[EventFunction], trials: int) -> None:
        self.f, self.count, self.trials = f, len(events), trials
        self.before, self.after = "%bracket", f.offset("%bracket", 1 + self.count)
        self.x, self.slope, self.old_x, self.old_g, self.gap = (f.slot() for _ in range(5))
        self.rounds, self.which, self.further, self.others = (f.int_slot() for _ in range(4))
        self.start = f.load(f.offset("%w", DoubleSlot.T))
        self.last = f.load(f.offset("%w", DoubleSlot.T_END))
        self.end = f.min(f.load(f.offset("%w", DoubleSlot.EVENT_HIGH)), self.last)
        # a step has LANES brackets of this length, or more of a shorter one
        self.step_end = f.muladd(self.end - self.start, float(LANES), self.start)
        self.resolution = f.max(f.abs(self.start), f.abs(self.end)) * FINE
        self.half = self.resolution * 0.5
        self.directions = f.table("directions", [float(event.direction) for event in events])
        seen = f.load_int(f.offset("%n", IntegerSlot.EVENT))
        f.store_int(seen, self.which)
        self.jumps = [k for k, event in enumerate(events) if event.is_discontinuity] or [-1]
        guess = f.load(f.offset("%w", DoubleSlot.EVENT_GUESS))
        f.store(f.max(f.min(guess, self.end), self.start), self.x)
        f.store(f.load(f.offset("%w", DoubleSlot.EVENT_SLOPE)), self.slope)
        for place in (self.before, self.after, self.old_x):
            f.store(float("nan"), place)
        f.store(0.0, self.old_g)
        f.store(self.half, self.gap)
        for place in (self.rounds, self.further):
            f.store_int(0, place)

    def _side(self, g: Value) -> Value:
        """Return a value with the sign that it has on the new side turned to plus."""
        return self.f.select(self.f.compare("ogt", self.f.load(self.slope), 0.0), g, -g)

    def is_strict(self) -> Condition:
        """Return whether zero counts as the old side.

        ``where`` takes zero for negative: a run that stopped exactly at zero would go on with the old right-hand side.
        """
        return self._jumps(self.f.load_int(self.which))

    def _jumps(self, k: Int) -> Condition:
        """Return whether function k tells of a jump; functions of a kind come one after another."""
        f = self.f
        return f.compare_int("sge", k, self.jumps[0]) & f.compare_int("sle", k, self.jumps[-1])

    def leaves_zero(self) -> Condition:
        """Return whether the function leaves zero where the step starts, so that it has no sign to change."""
        f = self.f
        armed = f.load(f.offset(f.offset("%w", DoubleSlot.SIZE), f.load_int(self.which)))
        return f.compare("oeq", armed, 0.0) & f.compare("ole", f.load(self.x), self.start)

    def try_next(self, given_up: Block) -> tuple[Value, Value]:
        """Return the time of a trial step to x, and the function there."""
        f = self.f
        x = f.load(self.x)
        inside = f.compare("ole", x, self.last) & f.compare_int("sle", f.bump(self.rounds), MOST_TRIALS)
        given_up.leave(unless=inside)
        status = f.call_int("trial_step", ["ptr %places", f"double {x.ref}", "i64 -1"])
        g = f.load(f.offset("%values", f.load_int(self.which)))
        arrived = f.compare_int("eq", status, int(Status.DONE)) & f.compare("ord", g, 0.0)
        given_up.leave(unless=arrived)
        return x, g

    def note(self, x: Value, g: Value) -> tuple[Condition, Value]:
        """Take a trial step into the bracket; return whether it lies beyond the root, and how far from it."""
        f = self.f
        after = f.compare("ogt", self._side(g), 0.0)
        row = f.select_address(after, self.after, self.before)
        f.store(x, row)
        with f.count(self.count) as k:
            f.store(f.load(f.offset("%values", k)), f.offset(f.offset(row, 1), k))
        moved = x - f.load(self.old_x)
        secant = (g - f.load(self.old_g)) / moved
        # a secant between two values of rounding has no meaning: keep the last one
        sound = f.compare("ogt", self._side(secant), 0.0)
        sound = sound & f.compare("olt", f.abs(secant), STEEPEST)
        sound = sound & f.compare("ogt", f.abs(moved), self.resolution * TELLING)
        slope = f.select(sound, secant, f.load(self.slope))
        f.store(slope, self.slope)
        f.store(x, self.old_x)
        f.store(g, self.old_g)
        return after, f.abs(g / slope)

    def is_late(self) -> Condition:
        """Return whether there were as many trials as secants need."""
        return self.f.compare_int("sgt", self.f.load_int(self.rounds), self.trials)

    def is_short(self) -> Condition:
        """Return whether the bracket is as short as rounding allows."""
        f = self.f
        return f.compare("ole", f.load(self.after) - f.load(self.before), self.resolution)

    def is_at_end_of_bracket(self, x: Value) -> Condition:
        """Return whether no time before x, which lies beyond the root, is known to be another one."""
        return self.is_short() | self.f.compare("ole", x, self.start)

    def is_near(self, x: Value, beyond: Value) -> Condition:
        """Return whether the root is at x, which lies beyond it."""
        return self.f.compare("ole", beyond, self.resolution) | self.is_at_end_of_bracket(x)

    def other_change(self) -> Int:
        """Return the number of another event function that has changed its sign since before the step, or -1."""
        f = self.f
        other, which = f.int_slot(), f.load_int(self.which)
        f.store_int(-1, other)
        f.store_int(0, self.others)
        with f.count(self.count) as k:
            found = self.changes(k) & f.compare_int("ne", k, which)
            f.store_int(f.select_int(found, k, f.load_int(other)), other)
            kind = f.select_int(found & ~self._jumps(k), 1, 0)
            f.store_int(f.load_int(self.others) | kind, self.others)
        return f.load_int(other)

    def changes(self, k: Int) -> Condition:
        """Return whether the sign of function k has changed, in a way that counts, since before the step."""
        f = self.f
        before = f.load(f.offset(f.offset("%w", DoubleSlot.SIZE), k))
        g, direction = f.load(f.offset("%values", k)), f.load(f.offset(self.directions, k))
        rising = f.compare("olt", before, 0.0) & f.compare("ogt", g, 0.0) & f.compare("oge", direction, 0.0)
        falling = f.compare("ogt", before, 0.0) & f.compare("olt", g, 0.0) & f.compare("ole", direction, 0.0)
        return rising | falling

    def are_jumps(self) -> Condition:
        """Return whether this function and all others that change at the same time tell of jumps."""
        return self.is_strict() & self.f.compare_int("eq", self.f.load_int(self.others), 0)

    def is_behind(self, x: Value, after: Condition) -> Condition:
        """Return whether the function has not changed its sign up to the end of the bracket, where x is, or beyond."""
        f = self.f
        known = f.compare("ord", f.load(self.after), 0.0)
        return f.compare("oge", x, self.end) & ~(after | known)

    def has_no_room(self) -> Condition:
        """Aim a little further beyond the end of the bracket; return whether that leads nowhere."""
        f = self.f
        room = f.load(self.gap)
        x = self.end + room
        f.store(room * 2.0, self.gap)
        f.store(x, self.x)
        left = f.compare_int("sle", f.bump(self.further), BEYOND)
        left = left | f.compare("ole", self.end + room * 0.5, self.step_end)
        return ~(left & f.compare("ole", x, self.last) & self.is_strict())

    def is_resolved(self) -> Condition:
        """Return whether the bracket is longer than rounding allows."""
        return self.f.compare("ogt", self.end - self.start, self.resolution)

    def aim(self, x: Value, g: Value, after: Condition, beyond: Value) -> None:
        """Choose the next time: the end of a bracket that is as short as rounding allows."""
        f = self.f
        a, b = f.load(self.before), f.load(self.after)
        early, late = f.compare("uno", a, 0.0), f.compare("uno", b, 0.0)  # sides that no trial step was on
        # a slow function is zero, by rounding, for many times the resolution
        gap, zero = f.load(self.gap), f.compare("oeq", g, 0.0)
        f.store(f.select(zero, gap * 2.0, gap), self.gap)
        distance = f.select(zero, gap, beyond + self.half)
        aim = f.select(after, x - distance, x + distance)
        out = f.compare("ole", aim, f.select(early, self.start, a))
        out = out | f.compare("oge", aim, f.select(late, self.end, b)) | self.is_late()
        far = f.select(early, self.start, f.select(late, self.end, (a + b) * 0.5))
        f.store(f.select(self.is_short(), b, f.select(out, far, aim)), self.x)

    def look_for(self, other: Int, x: Value) -> None:
        """Look for the root of another function, which lies before x."""
        f = self.f
        g = f.load(f.offset("%values", other))
        armed = f.load(f.offset(f.offset("%w", DoubleSlot.SIZE), other))
        f.store_int(other, self.which)
        slope = (g - armed) / (x - self.start)
        f.store(slope, self.slope)
        f.store(float("nan"), self.old_x)
        # where it has changed before as well, nothing is known to lie before the root
        known = f.compare("ole", self._side(f.load(f.offset(f.offset(self.before, 1), other))), 0.0)
        f.store(f.select(known, f.load(self.before), float("nan")), self.before)
        early = f.compare("uno", f.load(self.before), 0.0)
        aim, low = x - (g / slope + self.half), f.select(early, self.start, f.load(self.before))
        middle = f.select(early, self.start, (low + x) * 0.5)
        f.store(f.select(f.compare("ogt", aim, low), aim, middle), self.x)

    def turn(self) -> None:
        """Put the function on its new side."""
        f = self.f
        tiny = f.select(f.compare("ogt", f.load(self.slope), 0.0), f.constant(1e-300), -1e-300)
        f.store(tiny, f.offset("%values", f.load_int(self.which)))

    def finish(self, samples: Int, location: Location) -> None:
        """End the search at the present state."""
        f = self.f
        which = f.load_int(self.which)
        arm(f, self.count, lambda k: self.changes(k) & f.compare_int("ne", k, which))
        f.store_int(samples, f.offset("%n", IntegerSlot.LAST_SAMPLE))
        f.store_int(which, f.offset("%n", IntegerSlot.EVENT))
        f.ret(int(location))


def arm(f: Function, count: int, waits: Callable[[Int], Condition] | None = None) -> None:
    """Watch the event functions from the side that their values are on; one at zero keeps the side it came from, and
    one that ``waits``, which is found in the next step."""
    with f.count(count) as k:
        g, armed = f.load(f.offset("%values", k)), f.offset(f.offset("%w", DoubleSlot.SIZE), k)
        stays = f.compare("oeq", g, 0.0)
        stays = stays if waits is None else stays | waits(k)
        f.store(f.select(stays, f.load(armed), g), armed)
    f.store_int(1, f.offset("%n", IntegerSlot.WATCH))

"""Run the compiled stepping loop: blocks of samples, breakpoints, events, counters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.events import GO_ON, Event, EventKind, Jump, Jumped, Outcome, Owner, Repartition
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.engine import Engine, doubles_at_start, first_step, integers_at_start
from robodyn_cli.integrators.runtime.memory import (
    UNARMED,
    DoubleSlot,
    IntegerSlot,
    Location,
    Parameters,
    Status,
    resolution,
)
from robodyn_cli.integrators.runtime.options import Grid, Options, stretches
from robodyn_cli.integrators.runtime.sample_blocks import SampleBlocks
from robodyn_cli.integrators.runtime.stopped import Approach, Crowd, Stopped
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.motion import Counters

if TYPE_CHECKING:
    from robodyn_cli.integrators.event_location.events import Root

DEFAULTS = Options()
# the compiled loop runs for about this long [s] at a time; the number of steps adapts itself
SLICE_TIME = 0.02
FIRST_SLICE = 256
TRIAL_STEPS = 200  # that a trial may take; more are needed only towards a pose that no trial should cross


class Integrator:
    """One system and one method, compiled; holds the state of a run, which may stop and resume.

    Parameters
    ----------
    system : what to integrate.
    method : name in the registry.
    parameters : values of the symbolic parameters p; by default those of the system.
    quick : whether the first steps of a run take code that is made quickly, see ``Engine``.

    ``tick`` is told the time every few milliseconds, ``met``, where set, takes the events, and ``noted`` the time [s]
    after every ``every`` attempts at steps of a run. ``before`` : steps that
    others have taken of the same run; they count for ``options.max_steps`` and ``pause``, after which a run comes back,
    between events.
    """

    def __init__(
        self, system: System, method: str = "gauss", parameters: Any = (), quick: bool = False
    ) -> None:
        self.system = system
        self.method = methods[method]
        self.parameters = Parameters(system, parameters if len(parameters) else system.parameters)
        self.p = self.parameters.values
        self.engine = Engine(system, method, self.p, quick=quick)
        self.memory = self.engine.memory
        self.w, self.n, self.y = self.memory.w, self.memory.n, self.memory.y
        self.options, self._begun = DEFAULTS, math.nan
        self._blank = np.zeros(0)
        self._slice = FIRST_SLICE
        self.tick: Callable[[float], None] | None = None
        self.met: list[Jumped] | None = None
        self.noted: list[float] | None = None
        self.every = 1
        self.reset(0.0, np.zeros(system.size))

    # -- state ----------------------------------------------------------------------------------------
    def reset(self, time: float, state: Any, options: Options = DEFAULTS) -> None:
        """Start a run from ``state`` = (q, v, z) at ``time``."""
        state = np.asarray(state, dtype=float)
        if state.shape != self.y.shape:
            raise ValueError(f"the state has {self.system.size} components, got {state.shape}")
        if options is not self.options or time != self._begun:
            self._blank, self._begun = self._at_start(time, options), time
        self.options, self._step = options, options.step
        self.engine.draw(options.draw)
        self.memory.block[:] = self._blank
        self.y[:] = state
        self.events_seen = 0
        self._toward = math.nan
        self._approach = Approach(self._step, self.options.first < 1.0)
        self.before = 0
        self.pause: int | None = None
        if self.system.events:
            self._crowd = Crowd()
        if self.engine.updates is not None:
            self.engine.updates.begin(self.memory, time)
        if self.system.partition is not None:
            self.parameters.start(time, self.y)

    def _at_start(self, time: float, options: Options) -> Array:
        """Return the memory of a run as it begins, but for its state: one run after another begins alike."""
        self.memory.clear()
        for slot, value in doubles_at_start(time, options).items():
            self.w[slot] = value
        for slot, count in integers_at_start(self.system.nv).items():
            self.n[slot] = count
        return self.memory.block.copy()

    @property
    def time(self) -> float:
        return self.w[DoubleSlot.T]

    @property
    def state(self) -> Array:
        return self.y.copy()

    @property
    def counters(self) -> Counters:
        n = self.n
        return Counters(
            n[IntegerSlot.ACCEPTED], n[IntegerSlot.REJECTED], n[IntegerSlot.EVALUATIONS],
            n[IntegerSlot.PROJECTIONS], self.events_seen,
        )  # fmt: skip

    def set_state(self, state: Any, signs: Mapping[int, float] | None = None, step: float = math.inf) -> None:
        """Replace the state in the middle of a run (a jump); the time stays.

        signs : the side from which event functions start, by index. step : the next step is at most so long.
        """
        self.y[:] = state
        self.n[IntegerSlot.RATE_KNOWN] = 0
        if self.system.events:
            self.engine.restart(step)
        if signs:
            self._watch(self.event_values(), signs)

    # -- running --------------------------------------------------------------------------------------
    def _call(self, end: float, pause: int | None = None, noted: list[float] | None = None) -> Status:
        w, n = self.w, self.n
        limit = min(self.options.max_steps, pause or self.options.max_steps) - self.before
        w[DoubleSlot.T_END] = end
        if self.engine.updates is not None:
            self.engine.expect(self.engine.updates.within(end - w[DoubleSlot.T]))
        if self._step is None and not w[DoubleSlot.H] > 0.0:
            w[DoubleSlot.H] = min(first_step(end - w[DoubleSlot.T], self.options), self.options.max_step)
            if not self.method.adaptive:
                # no control lets a fixed step grow again, so an event must not shorten it for good
                self._step = w[DoubleSlot.H]
        if self._step is not None:
            w[DoubleSlot.H] = w[DoubleSlot.H_MAX] = self.options.part_of_way(self._step, end - self.time)
        if not w[DoubleSlot.H_OLD] > 0.0:
            w[DoubleSlot.H_OLD] = w[DoubleSlot.H]
        while True:
            # return to Python every few milliseconds, to handle interrupts and report progress
            taken = n[IntegerSlot.ACCEPTED] + n[IntegerSlot.REJECTED]
            more = self._slice if noted is None else self.every
            n[IntegerSlot.MAX_STEPS] = most = self.engine.patience(taken, min(limit, taken + more))
            start = perf_counter()
            status = self.engine.run_to_event()
            if status is not Status.MAX_STEPS or most >= limit:
                return status
            if noted is not None:
                noted.append(self.time)
            elif (spent := perf_counter() - start) < SLICE_TIME:
                self._slice *= 2
            elif spent > 4 * SLICE_TIME:
                self._slice = max(1, self._slice // 2)
            if self.tick is not None:
                self.tick(self.time)

    def event_values(self) -> list[float]:
        """Return the event functions at the current state."""
        return self.engine.look() if self.system.events else []

    def _watch(self, values: Sequence[float], signs: Mapping[int, float]) -> None:
        """Arm the event functions, whose values are these; those that just fired (``signs``) have their new sign."""
        w = self.w
        for k, (g, event) in enumerate(zip(values, self.system.events)):
            place = DoubleSlot.SIZE + k
            if k in signs:
                w[place] = signs[k] * max(abs(g), 1e-300)
            elif g != 0.0 and not event.crosses(w[place], g):
                # a function at zero keeps the side it came from; one that has crossed is found in the next step
                w[place] = g
        self.n[IntegerSlot.WATCH] = 1

    def advance(self, end: float) -> None:
        """Integrate to ``end`` without samples or events.

        Raises
        ------
        NumericalError : the step size underflows, the state stops being finite, or there are too many steps.
        """
        if self.system.partition is not None:  # re-partitions are events
            self.run(end, Grid(end, 0.0, 0), lambda t, x: None, watch=False)
            return
        self.n[IntegerSlot.WATCH], self.n[IntegerSlot.LAST_SAMPLE] = 0, -1
        for stop in self._stops(end):
            self._check(self._call(stop))

    def _stops(self, end: float) -> Iterator[float]:
        """Yield when a step has to end; formulas of time are kept to the stretch before each."""
        for stop, after, before in stretches(self.system.breakpoints, self.time, end):
            self.w[DoubleSlot.T_AFTER], self.w[DoubleSlot.T_BEFORE] = after, before
            if stop != self._toward:  # a run that was paused on the way keeps its step
                self.w[DoubleSlot.H] = self.options.part_of_way(self.w[DoubleSlot.H], stop - self.time)
            self._toward = stop
            yield stop

    def run(
        self,
        end: float,
        grid: Grid,
        emit: Callable[[Array, Array], None],
        block: int = 65536,
        watch: bool = True,
    ) -> Outcome:
        """Integrate to ``end``, handing on samples in blocks; events go to the owners of their functions.

        Parameters
        ----------
        grid : sample times; those from the current time on are written.
        emit : takes times (m,) and states (m, nx), in order, each sample once.
        watch : whether owners hear of events; that of a partition does in any case, and then of its own alone.

        Returns
        -------
        GO_ON at the end, or what an owner answered that ended the run before: STOP, or a Leap to be made.
        """
        s, n = self.system, self.n
        samples = SampleBlocks(self.engine, grid, emit, block, self.time)
        heard = None if watch else EventKind.REPARTITION  # which must happen in any case
        watch = (watch or s.partition is not None) and bool(s.events)
        n[IntegerSlot.WATCH] = (n[IntegerSlot.WATCH] or UNARMED) if watch else 0
        try:
            for stop in self._stops(end):
                while True:
                    try:
                        status = self._call(stop, self.pause, self.noted)
                    finally:  # where ``tick`` raises, the samples so far are kept
                        samples.flush()
                    if status is Status.DONE:
                        break
                    if status is Status.EVENT:
                        self._crowd.refuse(s.events[n[IntegerSlot.EVENT]], self.memory.saved_w[DoubleSlot.T])
                        events = self._locate(stop, samples)
                        samples.hand_on()
                        outcome = self._handle(events, heard)
                        if outcome is not GO_ON:
                            return outcome
                    else:
                        self._check(status)
        finally:
            samples.hand_on()
        return self._handle(self._at_end(), heard) if watch else GO_ON

    def _handle(self, events: Sequence[Event], heard: EventKind | None) -> Outcome:
        """Hand simultaneous events to their owners, each with the state that the one before has left.

        heard : the only kind that is handed on; None for all. Returns what ends the run, or GO_ON.
        """
        end: Outcome = GO_ON
        for k, event in enumerate(events):
            if heard not in (None, event.function.kind):
                continue
            # a re-partition does not change the motion
            self.events_seen += event.function.kind is not EventKind.REPARTITION
            owned = event.function.owner is not None
            noted = self.met is not None and owned and event.function.kind is not EventKind.REPARTITION
            before = (self.state, self.p.copy()) if noted else None
            outcome = (dataclasses.replace(event, state=self.state) if k else event).outcome()
            if outcome.ends:
                end = outcome
            self.apply(outcome, event.function.owner)
            if before is not None and self.met is not None:
                hidden = event.function.is_discontinuity
                self.met.append(Jumped(self.time, *before, self.state, self.p.copy(), hidden))
        return end

    def apply(self, outcome: Outcome, owner: Owner | None) -> None:
        """Go on as an owner of events says: with other parameters, or from another state."""
        if isinstance(outcome, Repartition):
            self.parameters.repartition(self.time, self.y)
            self._watch(self.event_values(), {})
        elif isinstance(outcome, Jump):
            if outcome.parameters is not None:
                self.p[: len(outcome.parameters)] = outcome.parameters
            places = [k for k, e in enumerate(self.system.events) if e.owner is owner]
            sides = {places[k]: side for k, side in outcome.sides.items()}
            self.set_state(outcome.state, sides, outcome.step)

    def _at_end(self) -> tuple[Event, ...]:
        """Return the events whose functions have come to zero exactly at the end of the run."""
        events = []
        for k, (g, event) in enumerate(zip(self.event_values(), self.system.events)):
            sign = -float(np.sign(self.w[DoubleSlot.SIZE + k]))
            if g == 0.0 and event.crosses(-sign, sign):
                self.w[DoubleSlot.SIZE + k] = sign * 1e-300
                events.append(self._event(k, 0.0))
        return tuple(events)

    def _locate(self, stop: float, samples: SampleBlocks) -> tuple[Event, ...]:
        """Find the first event in the step ahead, and others at the same time, and go there."""
        n, start = self.n, self.memory.saved_w[DoubleSlot.T]
        last, flush = samples.last, samples.flush
        seen, found = n[IntegerSlot.EVENT], n[IntegerSlot.LOCATED]
        time, roots = self._sort_out(seen, stop, flush) if found == Location.DOUBTFUL else (self.time, ())
        if (
            before := self._approach.stopover(start, time, self.system.events[seen].is_discontinuity)
        ) is not None:
            self._go(before, last, flush)
            self._watch(self.engine.seen(), {})
            return ()
        if found == Location.EVENT:
            fine = resolution(start, time)
            if samples.lies_at(time):
                sign = math.copysign(1.0, self.w[DoubleSlot.SIZE + seen])
                self._go(time, last, flush)
                self._watch(self.engine.seen(), {seen: sign})
            return (self._event(seen, fine),)
        # take the step for good, samples included
        self._go(time, last, flush)
        self._watch(self.engine.seen(), {r.index: r.sign for r in roots})
        return tuple(self._event(r.index, r.high - r.low) for r in roots)

    def _event(self, index: int, error: float) -> Event:
        close = partial(self.engine.close_latch, index)
        return Event(self.system.events[index], index, self.time, self.state, error, self.p.copy(), close)

    def _sort_out(self, seen: int, stop: float, flush: Callable[[], None]) -> tuple[float, tuple[Root, ...]]:
        """Return where to go, and the functions that change sign there, when more than one may do so."""
        from robodyn_cli.integrators.event_location.events import LocatedRoots, Root, first_roots

        engine, events = self.engine, self.system.events
        armed, lost = self.memory.armed.tolist(), [math.nan] * len(events)
        start = self.memory.saved_w[DoubleSlot.T]
        high = min(self.w[DoubleSlot.EVENT_HIGH], stop)
        low = min(max(self.w[DoubleSlot.EVENT_LOW], start), high)
        known: dict[float, Sequence[float]] = {}

        def values(time: float) -> Sequence[float]:
            if time not in known:
                known[time] = trial_step(time)
            return known[time]

        def trial_step(time: float) -> Sequence[float]:
            status = engine.trial_step(time, -1)
            if status is not Status.MAX_STEPS:
                return engine.seen() if status is Status.DONE else lost
            try:
                self._check(self._call(time, self.before + self.counters.attempts + TRIAL_STEPS))
            except NumericalError:
                return lost
            return self.event_values()

        for k, (time, *there) in enumerate(engine.bracket.tolist()):
            if time == time:
                known[time] = there
                low, high = (time, high) if k == 0 else (min(low, time), time)
        located = first_roots(events, values, armed, seen, (start, low, high))
        if not located.roots and high - start <= resolution(start, high):
            # the step is shorter than the clock resolves, so that no trial step can end beyond the root: it is here
            return start, (
                Root(seen, start, start, math.copysign(1.0, self.memory.saved_w[DoubleSlot.EVENT_SLOPE])),
            )
        if not located.roots and located.time <= start:
            # no motion leads there: take the step, so that its failure is reported
            self._go(high, -1, flush)
            located = LocatedRoots(high)
        return located.time, located.roots

    def _go(self, time: float, last: int, flush: Callable[[], None]) -> None:
        """Go to ``time`` from the saved state."""
        status = self.engine.trial_step(time, last)
        arrived = status is Status.DONE
        while status in (Status.FULL, Status.MAX_STEPS):
            flush()
            status = self._call(time)
            if status is Status.MAX_STEPS:
                break
        flush()
        self._check(status)
        if not arrived:
            self.engine.look()

    def _check(self, status: Status) -> None:
        """Raise a NumericalError (see ``stopped``) where a run cannot go on."""
        if status in (Status.DONE, Status.FULL):
            return
        if self.engine.updates is not None:
            self.engine.updates.raise_failure()
        stopped = Stopped(status, self.time, self.w[DoubleSlot.H], self.y, self.options)
        raise stopped.error(self.system, self.p)

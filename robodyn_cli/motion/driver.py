"""The one driver: it takes a system from a state to an end.

    start -> watchers look at the state -> integrate; at an event its owner says how to go on:
        go on | stop | another state (impact, stick-slip) | another choice of parameters | a later time (a pose passed)

and where the motion turns out to be stiff the run goes on with another method.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.events import Jumped, Leap
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.integrators.runtime.stopped import CROWDED
from robodyn_cli.motion.motion import Beginning, Motion, Watcher
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.motion import Counters

Emit = Callable[[Array, Array], None]
STANDSTILL = 1_000  # steps without progress beside a discontinuity that end a run
BLOCK = 65536  # samples that are handed on at a time


class Supervisor(Protocol):
    """Decides on changes of the method on the way.

    steps : number of steps, rejected ones included, after which the run asks it next; None: never.
    """

    @property
    def steps(self) -> int | None: ...

    def reconsider(self, driver: Driver) -> MethodChange | None:
        """Return the change to make, None to go on as it is."""


@record
class MethodChange:
    """A change of method on the way.

    time [s] and steps, attempted ones, after which. to : the new method. decay_time : of the fastest decay there [s].
    """

    time: float
    steps: int
    to: str
    decay_time: float | None


class Repeat:
    """Makes the changes of an earlier run over again, after the same steps."""

    def __init__(self, changes: Sequence[MethodChange]) -> None:
        self.changes = deque(changes)

    @property
    def steps(self) -> int | None:
        return self.changes[0].steps if self.changes else None

    def reconsider(self, driver: Driver) -> MethodChange | None:
        return self.changes.popleft()


class Driver:
    """One integration of a system.

    Parameters
    ----------
    watchers : owners of events that this run is to hand them to; they see the start and the samples.
    supervisor : may change the method. parameters : values of p; by default those of the system.

    tick, where set, is told the time every few milliseconds of a run. end : of the present one [s]. changes : of the
    method on the way. met, where it is a list, takes what the motion has met where it may have jumped, and noted the
    times [s] after every so many steps.
    """

    def __init__(
        self,
        system: System,
        method: str,
        options: Options,
        watchers: Sequence[Watcher] = (),
        supervisor: Supervisor | None = None,
        parameters: Any = (),
    ) -> None:
        self.system, self.options = system, options
        self.watchers = tuple(watchers)
        for watcher in self.watchers:
            watcher.meet(self.watchers)
        self.supervisor = supervisor
        self.given = parameters
        self.tick: Callable[[float], None] | None = None
        self.end = 0.0
        self.met: list[Jumped] | None = None
        self.noted: list[float] | None = None
        self.every = 1
        self._paused = (0.0, 0)  # time and steps when the supervisor was last asked
        self.first = method
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._done, self._rounded = Counters(), 0.0
        self.changes: list[MethodChange] = []
        self._take_up(self.first)

    @staticmethod
    def of(motion: Motion, supervisor: Supervisor | None = None) -> Driver:
        """Return the driver of a motion."""
        return Driver(motion.system, motion.choice.method, motion.options, motion.watchers, supervisor)

    def _take_up(self, method: str) -> None:
        self.method = method
        self.integrator = Integrator(self.system, method, self.given, quick=True)

    # -- where the run is -----------------------------------------------------------------------------
    @property
    def time(self) -> float:
        return self.integrator.time

    @property
    def state(self) -> Array:
        return self.integrator.state

    @property
    def parameters(self) -> Array:
        """The parameters p at present."""
        return self.integrator.p.copy()

    @property
    def log(self) -> list[dict[str, Any]]:
        """What has happened on the way, as the watchers tell it."""
        return [event for watcher in self.watchers for event in watcher.log]

    @property
    def instants(self) -> list[float]:
        """Times of these events [s]."""
        return [float(event["time"]) for event in self.log]

    @property
    def repartitions(self) -> int:
        """How often a partition has chosen its parameters anew."""
        return self.integrator.parameters.repartitions

    @property
    def counters(self) -> Counters:
        """Counters over the whole run."""
        return self._done + self.integrator.counters

    @property
    def rounded(self) -> float:
        """What rounding of the equations has made of rates over the whole run, at most [rad/s, m/s]."""
        return self._rounded + self.integrator.w[DoubleSlot.ROUNDED]

    @property
    def attempts(self) -> int:
        """Steps over the whole run, rejected ones too."""
        return self.counters.attempts

    # -- running --------------------------------------------------------------------------------------
    def start(self, time: float, state: Array, options: Options | None = None) -> None:
        """Begin a run; watchers may change the state (an impact at the start)."""
        self._go_on_from(time, self._begin(time, state, options))

    def _begin(self, time: float, state: Array, options: Options | None = None) -> Array:
        """Forget an earlier run; return the state from which the watchers let this one begin."""
        self.options = self.options if options is None else options
        if self.changes:
            self._begin_anew()
        self._done, self._rounded = Counters(), 0.0
        self._paused = (time, 0)
        for watcher in self.watchers:
            state = watcher.begin(time, state, self.options)
        return state

    def go_on(self, beginning: Beginning, done: Counters, changes: Sequence[MethodChange]) -> None:
        """Take up a run that was broken off, where it had done so much and changed its method so."""
        self._begin(beginning.time, beginning.state)
        self._done, self.changes = done, list(changes)
        self._paused = (beginning.time, done.attempts)
        if changes:
            self._take_up(changes[-1].to)
        self._go_on_from(beginning.time, beginning.state)

    def _go_on_from(self, time: float, state: Array) -> None:
        self.integrator.tick, self.integrator.met = self.tick, self.met
        self.integrator.noted, self.integrator.every = self.noted, self.every
        self.integrator.reset(time, state, self.options)
        self.integrator.before = self._done.attempts
        self._set_pause()
        for watcher in self.watchers:
            self.integrator.apply(watcher.arm(state), watcher)

    def _set_pause(self) -> None:
        """Tell the integrator after how many steps the supervisor asks."""
        self.integrator.pause = None if self.supervisor is None else self.supervisor.steps

    def advance(self, end: float) -> None:
        """Go to ``end`` without samples or events.

        Raises
        ------
        NumericalError : see ``run``.
        """
        self.integrator.tick = self.tick
        self.integrator.advance(end)

    def run(self, end: float, grid: Grid, emit: Emit, block: int = BLOCK, watch: bool = True) -> None:
        """Integrate to ``end``, or to where an owner of events stops the run.

        Parameters
        ----------
        grid : sample times. emit : takes times (T,) and states (T, nx) in order, at most ``block`` at a time.
        watch : whether to look for events.

        Raises
        ------
        NumericalError : the step size underflows, the state stops being finite, or there are too many steps.
        """
        self.integrator.tick, self.end = self.tick, end
        last = -math.inf

        def seen(t: Array, x: Array) -> None:
            nonlocal last
            if t[0] <= last:  # a run that goes on begins with the sample that it has come to
                t, x = t[1:], x[1:]
            if not len(t):
                return
            last = float(t[-1])
            for watcher in self.watchers:
                watcher.see(t, x)
            emit(t, x)

        while True:
            stop = min([end, *(time for watcher in self.watchers for time in watcher.stops())])
            try:
                outcome = self.integrator.run(stop, grid, seen, block, watch)
            except NumericalError as error:
                if not self._goes_on(error):
                    raise
                continue
            if isinstance(outcome, Leap):
                self._leap(outcome, stop, grid, seen)
            elif (
                outcome.ends or stop >= end or self._answer_stop(stop)
            ):  # the time may be that but for rounding
                return

    def _answer_stop(self, stop: float) -> bool:
        """Ask the watchers that have one there how the run goes on; tell whether it ends."""
        before, ends = (self.state, self.parameters), False
        for watcher in self.watchers:
            if stop in watcher.stops():
                outcome = watcher.at_stop(stop, self.state)
                self.integrator.apply(outcome, watcher)
                ends |= outcome.ends
        self._meet(stop, *before)
        return ends

    def _meet(self, time: float, state: Array, parameters: Array) -> None:
        """Note what was before the present state at a time, where that is asked for."""
        if self.met is not None:
            self.met.append(Jumped(time, state, parameters, self.state, self.parameters))

    def samples(self, end: float, grid: Grid, watch: bool = True) -> Array:
        """Return the states (T, nx) at the sample times up to where the run came."""
        rows: list[Array] = []
        self.run(end, grid, lambda t, x: rows.append(x), watch=watch)
        return np.concatenate(rows)

    def _leap(self, leap: Leap, end: float, grid: Grid, emit: Emit) -> None:
        """Go on behind a stretch that an owner has integrated itself, with its samples."""
        start, behind = self.time, min(leap.time, end)
        self._meet(start, self.state, self.parameters)
        first, last = grid.first_at(start), min(grid.first_at(behind), grid.count)
        first += grid.begins_by(first, start)
        if last > first:
            times = grid.times(first, last)
            emit(times, leap.states(times))
        state = leap.state if leap.time < end else leap.states(np.array([end]))[0]
        self._done, self._rounded = self.counters, self.rounded
        self._go_on_from(behind, state)
        self._meet(behind, state, self.parameters)

    def _refuse_standstill(self) -> None:
        """Raise where many steps about the place where a right-hand side jumps have come no further.

        Raises
        ------
        NumericalError : with the function that jumps.
        """
        (time, attempts), self._paused = self._paused, (self.time, self.attempts)
        events = self.system.events
        if not any(e.is_discontinuity for e in events) or self.attempts - attempts < STANDSTILL:
            return
        if self.time - time <= CROWDED * max(1.0, self.time):
            from robodyn_cli.integrators.event_location.events import chatter

            raise chatter(events[self.integrator.n[IntegerSlot.EVENT]], self.time)

    def _goes_on(self, error: NumericalError) -> bool:
        """After many steps, let the supervisor choose the method to go on with; tell whether the run goes on."""
        asks = None if self.supervisor is None else self.supervisor.steps
        if asks is None or error.details.get("status") != "max_steps" or self.attempts < asks:
            return False
        assert self.supervisor is not None
        self._refuse_standstill()
        change = self.supervisor.reconsider(self)
        if change is None:
            self._set_pause()
            return True
        time, state = self.time, self.state
        self.changes.append(change)
        self._done, self._rounded = self.counters, self.rounded
        self._take_up(change.to)
        self._go_on_from(time, state)
        return True

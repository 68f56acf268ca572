"""Drive the compiled stepping loop: blocks of samples, breakpoints, events, counters."""

from __future__ import annotations

import ctypes
import dataclasses
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.system import GROUPS, System
from robodyn_cli.integrators.events import Event as Event
from robodyn_cli.integrators.events import Found, crosses, first_roots
from robodyn_cli.integrators.grid import Grid as Grid
from robodyn_cli.integrators.layout import Real, Status, Whole
from robodyn_cli.integrators.loop import Stepper, write_run
from robodyn_cli.integrators.options import Counters as Counters
from robodyn_cli.integrators.options import Options as Options
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.writer import ARGUMENTS
from robodyn_cli.kernels.arrays import aligned_zeros
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.samples import SampleKernel

Array = NDArray[Any]
DEFAULTS = Options()
Snapshot = tuple[Array, NDArray[np.int64], Array, Array]
SMALLEST_ATOL = 1e-300  # keeps weights finite where the tolerance is zero
# the compiled loop runs for about this long [s] at a time; the number of steps adapts itself
SLICE_TIME = 0.02
FIRST_SLICE = 256
RESTART = 1 / 16  # first step after a jump, as a part of the time since the last one
# so many steps with events within this part of the time so far (or of a second) get nowhere
CROWD = 200
CROWDED = 1e-9


class Integrator:
    """One system and one method, compiled; holds the state of a run, which may stop and resume.

    Parameters
    ----------
    system : what to integrate.
    method : name in the registry.
    parameters : values of the symbolic parameters p.

    ``tick``, where set, is told the time every few milliseconds of a run.
    """

    def __init__(self, system: System, method: str = "gauss", parameters: Any = ()) -> None:
        self.system = system
        self.stepper: Stepper = methods[method]()
        host = machine()
        compiled = compile_module(
            f"run {method} {system.digest}", lambda: write_run(system, methods[method](), host.fused)
        )
        self._run = compiled.function("run", *[ctypes.c_void_p] * len(ARGUMENTS), result=ctypes.c_int64)
        room = compiled.function("memory", ctypes.c_int64, result=ctypes.c_int64)(system.nv)
        self._fixed = (*system.dynamics.memory(), aligned_zeros(room))
        self._switching = (
            SampleKernel({"g": [e.value for e in system.events]}, GROUPS) if system.events else None
        )
        programs = (system.positions, system.velocities, system.switching)
        needed = max([system.dynamics.parameters, *(p.inputs.get("p", 0) for p in programs if p is not None)])
        if len(parameters) < needed:
            raise ValueError(f"the system has {needed} parameters, got {len(parameters)}")
        self.p = np.array(parameters, dtype=float) if len(parameters) else np.zeros(1)
        self._out = np.zeros(0)
        self._slice = FIRST_SLICE
        self.tick: Callable[[float], None] | None = None
        self.reset(0.0, np.zeros(system.size))

    # -- state ----------------------------------------------------------------------------------------
    def reset(self, time: float, state: Any, options: Options = DEFAULTS) -> None:
        """Start a run from ``state`` = (q, v, z) at ``time``."""
        self.options = options
        self.w = np.zeros(Real.SIZE + max(1, len(self.system.events)))
        self.n = np.zeros(Whole.SIZE, dtype=np.int64)
        self.n[Whole.VELOCITIES] = self.system.nv
        self.y = np.array(state, dtype=float)
        if self.y.shape != (self.system.size,):
            raise ValueError(f"the state has {self.system.size} components, got {self.y.shape}")
        self.memory = np.zeros(max(1, self.stepper.dense_size(self.system)))
        self.w[Real.T] = time
        self.w[Real.RTOL], self.w[Real.ATOL] = options.rtol, max(options.atol, SMALLEST_ATOL)
        self.w[Real.H_MAX] = options.max_step
        self.w[Real.MEMORY] = self.w[Real.MEMORY_2] = 1.0
        self.n[Whole.LAST_SAMPLE] = -1
        self.events_seen = 0
        self._since, self._restart = time, np.inf
        self._armed = False
        self._bind()

    def _bind(self) -> None:
        """Note where the arrays lie; they are only ever written in place."""
        arrays = (self.w, self.n, self.y, self.p, self.memory, self._out, *self._fixed)
        self._addresses = tuple(a.ctypes.data for a in arrays)

    @property
    def time(self) -> float:
        return float(self.w[Real.T])

    @property
    def state(self) -> Array:
        return self.y.copy()

    @property
    def counters(self) -> Counters:
        n = self.n
        return Counters(
            int(n[Whole.ACCEPTED]), int(n[Whole.REJECTED]), int(n[Whole.EVALUATIONS]),
            int(n[Whole.PROJECTIONS]), self.events_seen,
        )  # fmt: skip

    def set_state(self, state: Any) -> None:
        """Replace the state in the middle of a run (a jump); the time stays."""
        self.y[:] = state
        if self._switching is not None:
            # the next event may come sooner than the last one did, so the step starts short again
            if self.time > self._since:
                self._restart = RESTART * (self.time - self._since)
                self._since = self.time
            self.w[Real.H] = min(self.w[Real.H], self._restart)
        self._forget()
        self._watch({})

    # -- running --------------------------------------------------------------------------------------
    def _call(self, end: float) -> Status:
        self.w[Real.T_END] = end
        if self.options.step is not None:
            self.w[Real.H] = self.options.step
        elif not self.w[Real.H] > 0.0:
            # start well below any sensible step: growth is quick, and a first step that is far too long can
            # look good where derivatives happen to vanish
            self.w[Real.H] = min(1e-3 * (end - self.w[Real.T]), self.options.max_step)
        if not self.w[Real.H_OLD] > 0.0:
            self.w[Real.H_OLD] = self.w[Real.H]
        while True:
            # back here every few milliseconds: interrupts are heard, and progress is told
            taken = int(self.n[Whole.ACCEPTED] + self.n[Whole.REJECTED])
            self.n[Whole.MAX_STEPS] = min(self.options.max_steps, taken + self._slice)
            start = perf_counter()
            status = Status(self._run(*self._addresses))
            if status is not Status.MAX_STEPS or self.n[Whole.MAX_STEPS] >= self.options.max_steps:
                return status
            spent = perf_counter() - start
            if spent < SLICE_TIME:
                self._slice *= 2
            elif spent > 4 * SLICE_TIME:
                self._slice = max(1, self._slice // 2)
            if self.tick is not None:
                self.tick(self.time)

    def event_values(self, time: float, state: Array) -> Array:
        """Return the event functions at a state."""
        if self._switching is None:
            return np.zeros(0)
        s = self.system
        groups = {
            "t": np.array([[time]]), "q": state[None, : s.nq], "v": state[None, s.nq : s.nq + s.nv],
            "z": state[None, s.nq + s.nv :], "p": self.p,
        }  # fmt: skip
        return self._switching.evaluate(1, groups)["g"][0]

    def _watch(self, signs: Mapping[int, float]) -> None:
        """Arm the event functions at the current state; those that just fired (``signs``) have their new sign."""
        if self._switching is None:
            return
        for k, (g, event) in enumerate(zip(self.event_values(self.time, self.y), self.system.events)):
            place = Real.SIZE + k
            if k in signs:
                self.w[place] = signs[k] * max(abs(g), 1e-300)
            elif g != 0.0 and not crosses(event, self.w[place], g):
                # a function at zero keeps the side it came from, and one that has crossed is found in the next step
                self.w[place] = g
        self.n[Whole.WATCH] = 1
        self._armed = True

    def _forget(self) -> None:
        """Let the event functions start anew, from whichever side they are on."""
        self.w[Real.SIZE :] = 0.0
        self._armed = False

    def advance(self, end: float) -> None:
        """Integrate to ``end`` without samples or events.

        Raises
        ------
        NumericalError : the step size underflows, the state stops being finite, or there are too many steps.
        """
        self.n[Whole.WATCH], self.n[Whole.LAST_SAMPLE] = 0, -1
        self._forget()
        for stop in [b for b in self.system.breakpoints if self.time < b < end] + [end]:
            self._check(self._call(stop))

    def run(
        self,
        end: float,
        grid: Grid,
        emit: Callable[[Array, Array], None],
        on_event: Callable[[Event], bool] | None = None,
        block: int = 65536,
        watch: bool = True,
    ) -> None:
        """Integrate to ``end``, handing on samples in blocks.

        Parameters
        ----------
        grid : sample times; those from the current time on are written.
        emit : takes times (m,) and states (m, nx), in order, each sample once.
        on_event : called at each event with the state there (the integrator's own state is at the event);
            returns whether to go on. It may call ``set_state``.
        watch : whether to look for events at all.
        """
        s = self.system
        capacity = max(1, min(block, grid.count))
        self._out = np.zeros(capacity * s.size)
        self._bind()
        rows = self._out.reshape(s.size, capacity)
        self.n[Whole.CAPACITY], self.n[Whole.ROWS] = capacity, 0
        first = grid.first_at(self.time)
        self.n[Whole.NEXT_SAMPLE], self.n[Whole.LAST_SAMPLE] = first, grid.count - 1
        self.w[Real.SAMPLE_START], self.w[Real.SAMPLE_STEP] = grid.start, grid.step
        if first < grid.count and grid.begins_by(first, self.time):
            emit(np.array([self.time]), self.y[None, :].copy())
            self.n[Whole.NEXT_SAMPLE] += 1
        watch = watch and self._switching is not None
        self.n[Whole.WATCH] = watch
        if not watch:
            self._forget()
        elif not self._armed:
            self._watch({})

        def flush() -> None:
            count = int(self.n[Whole.ROWS])
            if count:
                last = int(self.n[Whole.NEXT_SAMPLE])
                emit(grid.times(last - count, last), rows[:, :count].T.copy())
                self.n[Whole.ROWS] = 0

        crowd: deque[float] = deque(maxlen=CROWD)
        for stop in [*(b for b in s.breakpoints if self.time < b < end), end]:
            while True:
                status = self._call(stop)
                flush()
                if status is Status.DONE:
                    break
                if status is Status.EVENT:
                    crowd.append(self.time)
                    if len(crowd) == CROWD and self.time - crowd[0] <= CROWDED * max(1.0, self.time):
                        raise self._chatter()
                    if not self._handle(self._locate(stop, flush), on_event):
                        return
                elif status is not Status.FULL:
                    self._check(status)
        if watch:
            self._handle(self._at_end(), on_event)

    def _chatter(self) -> NumericalError:
        """Return the error of a function that changes its sign again and again, getting nowhere."""
        event = self.system.events[int(self.n[Whole.EVENT])]
        advice = "; make its jump a steep slope, as in tanh(x/0.001) for sign(x)" if event.kink else ""
        return NumericalError(
            f"{event.name} switches to and fro without end at t = {self.time:.6g} s{advice}",
            time=self.time, status="chatter",
        )  # fmt: skip

    def _handle(self, events: Sequence[Event], on_event: Callable[[Event], bool] | None) -> bool:
        """Report events at the same time, each with the state that the ones before it have left."""
        onward = True
        for event in events:
            self.events_seen += 1
            if on_event is not None:
                going = on_event(dataclasses.replace(event, state=self.state))
            else:
                going = not self.system.events[event.index].terminal
            onward = onward and going
        return onward

    def _at_end(self) -> tuple[Event, ...]:
        """Return the events whose functions have come to zero exactly at the end of the run."""
        if self._switching is None:
            return ()
        found = []
        for k, (g, event) in enumerate(zip(self.event_values(self.time, self.y), self.system.events)):
            sign = -float(np.sign(self.w[Real.SIZE + k]))
            if g == 0.0 and crosses(event, -sign, sign):
                self.w[Real.SIZE + k] = sign * 1e-300
                found.append(Event(event.name, k, self.time, self.state, 0.0))
        return tuple(found)

    def _snapshot(self) -> Snapshot:
        return self.w.copy(), self.n.copy(), self.y.copy(), self.memory.copy()

    def _restore(self, saved: Snapshot) -> None:
        """Go back to a snapshot; the counters run on."""
        counters = [Whole.ACCEPTED, Whole.REJECTED, Whole.EVALUATIONS, Whole.PROJECTIONS]
        counted = self.n[counters]
        self.w[:], self.n[:], self.y[:], self.memory[:] = saved
        self.n[counters] = counted

    def _locate(self, stop: float, flush: Callable[[], None]) -> tuple[Event, ...]:
        """Find the first event in the step ahead, and others at the same time, and go there."""
        events = self.system.events
        start = self._snapshot()
        t0 = self.time
        armed = self.w[Real.SIZE : Real.SIZE + len(events)].copy()
        high = min(float(self.w[Real.EVENT_HIGH]), stop)
        low = min(max(float(self.w[Real.EVENT_LOW]), t0), high)

        @cache
        def values(time: float) -> Array:
            self._restore(start)
            self.n[Whole.LAST_SAMPLE] = -1
            self.n[Whole.WATCH] = 0
            try:
                if time > t0:
                    self._check(self._call(time))
            except NumericalError:
                return np.full(len(events), np.nan)
            return self.event_values(self.time, self.y)

        found = first_roots(events, values, armed, int(self.n[Whole.EVENT]), (t0, low, high))
        if not found.roots and found.time <= t0:
            # the step cannot be taken: let it fail where it does
            self._restore(start)
            self.n[Whole.WATCH] = 0
            self._check(self._call(high))
            found = Found(high)
        self._commit(start, found, flush)
        return tuple(
            Event(events[r.index].name, r.index, self.time, self.state, r.high - r.low) for r in found.roots
        )

    def _commit(self, start: Snapshot, found: Found, flush: Callable[[], None]) -> None:
        """Take the step to where the events are for good, samples included, and arm their functions beyond."""
        self._restore(start)
        self.n[Whole.WATCH] = 0
        while True:
            status = self._call(found.time)
            flush()
            if status is not Status.FULL:
                break
        self._check(status)
        self._watch({r.index: r.sign for r in found.roots})

    def _check(self, status: Status) -> None:
        if status in (Status.DONE, Status.FULL):
            return
        where = f"at t = {self.time:.6g} s"
        facts = {"time": self.time, "status": status.name.lower()}
        if status is Status.MAX_STEPS:
            raise NumericalError(f"more than {self.options.max_steps} steps, stopped {where}", **facts)
        if status is Status.NOT_FINITE:
            raise NumericalError(f"the state stops being finite {where}", **facts)
        if not np.all(np.isfinite(self._rates())):
            raise NumericalError(f"the equations of motion give no finite accelerations {where}", **facts)
        raise NumericalError(f"the step size became too small {where} (step {self.w[Real.H]:.3g} s)", **facts)

    def _rates(self) -> Array:
        """Return accelerations and z rates at the current state (slowly, without a compiler)."""
        s, y = self.system, self.y[:, None]
        groups = {
            "t": np.array([[self.time]]), "q": y[: s.nq], "v": y[s.nq : s.nq + s.nv], "z": y[s.nq + s.nv :],
            "p": self.p[:, None],
        }  # fmt: skip
        return s.dynamics.values(groups)


def integrate(
    system: System,
    method: str,
    state: Any,
    grid: Grid,
    options: Options = DEFAULTS,
    parameters: Any = (),
) -> tuple[Array, Array, Counters]:
    """Integrate over a grid and return times (T,), states (T, nx) and counters."""
    integrator = Integrator(system, method, parameters)
    integrator.reset(grid.start, state, options)
    times: list[Array] = []
    states: list[Array] = []

    def emit(t: Array, x: Array) -> None:
        times.append(t)
        states.append(x)

    integrator.run(grid.start + (grid.count - 1) * grid.step, grid, emit)
    return np.concatenate(times), np.concatenate(states), integrator.counters

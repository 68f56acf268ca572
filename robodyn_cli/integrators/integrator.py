"""Drive the compiled stepping loop: blocks of samples, breakpoints, events, counters."""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.system import GROUPS, System
from robodyn_cli.integrators.layout import Real, Status, Whole
from robodyn_cli.integrators.loop import Stepper, write_run
from robodyn_cli.integrators.registry import methods
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.samples import SampleKernel

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Grid:
    """Uniform sample times start + k step, k = 0 .. count - 1."""

    start: float
    step: float
    count: int

    @staticmethod
    def over(duration: float, count: int) -> Grid:
        return Grid(0.0, duration / (count - 1), count)

    def times(self, first: int, last: int) -> Array:
        """Return sample times first .. last - 1."""
        return self.start + np.arange(first, last) * self.step


@dataclasses.dataclass
class Counters:
    """What a run took."""

    steps: int = 0
    rejected: int = 0
    evaluations: int = 0
    projections: int = 0
    events: int = 0

    def as_dict(self) -> dict[str, int]:
        return dataclasses.asdict(self)


@dataclasses.dataclass(frozen=True)
class Event:
    """An event that happened: which function, when, and the state (q, v, z) there."""

    name: str
    index: int
    time: float
    state: Array
    time_error: float


@dataclasses.dataclass(frozen=True)
class Options:
    """How to integrate; ``step`` is for methods without step control."""

    rtol: float = 1e-10
    atol: float = 1e-12
    step: float | None = None
    max_step: float = np.inf
    max_steps: int = 10_000_000


class Integrator:
    """One system and one method, compiled; holds the state of a run, which may stop and resume.

    Parameters
    ----------
    system : what to integrate.
    method : name in the registry.
    parameters : values of the symbolic parameters p.
    """

    def __init__(self, system: System, method: str = "gauss", parameters: Any = ()) -> None:
        self.system = system
        self.stepper: Stepper = methods[method]()
        host = machine()
        compiled = compile_module(
            f"run {method} {system.digest}", lambda: write_run(system, methods[method](), host.fused)
        )
        self._run = compiled.function("run", *[ctypes.c_void_p] * 6, result=ctypes.c_int64)
        self._switching = (
            SampleKernel({"g": [e.value for e in system.events]}, GROUPS) if system.events else None
        )
        self.p = np.ascontiguousarray(parameters, dtype=float) if len(parameters) else np.zeros(1)
        self._out = np.zeros(0)
        self.reset(0.0, np.zeros(system.size))

    # -- state ----------------------------------------------------------------------------------------
    def reset(self, time: float, state: Any, options: Options = Options()) -> None:  # noqa: B008
        """Start a run from ``state`` = (q, v, z) at ``time``."""
        self.options = options
        self.w = np.zeros(Real.SIZE + max(1, len(self.system.events)))
        self.n = np.zeros(Whole.SIZE, dtype=np.int64)
        self.y = np.array(state, dtype=float)
        if self.y.shape != (self.system.size,):
            raise ValueError(f"the state has {self.system.size} components, got {self.y.shape}")
        self.memory = np.zeros(max(1, self.stepper.dense_size(self.system)))
        self.w[Real.T] = time
        self.w[Real.RTOL], self.w[Real.ATOL] = options.rtol, options.atol
        self.w[Real.H_MAX] = options.max_step
        self.w[Real.MEMORY] = self.w[Real.MEMORY_2] = 1.0
        self.n[Whole.MAX_STEPS] = options.max_steps
        self.n[Whole.LAST_SAMPLE] = -1
        self.events_seen = 0

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
        self._watch()

    # -- running --------------------------------------------------------------------------------------
    def _call(self, end: float) -> Status:
        self.w[Real.T_END] = end
        if self.options.step is not None:
            self.w[Real.H] = self.options.step
        elif not self.w[Real.H] > 0.0:
            # start well below any sensible step: growth is quick, and a first step that is far too long can
            # look good where derivatives happen to vanish
            self.w[Real.H] = min(1e-3 * (end - self.w[Real.T]), self.options.max_step)
            self.w[Real.H_OLD] = self.w[Real.H]
        status = self._run(
            self.w.ctypes.data, self.n.ctypes.data, self.y.ctypes.data, self.p.ctypes.data,
            self.memory.ctypes.data, self._out.ctypes.data,
        )  # fmt: skip
        return Status(status)

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

    def _watch(self, after: int | None = None, sign: float = 0.0) -> None:
        """Arm the event functions at the current state; the one that just fired keeps its new sign."""
        if self._switching is None:
            return
        g = self.event_values(self.time, self.y)
        if after is not None:
            g[after] = sign * max(abs(g[after]), 1e-300)
        self.w[Real.SIZE :] = g
        self.n[Whole.WATCH] = 1

    def advance(self, end: float) -> None:
        """Integrate to ``end`` without samples or events.

        Raises
        ------
        NumericalError : the step size underflows, the state stops being finite, or there are too many steps.
        """
        watch, self.n[Whole.WATCH] = self.n[Whole.WATCH], 0
        for stop in [b for b in self.system.breakpoints if self.time < b < end] + [end]:
            self._check(self._call(stop))
        self.n[Whole.WATCH] = watch

    def run(
        self,
        end: float,
        grid: Grid,
        emit: Callable[[Array, Array], None],
        on_event: Callable[[Event], bool] | None = None,
        block: int = 65536,
    ) -> None:
        """Integrate to ``end``, handing on samples in blocks.

        Parameters
        ----------
        grid : sample times; those from the current time on are written.
        emit : takes times (m,) and states (m, nx), in order, each sample once.
        on_event : called at each event with the state there (the integrator's own state is at the event);
            returns whether to go on. It may call ``set_state``.
        """
        s = self.system
        capacity = max(1, min(block, grid.count))
        self._out = np.zeros(capacity * s.size)
        rows = self._out.reshape(s.size, capacity)
        self.n[Whole.CAPACITY], self.n[Whole.ROWS] = capacity, 0
        first = max(0, int(np.ceil((self.time - grid.start) / grid.step * (1 - 1e-14) - 1e-9)))
        self.n[Whole.NEXT_SAMPLE], self.n[Whole.LAST_SAMPLE] = first, grid.count - 1
        self.w[Real.SAMPLE_START], self.w[Real.SAMPLE_STEP] = grid.start, grid.step
        if first < grid.count and abs(grid.start + first * grid.step - self.time) <= 1e-14 * max(1.0, abs(self.time)):
            emit(np.array([self.time]), self.y[None, :].copy())
            self.n[Whole.NEXT_SAMPLE] += 1
        self._watch()

        def flush() -> None:
            count = int(self.n[Whole.ROWS])
            if count:
                last = int(self.n[Whole.NEXT_SAMPLE])
                emit(grid.times(last - count, last), rows[:, :count].T.copy())
                self.n[Whole.ROWS] = 0

        stops = [b for b in s.breakpoints if self.time < b < end] + [end]
        going = True
        for stop in stops:
            while going:
                status = self._call(stop)
                flush()
                if status is Status.DONE:
                    break
                if status is Status.EVENT:
                    event = self._locate(stop, flush)
                    if event is not None:
                        going = self._handle(event, on_event)
                elif status is not Status.FULL:
                    self._check(status)
            if not going:
                break

    def _handle(self, event: Event, on_event: Callable[[Event], bool] | None) -> bool:
        self.events_seen += 1
        onward = not self.system.events[event.index].terminal
        if on_event is not None:
            onward = on_event(event)
        return onward

    def _snapshot(self) -> tuple[Array, Array, Array, Array]:
        return self.w.copy(), self.n.copy(), self.y.copy(), self.memory.copy()

    def _restore(self, saved: tuple[Array, Array, Array, Array], keep_counters: bool = True) -> None:
        counted = self.n[[Whole.ACCEPTED, Whole.REJECTED, Whole.EVALUATIONS, Whole.PROJECTIONS]].copy()
        self.w[:], self.n[:], self.y[:], self.memory[:] = saved
        if keep_counters:
            self.n[[Whole.ACCEPTED, Whole.REJECTED, Whole.EVALUATIONS, Whole.PROJECTIONS]] = counted

    def _locate(self, stop: float, flush: Callable[[], None]) -> Event | None:
        """Find the event in the step ahead by steps that end at the trial time, and go there.

        Each trial has the full order of the method, so the root is as accurate as the states themselves
        (bracketed by regula falsi in the Illinois variant, to a few units in the last place of the time).
        """
        index = int(self.n[Whole.EVENT])
        start = self._snapshot()
        before = float(self.w[Real.SIZE + index])
        t0 = self.time
        low, high = t0, min(float(self.w[Real.EVENT_HIGH]), stop)
        first_low = float(self.w[Real.EVENT_LOW])
        side = 0
        def value(time: float) -> float:
            """Return the event function at ``time``; NaN where the motion cannot be followed that far."""
            self._restore(start)
            self.n[Whole.LAST_SAMPLE] = -1
            self.n[Whole.WATCH] = 0
            try:
                if time > t0:
                    self._check(self._call(time))
            except NumericalError:
                return np.nan
            return float(self.event_values(time, self.y)[index])

        g_low, g_high = before, value(high)
        if first_low > t0:
            g_first = value(first_low)
            if g_first * before > 0:
                low, g_low = first_low, g_first
        if g_high * before > 0:
            # dense output saw a crossing that the states do not confirm: step over it
            self._commit(start, high, index, float(np.sign(g_high)), flush)
            return None
        resolution = 4e-16 * max(abs(high), abs(t0))
        for _ in range(200):
            if high - low <= resolution or g_high == 0.0:
                break
            trial = 0.5 * (low + high)
            if np.isfinite(g_high) and g_high != g_low:
                secant = high - g_high * (high - low) / (g_high - g_low)
                trial = secant if low < secant < high else trial
            if not low < trial < high:
                break
            g = value(trial)
            if g * before > 0:
                low, g_low = trial, g
                g_high *= 0.5 if side < 0 else 1.0
                side = -1
            else:
                high, g_high = trial, g
                g_low *= 0.5 if side > 0 else 1.0
                side = 1
        if not np.isfinite(g_high):
            self._commit(start, low, index, float(np.sign(before)), flush)
            return None
        after = -np.sign(before)
        self._commit(start, high, index, float(after), flush)
        return Event(self.system.events[index].name, index, high, self.state, high - low)

    def _commit(self, start: Any, time: float, index: int, sign: float, flush: Callable[[], None]) -> None:
        """Take the step to ``time`` for good, samples included, and arm the events beyond it."""
        self._restore(start)
        self.n[Whole.WATCH] = 0
        while True:
            status = self._call(time)
            flush()
            if status is not Status.FULL:
                break
        self._check(status)
        self._watch(index, sign)

    def _check(self, status: Status) -> None:
        if status in (Status.DONE, Status.FULL):
            return
        where = f"at t = {self.time:.6g} s"
        facts = {"time": self.time, "status": status.name.lower()}
        if status is Status.MAX_STEPS:
            raise NumericalError(f"more than {self.options.max_steps} steps, stopped {where}", **facts)
        if not np.all(np.isfinite(self.y)):
            raise NumericalError(f"the state is no longer finite {where}", **facts)
        raise NumericalError(f"the step size became too small {where} (step {self.w[Real.H]:.3g} s)", **facts)


def integrate(
    system: System, method: str, state: Any, grid: Grid, options: Options = Options(), parameters: Any = ()  # noqa: B008
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


def sample_blocks(grid: Grid, block: int) -> Iterator[tuple[int, int]]:
    """Yield (first, last) of consecutive blocks of samples."""
    for first in range(0, grid.count, block):
        yield first, min(first + block, grid.count)

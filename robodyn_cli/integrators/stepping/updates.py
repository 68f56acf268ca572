"""States that are set anew at known instants, at which steps end: their code, and the call of a function in Python."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from robodyn_cli.formulations.updates import Updates
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Memory, Status
from robodyn_cli.integrators.stepping.stepper import SLACK
from robodyn_cli.integrators.stepping.writer import Exit, Writer
from robodyn_cli.kernels.arrays import Array, aligned_zeros
from robodyn_cli.kernels.ir import Int, Value

CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int64)


class UpdateSlot:
    """Slots of the block of updates; measured q and v follow, then the torques of a function in Python, then noise."""

    PERIOD = 0
    REST = 1
    FUNCTION = 2  # its address, an integer
    TIME = 3  # for the function
    SIZE = 4


class UpdateMemory:
    """The block that compiled code reads at updates (see ``UpdateSlot``), and what a function in Python raised."""

    def __init__(self, updates: Updates, positions: int, velocities: int) -> None:
        self.updates = updates
        seen, driven = positions + velocities, len(updates.joints)
        first = UpdateSlot.SIZE + seen + driven
        self.block = aligned_zeros(first + updates.noise.size)
        self.block[first:] = updates.noise.ravel()
        self.block[UpdateSlot.PERIOD], self.block[UpdateSlot.REST] = updates.period, updates.rest
        measured = self.block[UpdateSlot.SIZE : UpdateSlot.SIZE + seen]
        self._q, self._v = measured[:positions], measured[positions:]
        self._asked = self.block[first - driven : first]
        self.failure: BaseException | None = None
        if updates.function is not None:
            self._callback = CALLBACK(self._call)
            address = ctypes.cast(self._callback, ctypes.c_void_p).value
            self.block.view(np.int64)[UpdateSlot.FUNCTION] = address or 0

    def _call(self) -> int:
        """Call the function with what was measured; 1 where it raised."""
        updates, time = self.updates, float(self.block[UpdateSlot.TIME])
        try:
            assert updates.function is not None
            self._asked[:] = updates.function(time, self._q.copy(), self._v.copy())
        except BaseException as error:  # compiled code lies between here and who can handle it
            self.failure = error
            return 1
        return 0

    def begin(self, memory: Memory, time: float) -> None:
        """Note in the memory of a run that begins at ``time`` [s] which update comes first."""
        n, w = memory.n, memory.w
        n[IntegerSlot.UPDATES], n[IntegerSlot.PHASE], w[DoubleSlot.NEXT_UPDATE] = self.updates.after(time)

    def within(self, time: float) -> float:
        """Return how many updates there are within a time [s], and so at least how many steps."""
        return time / self.updates.period

    def raise_failure(self) -> None:
        """Raise what the function has raised."""
        failure, self.failure = self.failure, None
        if failure is not None:
            raise failure


ROUNDING = 4e-16  # of an instant within which it is reached


def update_when_due(w: Writer, updates: Updates, run: Exit) -> None:
    """Make the update whose instant has come, if any; a step that follows knows nothing of earlier ones."""
    f, instant = w.f, w.get(DoubleSlot.NEXT_UPDATE)
    with f.strict():
        due = f.compare("ole", instant - w.get(DoubleSlot.T), f.abs(instant) * ROUNDING)
    with f.when(due):
        code = UpdateCode(w, updates, run)
        if updates.rest:
            with f.when(f.compare_int("eq", f.load_int(w.integer_at(IntegerSlot.PHASE)), 0)):
                code.sample(instant)
            with f.otherwise():
                code.act(instant)
        else:
            code.sample(instant)
        f.store_int(0, w.integer_at(IntegerSlot.RATE_KNOWN))


def bound(w: Writer) -> Value:
    """Return the time beyond which no step may go: the end of the run, or the next update."""
    return w.f.min(w.get(DoubleSlot.T_END), w.get(DoubleSlot.NEXT_UPDATE))


class UpdateCode:
    """The code of both phases."""

    def __init__(self, w: Writer, updates: Updates, run: Exit) -> None:
        self.w, self.f, self.updates, self.run = w, w.f, updates, run
        system = w.system
        layout = system.layout
        self.seen = system.nq + system.nv if layout is None else len(layout.q) + len(layout.v)
        self.number = w.integer_at(IntegerSlot.UPDATES)

    def at(self, place: int) -> str:
        """Return an address in the block of updates."""
        return self.f.offset("%updates", place)

    def sample(self, instant: Value) -> None:
        """Emit phase 0: all states from what is measured, and the instant of the next phase."""
        f, w, updates = self.f, self.w, self.updates
        number = f.load_int(self.number)
        inputs = self._inputs(number)
        if updates.measurement is not None:
            self._call_python(instant, inputs)
        self._set(w.evaluate(updates.programs[0], instant, w.state, **inputs)["z"])
        period = f.load(self.at(UpdateSlot.PERIOD))
        with f.strict():
            if updates.rest:
                w.put(DoubleSlot.NEXT_UPDATE, f.to_double(number) * period + f.load(self.at(UpdateSlot.REST)))
                f.store_int(1, w.integer_at(IntegerSlot.PHASE))
            else:
                self._next_period(number, period)

    def act(self, instant: Value) -> None:
        """Emit phase 1: torques that were on their way act."""
        f, w = self.f, self.w
        self._set(w.evaluate(self.updates.programs[1], instant, w.state)["z"])
        with f.strict():
            self._next_period(f.load_int(self.number), f.load(self.at(UpdateSlot.PERIOD)))
        f.store_int(0, w.integer_at(IntegerSlot.PHASE))

    def _next_period(self, number: Int, period: Value) -> None:
        f = self.f
        f.store_int(number + 1, self.number)
        self.w.put(DoubleSlot.NEXT_UPDATE, f.to_double(number + 1) * period)

    def _inputs(self, number: Int) -> dict[str, Any]:
        """Return the inputs that only updates have: random numbers of the sample, torques from Python."""
        f, torques = self.f, UpdateSlot.SIZE + self.seen
        noise, channels = torques + len(self.updates.joints), self.updates.noise.shape[1]
        rows = Array(f, f.offset(self.at(noise), number * channels)) if channels else Array(f, self.at(noise))
        return {"noise": rows, "asked": Array(f, self.at(torques))}

    def _call_python(self, instant: Value, inputs: dict[str, Any]) -> None:
        """Hand what is measured to the function in Python, which leaves its torques in the block."""
        f, w, measurement = self.f, self.w, self.updates.measurement
        assert measurement is not None
        measured = w.evaluate(measurement, instant, w.state, **inputs)
        for k, value in enumerate([*measured["q"], *measured["v"]]):
            f.store(value, self.at(UpdateSlot.SIZE + k))
        f.store(instant, self.at(UpdateSlot.TIME))
        failed = f.emit_int(f"call i64 {f.load_address(self.at(UpdateSlot.FUNCTION))}()")
        self.run.leave(Status.FAILED, f.compare_int("ne", failed, 0))

    def _set(self, values: list[Value]) -> None:
        for k, value in enumerate(values):
            self.w.state[place_of(self.w, self.updates, k)] = value


def place_of(w: Writer, updates: Updates, k: int) -> Int | int:
    """Return the place in x of a state that updates set."""
    return w.nv * 2 + k if updates.places is None else updates.places[k]


def held_at_sample(w: Writer, updates: Updates, time: Value, out: Array) -> None:
    """Store in a sample at the end of the last step what an update there has set; dense output is of the step."""
    f, limit = w.f, w.get(DoubleSlot.T)
    with f.strict():
        reached = f.compare("oge", time + f.abs(limit) * SLACK, limit)
    with f.when(reached):
        for k in range(updates.count):
            place = place_of(w, updates, k)
            out[place] = w.state[place]

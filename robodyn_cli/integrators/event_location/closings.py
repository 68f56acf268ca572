"""The compiled function that closes a latch, so that a run goes on there without Python."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.event_location.locate_event import inputs_at, load_places
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, LatchAnswer, Note, first_note
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.ir import Function, Int, Value
from robodyn_cli.kernels.lower import REGISTERS, Programs
from robodyn_cli.kernels.program import NUMBERS

if TYPE_CHECKING:
    from robodyn_cli.formulations.closings import Closings


def close_latch_function(system: System, closings: Closings, tables: Tables, programs: Programs) -> Function:
    """Return ``i64 close_latch(places)``, whose result is a ``LatchAnswer``, to the event of a latch where the run is.

    How near latches have come is noted at all events; where one closes, its impulse changes state and parameters.
    """
    f = Function("close_latch", ["ptr %places"], result="i64", flags="")
    load_places(f, "w", "n", "y", "p", NUMBERS, REGISTERS)
    code = _ClosingCode(f, system, closings)
    code.set_closed(1.0)
    here = programs.evaluate(f, closings.program, inputs_at(f, system, tables, closings.program), 1)
    code.note_nearest(here["values"])
    with f.block() as passes:
        passes.leave(f.compare_int("slt", code.latch, 0))
        with f.block() as doubtful:
            for x in here["apart"]:
                doubtful.leave(unless=f.compare("ogt", x, 0.0))
            code.note(here)
            code.commit(here)
            f.call("restart", ["ptr %places", f"double {f.constant(math.inf).ref}"])
            waits = f.compare("ogt", here["waited"][0], 0.5)
            f.ret(f.select_int(waits, int(LatchAnswer.GOES_ON), int(LatchAnswer.ENDS)))
        code.set_closed(0.0)
        f.ret(int(LatchAnswer.DOUBTFUL))
    f.ret(int(LatchAnswer.GOES_ON))
    return f


class _ClosingCode:
    """The code of a closing. latch : the number of the one that closes, negative where the event is another one."""

    def __init__(self, f: Function, system: System, closings: Closings) -> None:
        self.f, self.system, self.closings = f, system, closings
        self.time = f.load(f.offset("%w", DoubleSlot.T))
        self.notes = f.offset("%w", first_note(len(system.events)))
        event, self.latch = f.load_int(f.offset("%n", IntegerSlot.EVENT)), f.integer(-1)
        for k, function in enumerate(system.events):
            if function.closing is not None:
                here = f.compare_int("eq", event, k)
                self.latch = f.select_int(here, function.closing, self.latch)
        self._is = [f.compare_int("eq", self.latch, k) for k in range(len(closings.first))]

    def _note(self, k: Int | int, slot: int) -> str:
        return self.f.offset(self.f.offset(self.notes, slot), k * Note.SIZE)

    def _put(self, k: int, value: Value | float, address: str) -> None:
        """Store a value if latch k closes."""
        f = self.f
        f.store(f.select(self._is[k], value, f.load(address)), address)

    def set_closed(self, x: float) -> None:
        """Set the parameters that say whether the latch is closed, and holds."""
        for k, first in enumerate(self.closings.first):
            for place in (first, first + 1):
                self._put(k, x, self.f.offset("%p", place))

    def note_nearest(self, values: list[Value]) -> None:
        f = self.f
        for k, value in enumerate(values):
            size, nearest = f.abs(value), self._note(k, Note.NEAREST)
            nearer = f.compare("olt", size, f.load(nearest))
            for x, place in ((size, nearest), (self.time, self._note(k, Note.NEAREST_TIME))):
                f.store(f.select(nearer, x, f.load(place)), place)

    def note(self, here: dict[str, list[Value]]) -> None:
        """Note the closing, and the state before it."""
        f = self.f
        for k, v in enumerate(self.closings.v):
            speed = f.load(f.offset("%y", self.system.v_places[v]))
            facts = {
                Note.TIME: self.time, Note.ANGLE: here["q"][k], Note.SPEED: speed, Note.LOST: here["lost"][0],
                Note.IMPULSE: f.abs(here["impulses"][k]),
            }  # fmt: skip
            for slot, value in facts.items():
                self._put(k, value, self._note(k, slot))
        with f.count(self.system.size) as place:
            f.store(f.load(f.offset("%y", place)), f.offset(self._note(len(self.closings.v), 0), place))

    def commit(self, here: dict[str, list[Value]]) -> None:
        """Put the state behind the closing, and the other parameters of the latch, in place."""
        f, system = self.f, self.system
        for k, (first, q, v) in enumerate(zip(self.closings.first, self.closings.q, self.closings.v)):
            speed = f.load(f.offset("%y", system.v_places[v]))
            way = f.select(f.compare("oge", speed, 0.0), 1.0, f.constant(-1.0))
            self._put(k, way, f.offset("%p", first + 2))
            self._put(k, here["q"][k], f.offset("%p", first + 3))
            self._put(k, here["q"][k], f.offset("%y", system.q_places[q]))
        for place, value in zip(system.v_places, here["v"]):
            f.store(value, f.offset("%y", place))
        if system.work_place is not None:
            work = f.offset("%y", system.work_place)
            f.store(f.load(work) - here["lost"][0], work)

"""The compiled side of an integrator: a method's code for a system, and the memory of a run as it begins."""

from __future__ import annotations

import ctypes
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.formulations.events import LatchClosed
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.event_location.locate_event import PLACES
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, LatchAnswer, Memory, Note, Status
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.integrators.stepping.loop import write_run
from robodyn_cli.kernels.arrays import aligned_zeros
from robodyn_cli.kernels.compiler import LASTING, QUICK, compile_module, machine
from robodyn_cli.kernels.lower import Programs
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.integrators.stepping.updates import UpdateMemory

# Operations beyond which programs are interpreted at first: as data they take 3 us each to make, as machine code 25 us
# each, and 80 us where it is to last.
MANY = 10_000
# Operations beyond which the interpreter itself is to last: made quickly it takes twice as long at each of them.
TOO_MANY = 50_000
# An interpreted run is compiled after so many steps, or so many for each operation where that is more: the longer it
# takes to compile, the longer the run has to be to gain by it.
PATIENCE = 1000
STEPS_PER_OPERATION = 0.1
# Code that is made quickly gives way to lasting code after so many operations, of programs and of the loop, each
# counted once a step: by then it has lost some 20 ms, where making lasting code takes 50 to 500.
LOST = 2e7
LOOP = 1000
STATUSES = tuple(Status)  # by number
ADDRESS, NUMBER, DOUBLE = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double


class Engine:
    """Runs the compiled functions on memory that stays where it is; see ``locate_event.PLACES`` for what lies where.

    interpreted : whether long programs may be interpreted at first. quick : whether code that is made quickly serves at
    first. loaded : whether the code is there at once, and not only after ``load``. lasting : whether it stays what it
    is. tables : of numbers that the code reads.
    addresses : of ``run_to_event``, ``trial_step``, ``close_latch`` and of what all take. memory : of the run, its
    copy from before the step with an event. p : parameters. out : block of samples. bracket : see
    ``locate_event_function``.
    """

    def __init__(
        self,
        system: System,
        method: str,
        p: Array,
        interpreted: bool = True,
        quick: bool = False,
        loaded: bool = True,
    ) -> None:
        self._system, self._name, self._method = system, method, methods[method]
        self.p = p
        self.memory = Memory(system, self._method.dense_size(system))
        self.bracket = np.zeros((2, 1 + len(system.events)))
        self.places = np.zeros(len(PLACES), dtype=np.int64)
        self._at = self.places.ctypes.data
        self._values = np.zeros(len(system.events))
        self.out = np.zeros(0)
        self._method.check(system)
        self.tables = self._method.tables(system)
        if system.numbers is not None:
            self.tables.numbers[:] = system.numbers(self.tables.programs)
        self._exact, self._drawn = self.tables.numbers.copy(), 0
        self.updates: UpdateMemory | None = None
        if system.updates is not None:
            from robodyn_cli.integrators.stepping.updates import UpdateMemory

            self.updates = UpdateMemory(system.updates, len(system.q_places), len(system.v_places))
        self._operations = operations = sum(program.operations for program in self.tables.programs)
        self._interpreted = interpreted and operations > MANY and not system.dynamics.any_size
        self.lasting = not (quick or self._interpreted)
        interpreting, quickly = max(PATIENCE, STEPS_PER_OPERATION * operations), LOST / (LOOP + operations)
        self._patience = int(interpreting if self._interpreted else quickly)
        self.addresses = 0, 0, 0, self._at
        self.fixed: tuple[Array, ...] = ()
        if loaded:
            self.load()

    def load(self) -> None:
        """Provide the code, where it is not there."""
        if not self.addresses[0]:
            self._load(self.lasting)

    def patience(self, taken: int, most: int) -> int:
        """Return up to how many steps to run, ``most`` or fewer, when so many are taken; a long run gets lasting code.

        The number of steps decides and not their time, so that the same run gives the same bits again.
        """
        self.expect(taken)
        return most if self.lasting else min(most, self._patience)

    def expect(self, steps: float) -> None:
        """Provide lasting code for a run that is known to take so many steps or more."""
        if not self.lasting and steps >= self._patience:
            self._load(lasting=True)

    def _load(self, lasting: bool) -> None:
        """Take the functions from the cache or write them, and provide the memory that they work on."""
        system, kind, self.lasting = self._system, self._method, lasting
        host, interpreted = machine(), self._interpreted and not lasting
        compiled = compile_module(
            f"run{' interpreted' * interpreted} {self._name} {system.digest} {self.tables.digest}"
            f"{' in stretches' if system.breakpoints else ''}",
            lambda: write_run(system, kind, Programs(host.fused, interpreted)),
            LASTING if lasting or self._operations > TOO_MANY else QUICK,
        )
        self._run_to_event = compiled.function("run_to_event", ADDRESS, result=NUMBER)
        trial = compiled.address("trial_step") if system.events else 0
        closes = compiled.address("close_latch") if system.closings is not None else 0
        self.addresses = compiled.address("run_to_event"), trial, closes, self._at
        if system.closings is not None:
            self._close_latch = compiled.function("close_latch", ADDRESS, result=NUMBER)
        if system.events:
            self._restart = compiled.function("restart", ADDRESS, DOUBLE)
            self._switching = compiled.function("switching", ADDRESS)
            self._trial_step = compiled.function("trial_step", ADDRESS, DOUBLE, NUMBER, result=NUMBER)
        if (
            not self.fixed or self._interpreted
        ):  # else that of code that was made quickly, which lies the same
            room = compiled.function("memory", NUMBER, result=NUMBER)(system.nv)
            registers = compiled.function("registers", result=NUMBER)()
            updates = np.zeros(1) if self.updates is None else self.updates.block
            memory = (aligned_zeros(room), self.tables.numbers, aligned_zeros(registers), updates)
            self.fixed = (*system.dynamics.memory(), *memory)
        self._note_places()

    def draw(self, draw: int) -> None:
        """Put the numbers of the tables off by rounding, see ``Options.draw``."""
        if draw != self._drawn:
            self.tables.numbers[:] = self._exact * self.tables.off_by_rounding(draw)
            self._drawn = draw

    def take(self, numbers: Array) -> None:
        """Take the numbers of another scene of this structure in place of those of the tables.

        Such runs are many: their code is to last, and the first of them is to have the bits of any other.
        """
        if not self._interpreted:
            self.expect(math.inf)
        self._exact[:] = self.tables.numbers[:] = numbers
        self._drawn = 0

    def make_room(self, count: int) -> None:
        """Provide a block for so many doubles of samples."""
        self.out = np.zeros(count)
        self._note_places()

    def _note_places(self) -> None:
        """Note where all arrays lie: they never move."""
        memory = self.memory
        w, n, y, dense = memory.addresses
        p, *others = (a.ctypes.data for a in (self.p, self.out, *self.fixed))
        saved, values, bracket = (a.ctypes.data for a in (memory.saved, self._values, self.bracket))
        self.places[:] = (w, n, y, p, dense, *others, saved, memory.saved.nbytes, values, bracket)

    def run_to_event(self) -> Status:
        """Run on; where a step contains an event, locate it or bracket it."""
        return STATUSES[self._run_to_event(self._at)]

    def trial_step(self, time: float, last: int) -> Status:
        """Go back to the saved state, and from there to ``time``, writing samples up to number ``last``."""
        return STATUSES[self._trial_step(self._at, time, last)]

    def restart(self, step: float) -> None:
        """Go on from a state that has been replaced, with a step that is at most so long [s]."""
        self._restart(self._at, step)

    def close_latch(self, event: int) -> LatchClosed | None:
        """Close the latch that closes at an event, by its number, at the current state; None where code does not."""
        latch = self._system.events[event].closing
        if self._system.closings is None or latch is None:
            return None
        self.memory.n[IntegerSlot.EVENT] = event
        if self._close_latch(self._at) == LatchAnswer.DOUBTFUL:
            return None
        note = self.memory.notes[latch]
        return LatchClosed(self.memory.y.copy(), float(note[Note.IMPULSE]), float(note[Note.LOST]))

    def look(self) -> list[float]:
        """Return the event functions at the current state."""
        self._switching(self._at)
        return self.seen()

    def seen(self) -> list[float]:
        """Return the event functions where they were last evaluated."""
        values: list[float] = self._values.tolist()
        return values


SMALLEST_ATOL = 1e-300  # keeps weights finite where the tolerance is zero
FIRST = 1e-3  # first step of a run, as a part of the time to its end


def doubles_at_start(time: float, options: Options) -> dict[int, float]:
    """Return the slots of doubles that are not zero as a run begins."""
    return {
        DoubleSlot.T: time,
        DoubleSlot.RTOL: options.rtol,
        DoubleSlot.ATOL: max(options.atol, SMALLEST_ATOL),
        DoubleSlot.GIVEN_ATOL: max(options.atol, SMALLEST_ATOL),
        DoubleSlot.H_MAX: options.max_step,
        DoubleSlot.CONTRACTION: 1.0,
        DoubleSlot.LAST_ERROR: 1.0,
        DoubleSlot.T_AFTER: -math.inf,
        DoubleSlot.T_BEFORE: math.inf,
        DoubleSlot.SINCE: time,
        DoubleSlot.RESTART: math.inf,
        DoubleSlot.FIRST: options.first,
    }


def integers_at_start(velocities: int) -> dict[int, int]:
    """Return the slots of integers that are not zero as a run begins, without samples."""
    return {IntegerSlot.VELOCITIES: velocities, IntegerSlot.LAST_SAMPLE: -1}


def first_step(way: Any, options: Options) -> Any:
    """Return the first step of a run over times ``way`` [s]: numbers or arrays.

    It is well below any sensible step: growth is quick, and a first step that is far too long can look good where
    derivatives happen to vanish.
    """
    return FIRST * options.first * way

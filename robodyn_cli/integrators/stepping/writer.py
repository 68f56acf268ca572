"""The function that a stepping loop is written into, with the state and the programs of a system at hand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.decision import RATES, Decision
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Status
from robodyn_cli.kernels.arrays import Array, Total, each
from robodyn_cli.kernels.ir import RELAXED, Block, Condition, Function, Int, Value
from robodyn_cli.kernels.lower import INLINE_LIMIT, LANES, REGISTERS, Programs, is_inlined
from robodyn_cli.kernels.program import NUMBERS, Program, off_by_rounding

LONG = 24  # velocities, or further states, beyond which what is done for each of them is a loop
# The same where the rates are a call: states and rates are in memory then, so a loop loses no registers, and shorter
# code runs up to a seventh faster.
LONG_CALLED = 3
ARGUMENTS = ("w", "n", "y", "p", "dense", "out", "tables", "scratch", "work", NUMBERS, REGISTERS, "updates")


def placement(rates: Program) -> Decision:
    """Return where the code of the rates goes."""
    count, inlined = rates.operations, is_inlined(rates)
    compared = "not more" if inlined else "more"
    taken = "inlined" if inlined else "function"
    return Decision(RATES, taken, f"{count} operations, {compared} than {INLINE_LIMIT}")


class Exit:
    """The ways out of the loop: each leaves the ``block`` with a status."""

    def __init__(self, f: Function, block: Block) -> None:
        self.f = f
        self.block = block
        self._slot = f.int_slot()

    @property
    def status(self) -> Int:
        return self.f.load_int(self._slot)

    def leave(
        self, status: Status, condition: Condition | None = None, *, unless: Condition | None = None
    ) -> None:
        """End the run with a status: always, if a condition holds, or unless one holds."""
        self.f.store_int(int(status), self._slot)
        self.block.leave(condition, unless=unless)


class Tables:
    """The tables of numbers of all programs in a run's code, one after another: ``numbers``.

    programs : in an order that no number decides; the same objects that the code is written from.
    """

    def __init__(self, programs: Sequence[Program | None]) -> None:
        self.programs = [
            p for k, p in enumerate(programs) if p is not None and not any(p is q for q in programs[:k])
        ]
        tables = [p.table for p in self.programs]
        self._starts = np.cumsum([0, *(len(table) for table in tables)]).tolist()
        self.numbers = np.concatenate(tables)

    def off_by_rounding(self, draw: int) -> NDArray[np.float64]:
        """Return factors of the numbers (n,) that put those off that were computed; 1 everywhere for draw 0.

        Numbers of the scene count as exact. A number has one factor, whatever program reads it.
        """
        return np.array([off_by_rounding(x, draw) for p in self.programs for x in p.numbers or (0.0,)])

    def start(self, program: Program) -> int:
        """Return where the table of a program begins."""
        return int(next(s for p, s in zip(self.programs, self._starts) if p is program))

    @property
    def digest(self) -> str:
        """Key of the programs' code."""
        return " ".join(p.digest for p in self.programs)


class Writer:
    """The function under construction, with the state and the programs of the system at hand.

    ``nv``, ``nz``, ``rates`` (nv + nz) and ``size`` are Python ints, or Ints for a long system and where the code
    serves systems of any size: then rows of vectors live in memory of the caller, and ``each`` makes a loop (unless
    ``loops`` is False and the size is known). tables : of the numbers that the programs read. width : how many runs are
    made side by side.
    """

    width = 1

    def __init__(self, system: System, tables: Tables, programs: Programs, loops: bool = True) -> None:
        self.system = system
        self.tables = tables
        self.programs = programs
        self.f = f = self._function()
        self._named: dict[str, Array] = {}
        # doubles taken so far in the caller's memory: so many per (padded) velocity, and so many beside
        self._taken = [0, 0]
        self.nv: Int | int = system.nv
        long = LONG if is_inlined(system.dynamics.program) else LONG_CALLED
        many = system.nz > long
        if system.dynamics.any_size or (loops and system.nv == system.nq and (many or system.nv > long)):
            with f.entry():
                self.nv = f.load_int(self.integer_at(IntegerSlot.VELOCITIES))
                # a multiple of the lanes, so that every row starts aligned
                self._padded = (self.nv + (LANES - 1)) & -LANES
                self.nz: Int | int = f.integer(system.nz) if many else system.nz
                self.rates: Int | int = self.nv + self.nz
                self.size: Int | int = self.nv * 2 + self.nz
        else:
            self.nz, self.rates, self.size = system.nz, system.nv + system.nz, system.size
        # what rounding makes of the state in the step to be tried, where that is measured
        self.rounded: Array | None = None
        self.state = self.array(2, 1)
        self.new = self.array(2, 1)

    def _function(self) -> Function:
        return Function("run", [f"ptr noalias %{a}" for a in ARGUMENTS], result="i64", flags=RELAXED)

    # -- rows of vectors ------------------------------------------------------------------------------
    def array(self, velocities: int, others: int, width: int = 1) -> Array:
        """Return room for so many vectors per velocity, and so many per further state z."""
        f, s = self.f, self.system
        more = others * s.nz
        if isinstance(self.nv, int):
            return Array(f, f.slot(width, max(1, velocities * self.nv + more)), width)
        with f.entry():
            base = f.offset("%work", self._padded * self._taken[0] + self._taken[1])
        self._taken[0] += velocities * width
        self._taken[1] += -(-more * width // LANES) * LANES
        return Array(f, base, width)

    def room(self, count: int, width: int) -> Array:
        """Return room for so many vectors in memory of the caller."""
        f = self.f
        with f.entry():
            first: Int | int = self._taken[1]
            if not isinstance(self.nv, int):
                first = self._padded * self._taken[0] + first
            base = f.offset("%work", first)
        self._taken[1] += -(-count * width // LANES) * LANES
        return Array(f, base, width)

    def workspace(self, name: str, velocities: int, others: int, width: int) -> Array:
        """Return the room called ``name``, the same one each time."""
        if name not in self._named:
            self._named[name] = self.array(velocities, others, width)
        return self._named[name]

    def each(self, count: Int | int) -> Iterator[Int | int]:
        """Emit the body of a ``for`` once an index."""
        return each(self.f, count)

    def number(self, count: Int | int) -> Value | float:
        """Return a count as a double."""
        return self.f.to_double(count) if isinstance(count, Int) else float(count)

    def memory_function(self) -> Function:
        """Return ``i64 memory(n)``: the doubles of ``%work`` that a system of n velocities takes."""
        f = Function("memory", ["i64 %n"], result="i64")
        padded = (f.int_argument("n") + (LANES - 1)) & -LANES
        f.ret(padded * self._taken[0] + self._taken[1])
        return f

    def is_finite(self, x: Array) -> Condition:
        """Return whether a state has neither NaN nor infinities."""
        f = self.f
        with f.strict():
            total = Total(f)
            for k in self.each(self.size):
                total.add_product(x[k], 0.0)
            return f.compare("ord", total.value, 0.0)

    # -- shared memory --------------------------------------------------------------------------------
    def double_at(self, place: int) -> str:
        return self.f.offset("%w", int(place))

    def integer_at(self, place: int) -> str:
        return self.f.offset("%n", int(place))

    def get(self, place: int) -> Value:
        return self.f.load(self.double_at(place))

    def put(self, place: int, value: Value | float) -> None:
        self.f.store(value, self.double_at(place))

    def count(self, place: int, by: int = 1, where: Condition | None = None) -> None:
        """Add to a count; where : of which of the runs that are made side by side."""
        self.f.bump(self.integer_at(place), by)

    def begins_anew(self) -> Condition | None:
        """Return which of the runs that are made side by side begin or try a step again; None: it is one run."""
        return None

    def rejected_before(self) -> Condition:
        """Return whether the step has been tried before, and rejected."""
        f = self.f
        return f.compare_int("sgt", f.load_int(self.integer_at(IntegerSlot.REJECTED_IN_ROW)), 0)

    def behind_dense(self, first: Int | int) -> Array:
        """Return memory of the run for a state's rates, behind so many doubles of dense output."""
        return Array(self.f, self.f.offset("%dense", first))

    def due(self, limit: Value, slack: float) -> Condition:
        """Return whether the next sample lies before ``limit`` or, but for rounding, at it."""
        f = self.f
        k = f.load_int(self.integer_at(IntegerSlot.NEXT_SAMPLE))
        with f.strict():
            time = self.sample_time(k)
            bound = limit + (f.abs(limit) + f.abs(self.get(DoubleSlot.SAMPLE_START))) * slack
        last = f.load_int(self.integer_at(IntegerSlot.LAST_SAMPLE))
        return f.compare("ole", time, bound) & f.compare_int("sle", k, last)

    def sample_time(self, k: Int) -> Value:
        """Return the time of uniform sample k."""
        f = self.f
        with f.strict():
            return self.get(DoubleSlot.SAMPLE_START) + f.to_double(k) * self.get(DoubleSlot.SAMPLE_STEP)

    # -- programs -------------------------------------------------------------------------------------
    def numbers(self, program: Program) -> Array:
        """Return the table of a program, which is a part of the run's."""
        return Array(self.f, self.f.offset(f"%{NUMBERS}", self.tables.start(program)))

    def evaluate(
        self, program: Program, t: Value, x: Array, **more: list[Value] | Array
    ) -> dict[str, list[Value]]:
        """Emit a program of the system at time t and state x = (q, v, z), with ``more`` input groups."""
        return self.programs.evaluate(self.f, program, {**self.inputs(program, t, x), **more}, x.width)

    def inputs(self, program: Program, t: Value, x: Array) -> dict[str, list[Value] | Array]:
        """Return the inputs of a program of the system at time t and state x = (q, v, z)."""
        f = self.f
        first: dict[str, Int | int] = {"q": 0, "v": self.nv, "z": self.nv * 2}
        inputs: dict[str, list[Value] | Array] = {"t": [self.inside(t)], NUMBERS: self.numbers(program)}
        for group, count in program.inputs.items():
            if group == "p":
                inputs[group] = [f.load(f.offset("%p", k)) for k in range(count)]
            elif group in first:
                inputs[group] = x.part(first[group])
        return inputs

    def inside(self, t: Value) -> Value:
        """Return times (lanes) put inside the stretch between two breakpoints.

        A formula of time that jumps at a breakpoint has the value of one side there. A stage at the end of a step that
        ends there, or at the start of the next one, must see its own side.
        """
        if not self.system.breakpoints:
            return t
        f = self.f
        begin, end = (f.splat(self.get(k), t.width) for k in (DoubleSlot.T_AFTER, DoubleSlot.T_BEFORE))
        with f.strict():
            return f.min(f.max(t, begin), end)

    def dynamics(self, t: Value, x: Array, rates: Array) -> None:
        """Store v-dot and z-dot at time t and state x."""
        self.system.dynamics.emit(self, t, x, rates)

    def rate(self, t: Value, x: Array, rates: Array) -> None:
        """Store the whole x-dot = (v, v-dot, z-dot)."""
        v = x.part(self.nv)
        for k in self.each(self.nv):
            rates[k] = v[k]
        self.dynamics(t, x, rates.part(self.nv))

    def rate_of(self, t: Value, x: list[Value]) -> list[Value]:
        """Return x-dot at time t and a state that is not in memory; for systems of known size."""
        here, rates = self.array(2, 1), self.array(2, 1)
        for k, value in enumerate(x):
            here[k] = value
        self.rate(t, here, rates)
        return [rates[k] for k in range(len(x))]

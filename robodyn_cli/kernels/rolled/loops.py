"""Loops over the bodies of a tree, written around the steps of one body.

Bodies are visited in depth-first order, so nearly always the next body's parent is the one just done, and
quantities pass from one to the next in registers (``carry``). Only where a tree branches do they go through
memory: a branching body (and the base) owns a *branch slot* that its later children read, or add to.
A serial chain has no branches and none of that code.

Tables (``Tables``) are 64-bit words, doubles and integers mixed: a header, then a row for each body. Scratch memory
holds a row for each body (values that one sweep keeps for another), then the branch slots.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robodyn_cli.kernels.ir import BLOCKS_AHEAD, RELAXED, Function, Int, Value, module
from robodyn_cli.kernels.lower import lower
from robodyn_cli.kernels.program import Program
from robodyn_cli.kernels.rolled.recursion import (
    BODY_CONSTANTS,
    DOWN,
    UP,
    BodyStep,
    BodySweep,
    Place,
    Recursion,
)

ARGUMENTS = ("tables", "q", "v", "x", "out", "scratch")


class Header(enum.IntEnum):
    """Words at the start of the tables."""

    BODIES = 0
    SLOTS = 1
    BASE_MOTION = 2  # nine doubles: the base at rest, gravity as an upward acceleration
    SIZE = 16


class TableRow(enum.IntEnum):
    """Words of a body's row."""

    KIND = 0
    PARENT_SLOT = 1  # branch slot of the parent, or -1 where the parent is the body before
    OWN_SLOT = 2  # the body's own branch slot, or -1
    Q = 3  # column of the joint's first position
    V = 4
    CONSTANTS = 5
    SIZE = 5 + BODY_CONSTANTS


class TableLayout:
    """Places in scratch memory, in vectors: rows of bodies and branch slots; vanishing entries have none."""

    def __init__(self, recursion: Recursion) -> None:
        # what an outward sweep gives of an UP quantity waits in the body's row for the inward sweep
        started = {
            name
            for sweep in recursion.sweeps
            if sweep.outward
            for step in sweep.steps
            for name in step.places
            if name in UP
        }
        self.start: dict[Place, int] = {}
        self.slot: dict[Place, int] = {}
        for name, places in recursion.carried.items():
            for k in places:
                self.slot[name, k] = len(self.slot)
                if name in started:
                    self.start[name, k] = len(self.start)
        self.row_size = len(self.start) + recursion.kept
        self.slot_size = len(self.slot)

    def kept(self, k: int) -> int:
        return len(self.start) + k

    def vectors(self, bodies: int, slots: int) -> int:
        """Return how many vectors of scratch memory a tree takes."""
        return bodies * self.row_size + slots * self.slot_size


def _used(program: Program) -> dict[str, set[int]]:
    used: dict[str, set[int]] = {}
    for i in program.instructions:
        if i.op == "sym":
            used.setdefault(i.value[0], set()).add(i.value[1])
    return used


class BodyLoops:
    """Emits the sweeps of a recursion into a function with the arguments ``ARGUMENTS``.

    at : address of a column of samples, by array (``q``, ``v``, ``x``, ``out``) and number.
    """

    def __init__(
        self, f: Function, recursion: Recursion, serial: bool, width: int, fused: bool,
        at: Callable[[str, Int], str],
    ) -> None:  # fmt: skip
        self.f = f
        self.recursion = recursion
        self.serial = serial
        self.width = width
        self.fused = fused
        self.at = at
        self.layout = TableLayout(recursion)
        self.carry = {(name, k): f.slot(width) for name, places in recursion.carried.items() for k in places}
        self.bodies = f.load_int(f.offset("%tables", Header.BODIES))
        self.branches = f.offset("%scratch", self.bodies * (self.layout.row_size * width))

    def emit(self) -> None:
        """Emit all sweeps."""
        f = self.f
        for sweep in self.recursion.sweeps:
            sort = DOWN if sweep.outward else UP
            names = {name for step in sweep.steps for name in step.places if name in sort}
            moved = [place for place in self.carry if place[0] in names]
            self._begin(sweep, moved)
            with f.count(self.bodies, down=not sweep.outward) as i:
                row = f.offset("%tables", i * int(TableRow.SIZE) + int(Header.SIZE))
                own = f.offset("%scratch", i * (self.layout.row_size * self.width))
                self._arrive(sweep, moved, row)
                self._body(sweep, row, own)
                self._depart(sweep, moved, row)

    # -- memory ---------------------------------------------------------------------------------------
    def _load(self, base: str, place: int) -> Value:
        return self.f.load(self.f.offset(base, place * self.width), self.width, 8 * self.width)

    def _store(self, value: Value | float, base: str, place: int) -> None:
        lifted = self.f.lift(value, self.width)
        self.f.store(lifted, self.f.offset(base, place * self.width), 8 * self.width)

    def _slot(self, number: Int | int) -> str:
        f = self.f
        size = self.layout.slot_size * self.width
        return f.offset(self.branches, number * size)

    def _load_carry(self, place: Place) -> Value:
        return self.f.load(self.carry[place], self.width, 8 * self.width)

    def _store_carry(self, value: Value | float, place: Place) -> None:
        self.f.store(self.f.lift(value, self.width), self.carry[place], 8 * self.width)

    # -- from body to body ----------------------------------------------------------------------------
    def _begin(self, sweep: BodySweep, moved: Sequence[Place]) -> None:
        """Set the carry to what the base gives, or to nothing, and the branch slots likewise."""
        f = self.f
        for name, k in moved:
            start: Value | float = 0.0
            if name == "motion":
                start = f.splat(f.load(f.offset("%tables", Header.BASE_MOTION + k)), self.width)
            self._store_carry(start, (name, k))
            if sweep.outward and not self.serial:
                self._store(start, self._slot(0), self.layout.slot[name, k])
        if not sweep.outward and not self.serial:
            with f.count(f.load_int(f.offset("%tables", Header.SLOTS))) as s:
                for place in moved:
                    self._store(0.0, self._slot(s), self.layout.slot[place])

    def _arrive(self, sweep: BodySweep, moved: Sequence[Place], row: str) -> None:
        """Outward: take the parent's quantities from its slot. Inward: add what earlier children left."""
        if self.serial:
            return
        f = self.f
        number = f.load_int(f.offset(row, TableRow.PARENT_SLOT if sweep.outward else TableRow.OWN_SLOT))
        with f.when(f.compare_int("sge", number, 0)):
            slot = self._slot(number)
            for place in moved:
                value = self._load(slot, self.layout.slot[place])
                self._store_carry(value if sweep.outward else self._load_carry(place) + value, place)

    def _depart(self, sweep: BodySweep, moved: Sequence[Place], row: str) -> None:
        """Outward: leave a copy for later children. Inward: leave the parent's share where it is not next."""
        if self.serial:
            return
        f = self.f
        number = f.load_int(f.offset(row, TableRow.OWN_SLOT if sweep.outward else TableRow.PARENT_SLOT))
        with f.when(f.compare_int("sge", number, 0)):
            slot = self._slot(number)
            for place in moved:
                value = self._load_carry(place)
                if not sweep.outward:
                    value = value + self._load(slot, self.layout.slot[place])
                    self._store_carry(0.0, place)
                self._store(value, slot, self.layout.slot[place])

    # -- one body -------------------------------------------------------------------------------------
    def _body(self, sweep: BodySweep, row: str, own: str) -> None:
        """Emit the step of the body's kind; no choice where there is one kind."""
        f = self.f
        if len(sweep.steps) == 1:
            self._step(sweep, sweep.steps[0], row, own)
            return
        labels = [f.label("kind") for _ in sweep.steps]
        after = f.label("after")
        kind = f.load_int(f.offset(row, TableRow.KIND))
        cases = " ".join(f"i64 {k}, label %{label}" for k, label in enumerate(labels))
        f.raw(f"switch i64 {kind.ref}, label %{labels[0]} [ {cases} ]")
        for step, label in zip(sweep.steps, labels):
            f.place(label)
            self._step(sweep, step, row, own)
            f.jump(after)
        f.place(after)

    def _step(self, sweep: BodySweep, step: BodyStep, row: str, own: str) -> None:
        f = self.f
        columns = {"q": f.load_int(f.offset(row, TableRow.Q))}
        columns["v"] = columns["x"] = columns["out"] = f.load_int(f.offset(row, TableRow.V))
        inputs: dict[str, list[Value]] = {}
        nothing = f.constant(0.0, self.width)
        for group, places in _used(step.program).items():
            inputs[group] = [
                self._input(group, k, row, own, columns) if k in places else nothing
                for k in range(max(places) + 1)
            ]
        for group, values in lower(f, step.program, inputs, self.width, self.fused).items():
            for k, value in zip(step.places[group], values):
                if group == "out":
                    f.store(f.splat(value, self.width), self.at(group, columns[group] + k))
                elif group == "kept":
                    self._store(value, own, self.layout.kept(k))
                elif group in UP and sweep.outward:
                    self._store(value, own, self.layout.start[group, k])
                else:
                    self._store_carry(f.splat(value, self.width), (group, k))

    def _input(self, group: str, k: int, row: str, own: str, columns: Mapping[str, Int]) -> Value:
        f = self.f
        if group == "p":
            return f.splat(f.load(f.offset(row, TableRow.CONSTANTS + k)), self.width)
        if group in columns:
            return f.load(self.at(group, columns[group] + k), self.width)
        if group == "kept":
            return self._load(own, self.layout.kept(k))
        value = self._load_carry((group, k))
        if (group, k) in self.layout.start:
            value = value + self._load(own, self.layout.start[group, k])
        return value


def write_sample_kernel(recursion: Recursion, serial: bool, lanes: int, fused: bool) -> str:
    """Return the IR of ``kernel(tables, q, v, x, out, scratch, T)``: column k of an array starts at k T."""
    f = Function("kernel", [*(f"ptr noalias %{a}" for a in ARGUMENTS), "i64 %T"], flags=RELAXED)
    samples = f.int_argument("T")
    start = f.int_slot()

    def at(group: str, column: Int) -> str:
        address = f.offset(f"%{group}", samples * column + f.load_int(start))
        f.prefetch(f.offset(address, BLOCKS_AHEAD * lanes), write=group == "out")
        return address

    loops = BodyLoops(f, recursion, serial, lanes, fused, at)
    with f.blocks(samples, lanes) as t:
        f.store_int(t, start)
        loops.emit()
    f.ret()
    return module([f])


def rolled_function(f: Function, recursion: Recursion, serial: bool, width: int, fused: bool) -> Function:
    """Write ``f(tables, q, v, x, out, scratch)`` for one state of ``width`` lanes (1: a plain state), and return it.

    Entry k of an array is the vector at k * width; vectors are aligned only as doubles. For a stepping loop:
    with ``width`` 1 it is a right-hand side, with more one for as many stages or members at once.
    """
    BodyLoops(f, recursion, serial, width, fused, lambda group, k: f.offset(f"%{group}", k * width)).emit()
    f.ret()
    return f


def tree_function(name: str, **kind: Any) -> Function:
    """Return an empty function of the arguments that ``rolled_function`` takes; ``kind`` as for ``Function``."""
    return Function(name, [f"ptr noalias %{a}" for a in ARGUMENTS], flags=RELAXED, **kind)

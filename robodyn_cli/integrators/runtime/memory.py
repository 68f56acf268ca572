"""What the compiled stepping loop shares with Python: slots of memory, all of it as one block that an earlier moment is
copied from, and the parameters p of a run.
"""

from __future__ import annotations

import enum
from typing import Any, cast

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.kernels.arrays import aligned_zeros
from robodyn_cli.spatial.algebra import Array

FINE = 4e-16  # shortest bracket of an event, relative to its time
UNARMED = 2  # event functions are watched from the side that they are on at the start


class DoubleSlot:
    """Slots of the array of doubles; plain ints, which index faster than members of an enum."""

    T = 0  # current time
    H = 1  # step to try next
    T_END = 2
    RTOL = 3
    ATOL = 4  # of the step that is tried; see ``stepping/jumps.py``
    H_MAX = 5
    SAMPLE_START = 6  # sample k lies at SAMPLE_START + k * SAMPLE_STEP
    SAMPLE_STEP = 7
    T_OLD = 8  # the last accepted step went from T_OLD over H_OLD
    H_OLD = 9
    CONTRACTION = 10  # last ratio of two updates of the iteration in a step; 1 before there is one
    LAST_ERROR = 11  # of the last accepted step, as the step controller keeps it; 1 before there is one
    EVENT_LOW = 12  # bracket of an event
    EVENT_HIGH = 13
    EVENT_GUESS = 14  # where dense output has the event, and the slope of its function there
    EVENT_SLOPE = 15
    DENSE_END = 16  # end and length of the step whose rates the method predicts from, before any event cut it
    DENSE_STEP = 17
    T_REST = 18  # what rounding has left out of T
    T_AFTER = 19  # the stretch between two breakpoints, just inside: formulas of time have values there alone
    T_BEFORE = 20
    NEXT_UPDATE = 21  # instant at which a sampled controller acts next
    SINCE = 22  # when the state was last replaced
    RESTART = 23  # the longest first step behind that
    FIRST = 24  # first steps as a part of the usual ones, see ``Options``
    GIVEN_ATOL = 25  # of the run
    CHECKED = 26  # the next checked step, while one is tried whatever its error; 0 where none is
    ROUNDING = 27  # how far it puts any acceleration off [rad/s^2, m/s^2], where that is measured
    ROUNDED = 28  # what it has made of rates since the run began [rad/s, m/s], at most
    LARGEST = 29  # acceleration since the run began [rad/s^2, m/s^2], where rounding is measured
    SIZE = 30  # event function values follow, then what closings note


class IntegerSlot:
    """Slots of the array of 64-bit integers."""

    ACCEPTED = 0
    REJECTED = 1
    EVALUATIONS = 2  # evaluations of the right-hand side, a vector of lanes counted as one
    MAX_STEPS = 3
    NEXT_SAMPLE = 4
    LAST_SAMPLE = 5
    CAPACITY = 6  # rows in the output block
    ROWS = 7  # rows written since the block was last emptied
    EVENT = 8  # which event function changed sign
    WATCH = 9  # whether to look for events: 0, 1 or ``UNARMED``
    REJECTED_IN_ROW = 10
    PROJECTIONS = 11
    VELOCITIES = 12  # how many there are, for code that serves systems of any size
    LOCATED = 13  # see ``Location``
    RATE_KNOWN = 14  # the method has the rate at the current state; not after anybody changed anything
    UPDATES = 15  # periods of a sampled controller that are done
    PHASE = 16  # which phase of the present one comes next
    SIZE = 17


class Note:
    """What is noted of each latch of ``System.closings``; the state before the last closing follows behind them all."""

    TIME = 0  # when it closed; not a number: it has not
    ANGLE = 1  # of its coordinate
    SPEED = 2  # before it closed
    LOST = 3  # energy
    IMPULSE = 4
    NEAREST = 5  # how near it has come, at events, and when
    NEAREST_TIME = 6
    SIZE = 7


class Status(enum.IntEnum):
    """Why the loop returned."""

    DONE = 0
    FULL = 1  # the output block is full: empty it and call again
    EVENT = 2  # an event lies in the step that starts at the current state; nothing was committed
    MAX_STEPS = 3
    STEP_TOO_SMALL = 4
    NOT_FINITE = 5
    NOT_SOLVED = 6  # the equations of a step whose length is fixed
    FAILED = 7  # a controller's function in Python has raised an error
    HALTED = 8  # a latch has closed, behind which the run ends


class Location(enum.IntEnum):
    """What compiled code has found where dense output saw an event function change its sign."""

    DOUBTFUL = 0  # nothing: several functions change at the same time, or no motion leads there
    EVENT = 1  # the state is at the event of that function alone
    NOTHING = 2  # none has changed its sign up to the state


def resolution(a: float, b: float) -> float:
    """Return the shortest bracket of an event that rounding of these times allows."""
    return FINE * max(abs(a), abs(b))


def first_note(events: int) -> int:
    """Return the slot where the notes of closings begin, behind the values of so many event functions."""
    return DoubleSlot.SIZE + max(1, events)


class LatchAnswer(enum.IntEnum):
    """What has become of an event of a latch in compiled code."""

    DOUBTFUL = 0  # nothing: others close at the same instant
    GOES_ON = 1
    ENDS = 2  # the run, with this closing


ROW = 8  # doubles; each part starts where a vector may


class Memory:
    """The arrays that the compiled loop works on, in one block, and room for a copy of it.

    w, n : see ``DoubleSlot`` and ``IntegerSlot``, as memoryviews, which single numbers enter and leave faster than
    arrays. armed : the values of event functions, which follow the slots in w. notes : see ``Note``, a row a latch. y :
    the state. dense : what dense output keeps. addresses : where w, n, y and dense lie; the block starts with ``w``.
    saved_w, saved_n : w and n of the copy.
    """

    def __init__(self, system: System, dense: int) -> None:
        events, size, closings = len(system.events), system.size, system.closings
        latches = 0 if closings is None else len(closings.first)
        behind = first_note(events) + latches * Note.SIZE + (size if latches else 0)
        counts = (behind, IntegerSlot.SIZE, size, max(1, dense))
        starts = [0]
        for count in counts:
            starts.append(starts[-1] + -(-count // ROW) * ROW)
        self.block, self.saved = aligned_zeros(starts[-1]), aligned_zeros(starts[-1])
        w, n, self.y, self.dense = (self.block[a : a + count] for a, count in zip(starts, counts))
        self.w, self.n, self.armed = _doubles(w), _integers(n), w[DoubleSlot.SIZE : first_note(events)]
        self.notes = w[first_note(events) :][: latches * Note.SIZE].reshape(latches, Note.SIZE)
        self.saved_w, self.saved_n = _doubles(self.saved), _integers(self.saved[starts[1] :])
        self.addresses = tuple(self.block.ctypes.data + 8 * first for first in starts[:-1])
        self.nbytes = self.block.nbytes

    def clear(self) -> None:
        self.block.fill(0.0)


def _doubles(x: Array) -> memoryview[float]:
    return cast("memoryview[float]", x.data)


def _integers(x: Array) -> memoryview[int]:
    return x.view(np.int64).data


class Parameters:
    """p of one run, written in place.

    given : values for all parameters that the partition does not choose. repartitions : how often it has chosen anew.

    Raises
    ------
    ValueError : too few, or too many for the partition, are given.
    """

    def __init__(self, system: System, given: Any) -> None:
        self.partition = partition = system.partition
        self.system = system
        self.repartitions = 0
        programs = (system.positions, system.velocities, system.switching)
        needed = max([system.dynamics.parameters, *(p.inputs.get("p", 0) for p in programs if p is not None)])
        room = len(given) if partition is None else partition.first + partition.count
        if room < needed or (partition is not None and len(given) != partition.first):
            raise ValueError(f"the system has {needed} parameters, got {len(given)}")
        self.values = np.zeros(max(1, room))
        self.values[: len(given)] = given

    def start(self, time: float, state: Array) -> None:
        """Let the partition choose for a run from ``state``."""
        self._choose(time, state, None)

    def repartition(self, time: float, state: Array) -> None:
        """Let the partition choose anew; the motion goes on as it was."""
        self.repartitions += 1
        assert self.partition is not None
        self._choose(time, state, self.values[self.partition.first :].copy())

    def _choose(self, time: float, state: Array, before: Array | None) -> None:
        if self.partition is not None:
            chosen = self.partition.choose(time, self.system.split(state)[0], before)
            self.values[self.partition.first :] = chosen

"""Memory that the compiled stepping loop shares with Python, and what it returns."""

from __future__ import annotations

import enum

FINE = 4e-16  # shortest bracket of an event, relative to its time
UNARMED = 2  # event functions are watched from the side that they are on at the start


class DoubleSlot:
    """Slots of the array of doubles; plain ints, which index faster than members of an enum."""

    T = 0  # current time
    H = 1  # step to try next
    T_END = 2
    RTOL = 3
    ATOL = 4
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
    SIZE = 22  # event function values follow


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
    LOCATED = 13  # the state is at the event that was met, alone
    RATE_KNOWN = 14  # the method has the rate at the current state; not after anybody changed anything
    UPDATES = 15  # periods of a sampled controller that are done
    PHASE = 16  # which phase of the present one comes next
    SIZE = 17


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


def resolution(a: float, b: float) -> float:
    """Return the shortest bracket of an event that rounding of these times allows."""
    return FINE * max(abs(a), abs(b))

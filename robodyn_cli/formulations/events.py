"""Events: functions of time and state whose sign changes end a step, their owners, and how the run goes on.

An event function has an owner. When the function changes its sign, the owner handles the event and returns an
``Outcome``, which says how the run goes on. An integrator knows a function's value, its direction, whether the
right-hand side jumps there, and its owner. Only the owner knows the meaning of the event.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.record import mutable_record, record
from robodyn_cli.spatial.algebra import Array


class EventKind(enum.Enum):
    """What a sign change means. A system has its functions in this order."""

    MARK = "a time to be told"
    RANK_LOSS = "the loops come near a loss of rank"
    PASSAGE = "the loops come near a loss of rank that is to be passed"
    DEAD_POINT = "the input comes to a dead point"
    LATCH = "a latch closes or opens, or its load is largest"
    DISCONTINUITY = "the right-hand side or its slope jumps"
    REPARTITION = "parameters that fit a part of the motion are chosen anew"
    CONTACT = "a joint sticks, slips, meets its stop or leaves it"
    PAYLOAD = "a mass is gripped or released"


# -- outcomes: how the run goes on ------------------------------------------------------------------------------
@record
class Outcome:
    """The run goes on as it was. ends : whether the integrator stops here, and the driver decides what follows."""

    ends = False


@record
class Stop(Outcome):
    """The run ends at the event."""

    ends = True


@record
class Repartition(Outcome):
    """The partition's parameters are chosen anew; the motion goes on as it was."""


@record
class Jump(Outcome):
    """The run goes on from another state at the same time.

    state : x (nx,). parameters : new values of p, or of the first of them, where they change too. sides : the side from
    which the owner's event functions start, by their number among these, where it is known. step : the next step is at
    most so long [s].
    """

    state: Array
    parameters: Array | None = None
    sides: Mapping[int, float] = dataclasses.field(default_factory=dict)
    step: float = math.inf


@record
class Halt(Jump):
    """The run ends at the event, in another state."""

    ends = True


@record
class Leap(Outcome):
    """The run goes on from a later time; what lies between was integrated by the owner.

    states : the states (T, nx) at times (T,) up to ``time`` [s]. state : x (nx,) there.
    """

    ends = True

    time: float
    state: Array
    states: Callable[[Array], Array]


GO_ON = Outcome()
STOP = Stop()
REPARTITION = Repartition()


@record
class LatchClosed:
    """What compiled code has done where a latch closes: the state behind it, its impulse, and the energy lost [J]."""

    state: Array
    impulse: float
    lost: float


# -- functions and owners ---------------------------------------------------------------------------------
class Owner(Protocol):
    """The owner of event functions."""

    def handle(self, event: Event) -> Outcome:
        """Answer an event."""

    def again(self) -> Owner | None:
        """Return the owner of the same functions in a second integration of the motion, None where it need not watch
        them.

        A second integration watches only what changes the motion.
        """


@record
class EventFunction:
    """A scalar whose sign change is an event.

    direction : +1 for rising, -1 for falling, 0 for both. owner : who handles the event; without one the run goes on.
    """

    name: str
    value: Scalar
    direction: int = 0
    kind: EventKind = EventKind.MARK
    owner: Owner | None = None

    def crosses(self, before: float, after: float) -> bool:
        """Tell whether a change from ``before`` to ``after`` counts; zero belongs to neither side."""
        rising = before < 0.0 < after
        falling = before > 0.0 > after
        return (rising and self.direction >= 0) or (falling and self.direction <= 0)

    @property
    def closing(self) -> int | None:
        """The number of the latch of ``System.closings`` that closes where it is zero, None where none does."""
        return None

    @property
    def turns_motion(self) -> bool:
        """Whether the motion goes on otherwise than it does without the event."""
        return self.kind in (EventKind.CONTACT, EventKind.PAYLOAD)

    @property
    def is_discontinuity(self) -> bool:
        """Whether the right-hand side or its slope jumps where the function is zero."""
        return self.kind is EventKind.DISCONTINUITY


@mutable_record
class Event:
    """An event that happened: its function, the index of that among the system's functions, time and state.

    state : x = (q, v, z) of the integrator. time_error : width of the bracket of the time [s].
    parameters : values of p. close : lets compiled code close the latch that closes there, if it can.
    """

    function: EventFunction
    index: int
    time: float
    state: Array
    time_error: float
    parameters: Array = dataclasses.field(default_factory=lambda: np.zeros(0))
    close: Callable[[], LatchClosed | None] = lambda: None

    @property
    def name(self) -> str:
        return self.function.name

    def outcome(self) -> Outcome:
        """Return the owner's answer."""
        owner = self.function.owner
        return GO_ON if owner is None else owner.handle(self)


@record
class Jumped:
    """The sides of an event, where a motion may have jumped: time [s], states (nx,) and parameters before and behind.

    hidden : what follows from the state may jump, and the state does not, so that it is not known of which side it is.
    """

    time: float
    before: Array
    parameters_before: Array
    behind: Array
    parameters_behind: Array
    hidden: bool = False


# -- owners with nothing to decide ------------------------------------------------------------------------
class Passing:
    """Owner of events that only end a step (discontinuities)."""

    def handle(self, event: Event) -> Outcome:
        return GO_ON

    def again(self) -> Owner:
        return self


class Stopping:
    """Owner of events that end the run."""

    def handle(self, event: Event) -> Outcome:
        return STOP

    def again(self) -> None:
        return None

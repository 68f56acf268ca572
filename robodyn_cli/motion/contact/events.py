"""The event functions of joints that stick, slip and meet rigid stops, and of latches; what becomes of a latch."""

from __future__ import annotations

import enum
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from robodyn_cli.algorithms.kinematics import position_rates
from robodyn_cli.equations.latches import LatchRow
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.functions import absolute, where
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.formulations.events import EventFunction, EventKind, Owner
from robodyn_cli.model.model import Model
from robodyn_cli.record import mutable_record, record
from robodyn_cli.summaries.facts import ABSENT, Absent
from robodyn_cli.summaries.motion import LatchLock, LatchLockErrors


class Transition(enum.Enum):
    """What an event function of a joint may lead to."""

    LOWER_STOP = "stop lower"
    UPPER_STOP = "stop upper"
    REST = "rest"
    BREAK_HIGH = "break high"  # the multiplier that holds the joint has come to its upper bound
    BREAK_LOW = "break low"


LEAST_RATE = 1e-13  # rad/s or m/s: what closes a latch and is slower is at rest, and does not turn
HELD = 0  # the state of a joint that is held; the others are the direction of motion, +1 or -1
STOPS = {Transition.LOWER_STOP: 1.0, Transition.UPPER_STOP: -1.0}  # the direction in which the stop pushes


@record
class ContactFunction(EventFunction):
    """An event function of a joint with a contact state. joint : its number among these."""

    joint: int = 0
    transition: Transition = Transition.REST


def contact_functions(problem: Problem, owner: Owner) -> tuple[ContactFunction, ...]:
    """Return the functions whose fall through zero may change the contact state of a joint.

    Rigid stops: the distance. Rest: the rate along the direction of motion. Break: what is left of the bounds of the
    multiplier that holds the joint.
    """
    functions: list[ContactFunction] = []

    def add(number: int, transition: Transition, value: Scalar) -> None:
        name = f"{transition.value} {problem.contact_joints[number].name}"
        functions.append(ContactFunction(name, value, -1, EventKind.CONTACT, owner, number, transition))

    # forces that hold cost the accelerations, which the loops of a long chain do without
    for k, (joint, force) in enumerate(zip(problem.contact_joints, problem.holding)):
        for push, at in joint.stops:
            side = Transition.LOWER_STOP if push > 0.0 else Transition.UPPER_STOP
            add(k, side, push * (problem.q[joint.q] - at))
        if joint.friction is not None:
            add(k, Transition.REST, joint.direction * problem.v[joint.v])
        add(k, Transition.BREAK_HIGH, joint.hold * (joint.high - force))
        add(k, Transition.BREAK_LOW, joint.hold * (force - joint.low))
    return tuple(functions)


def known_sides(
    functions: Sequence[ContactFunction],
    state: Sequence[int],
    rest: Collection[int],
    contact: Mapping[int, float],
    carried: Collection[int],
) -> dict[int, float]:
    """Return the side from which each event function starts, by its number, where that is known.

    state : of each joint. rest : joints at rest. contact : the direction in which a stop pushes a joint.
    carried : joints at rest that others hold.
    """
    sides = {}
    for number, function in enumerate(functions):
        k = function.joint
        held = k in rest
        push = STOPS.get(function.transition)
        if push is not None:
            known = not (held and contact.get(k) == push)
        elif function.transition is Transition.REST:
            known = not held and state[k] != HELD
        else:
            known = held and k not in carried
        if known:
            sides[number] = 1.0
    return sides


# -- latches ------------------------------------------------------------------------------------------------
class LatchChange(enum.Enum):
    """What an event function of a latch tells."""

    CLOSES = "latch"
    OPENS = "release"
    TURNS = "turn"  # of what closes it
    PASSES = "pass"  # its position or formula passes zero the other way
    LARGEST = "largest load"  # of a compliant one
    RESTS = "load at rest"  # from an instant on; no event function tells
    MEETS = "contact"
    LETS_GO = "no load"


@record
class LatchFunction(EventFunction):
    """An event function of a latch, by its number."""

    number: int = 0
    change: LatchChange = LatchChange.CLOSES

    @property
    def turns_motion(self) -> bool:
        return self.change in (LatchChange.CLOSES, LatchChange.OPENS)

    @property
    def closing(self) -> int | None:
        return self.number if self.change is LatchChange.CLOSES else None


@mutable_record
class LatchClosing:
    """What has happened to a latch since it closed last.

    order : 1 for those that closed first, 0 for those that an earlier run has closed, of which nothing is told that was
    before this run. angle, speed : of what it holds, before it closed. lost : energy [J].
    impulse : [N m s or N s]. peak : largest load [N m or N], with its time [s]. has_peaked : whether the load has been
    at a peak, so that this says something. crest : load at its last peak. past : largest load of earlier closings, with
    its time, where that is known.
    redundant : whether others held already what it holds. opened : when, if it has.
    """

    order: int
    time: float | Absent
    angle: float | Absent
    speed: float | Absent
    lost: float | Absent = 0.0
    impulse: float | Absent = ABSENT
    peak: float = 0.0
    peak_time: float = 0.0
    has_peaked: bool = False
    crest: float = math.inf
    past: tuple[float, float] | None = None
    rebounds: int = 0
    redundant: bool = False
    opened: float | Absent = ABSENT
    closings: int = 1

    @property
    def largest(self) -> tuple[float, float] | None:
        """The largest load in the spring over all closings, with its time; None where it is not known."""
        here, past = (self.peak, self.peak_time), self.past
        if self.has_peaked:
            return here if past is None else max(here, past)
        return past if past is not None and past[0] >= self.peak else None

    def described(self, latch: LatchRow, model: Model) -> LatchLock:
        """Return what the summary says of it."""
        known = None if latch.rigid else self.largest
        peak, when = (ABSENT, ABSENT) if known is None else known
        return LatchLock(
            self.order, self.time, self.angle, self.speed, self.lost, self.impulse, peak, when, self.redundant,
            self.rebounds, self.closings, self.opened, LatchLockErrors(), latch.unit(model),
        )  # fmt: skip


DIRECTIONS: Mapping[str, int] = {"up": 1, "down": -1, "either": 0}


def latch_functions(problem: Problem, values: Sequence[Scalar], owner: Owner) -> list[LatchFunction]:
    """Return the event functions of all latches, those at which the equations jump last.

    values : what passes zero where each closes.
    """
    functions: list[LatchFunction] = []

    def add(
        k: int, change: LatchChange, value: Any, direction: int, kind: EventKind = EventKind.LATCH
    ) -> None:
        name = f"{change.value} {problem.latches[k].name}"
        functions.append(LatchFunction(name, value, direction, kind, owner, k, change))

    for k, (latch, value) in enumerate(zip(problem.latches, values)):
        way, is_open = DIRECTIONS[latch.spec.side], 1.0 - latch.closed
        # one that is open in its position has to leave it first: rounding must not close it there
        leaves = (-1.0 if way < 0 else 1.0) * (absolute(value) - latch.near)
        add(k, LatchChange.CLOSES, is_open * where(latch.near, leaves, value), way)
        rate = closing_rate(problem, latch, value)
        if problem.constraints.rheonomic:  # others come to rest at events, exactly
            rate = where(absolute(rate) - LEAST_RATE, rate, 0.0)
        turning = where(latch.near * latch.near, 0.0, rate)
        add(k, LatchChange.TURNS, is_open * turning, 0)
        if way:
            add(k, LatchChange.PASSES, is_open * where(latch.near, 0.0, value), -way)
        if latch.opens is not None:
            add(k, LatchChange.OPENS, latch.closed * latch.opens, 1)
        if not latch.rigid:
            add(k, LatchChange.LARGEST, latch.closed * (_growth(problem, latch) - latch.near), -1)
    for k, latch in enumerate(problem.latches):
        if latch.rigid:
            continue
        delta, rate = latch.depth(problem.q, problem.v)
        add(k, LatchChange.MEETS, latch.closed * delta, 0, EventKind.DISCONTINUITY)
        if latch.spec.hold.damping != 0.0:
            add(k, LatchChange.LETS_GO, latch.closed * latch.law(delta, rate), 0, EventKind.DISCONTINUITY)
    return functions


def closing_rate(problem: Problem, latch: LatchRow, value: Scalar) -> Any:
    """Return the rate of what passes zero where a latch closes."""
    if latch.closing is not None:
        return problem.v[latch.closing]
    inputs = free_symbols([value])
    rates: dict[str, Any] = {
        "q": position_rates(problem.model, problem.q, problem.v),
        "t": [1.0],
        "v": (),
    }
    if any(e.value[1] == "v" for e in inputs):
        rates["v"] = problem.forward.qdd
    moving = [e for e in inputs if e.value[1] in rates]
    return directional([value], moving, [rates[e.value[1]][e.value[2]] for e in moving])[0]


def _growth(problem: Problem, latch: LatchRow) -> Any:
    """Return the rate of k delta + c delta-dot; accelerations enter where there is a damper."""
    speed = latch.direction * latch.rate(problem.v)
    if latch.spec.hold.damping == 0.0:
        return latch.spec.hold.stiffness * speed
    return latch.law(speed, latch.direction * latch.rate(problem.forward.qdd))

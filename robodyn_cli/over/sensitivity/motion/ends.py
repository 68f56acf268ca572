"""How what a motion ends with changes with keys."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.closings import closing_alone
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.error import First, first_attempt
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.many.keys import OPTION, Key
from robodyn_cli.over.sensitivity.motion.constrained import ConstraintSlopes
from robodyn_cli.over.sensitivity.motion.course import (
    BESIDE,
    SIDE,
    Switch,
    Updated,
    follow,
    parts_of,
    plain_states,
    refuse,
    step_times,
    switches_of,
)
from robodyn_cli.over.sensitivity.motion.start import start_slopes
from robodyn_cli.over.sensitivity.motion.variational import (
    EndSlopes,
    Linearised,
    Slopes,
    SlopesAtEnd,
    StatePoint,
    Variational,
    nodes_of,
    transfers,
)
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

BLOCKS = 3  # of samples in each step of the integrator, at first
MOST = 96  # blocks in a step
AGREES = 1e-9  # relative difference of two solutions at which the finer one is taken
GAINS = 2.0  # by which a difference falls when blocks are halved; where it falls less the tolerance decides
JUMPS = 1e-9  # part of the largest rate from which on rates jump at a switch
ZERO = 1e-8  # part of the time of the motion, within which a function of time is zero
GRAZES = (
    1e-9  # part of the largest rate of a switching function, below which the motion only touches the switch
)
PART = 1e-3  # of the largest derivative of its kind, with which a smaller one is compared
ROUNDING = 1e-13
FORMULAS = ("torques.", "forces.", "parameters.", "prescribed.", "robot.")  # what may hold formulas of time


@record
class Ending:
    """Where a motion ends, or is looked at: time [s] and its error; if an event ends it, what is zero there.

    figures : whose derivatives there are wanted. All are of the integrator's symbols. lasts : whether a key that is the
    duration moves it. closes : number of the latch that closes there; figures see it closed.
    """

    time: float
    function: Scalar | None = None
    figures: tuple[Scalar, ...] = ()
    doubt: float = 0.0
    lasts: bool = True
    closes: int | None = None


class MotionSlopes:
    """The derivatives of a motion's end by keys, whose numbers are at ``places``, empty of keys that have none.

    ``seen`` are the figures of the ending and their rates, once derivatives have been found.

    Raises
    ------
    CapabilityError : the motion, or its start, has no derivatives that can be computed exactly.
    """

    seen: tuple[list[float], list[float]]

    def __init__(self, motion: Motion, keys: Sequence[Key], places: Sequence[str], ending: Ending) -> None:
        refuse(motion)
        self.motion, self.places = motion, places
        # keys that are the time of the end
        self._lasting = np.array([float(key.sort == OPTION) for key in keys])
        self.variational = Variational(motion, places)
        self.constraints = ConstraintSlopes(motion.problem, self.variational)
        self.updates = Updated(motion, self.variational)
        self.start = self.updates.begun(start_slopes(motion, self.variational, keys))
        self.until(ending)

    def until(self, ending: Ending) -> None:
        """Integrate the motion to where it is to end now, to see its switches and steps, between which it is smooth."""
        self.ending, motion, end = ending, self.motion, ending.time
        self.steps = step_times(motion, end)
        first = First(motion.options, motion.choice.method, np.array([len(self.steps) + 1]), np.array([end]))
        tighter = first_attempt(first).alone
        self.tighter = dataclasses.replace(tighter, max_steps=motion.options.max_steps)
        self.switches = switches_of(motion, end, self.tighter)
        # a sample at the end of a sampled motion would show what an update at the end has set
        whole = motion.system.updates is None and motion.system.closings is None
        self.last = end if whole else end * (1.0 - BESIDE)

    def parts(self, blocks: int) -> list[tuple[float, float, bool]]:
        """Return the smooth parts of the motion, see ``parts_of``, for so many blocks in each.

        What a first order leaves beside a switch grows with the square of the way there. That way is shorter with more
        blocks, so that the difference of two solutions sees it.
        """
        return parts_of(self.last, self.switches, self.steps, SIDE * math.sqrt(MOST / blocks))

    def found(self) -> tuple[EndSlopes, EndSlopes]:
        """Return the derivatives and their estimated errors.

        The error is the difference from a solution on half as many blocks along a motion with a looser tolerance.
        """
        motion = self.motion
        # updates of a controller end steps long before they are as long as the motion allows
        blocks, last = 1 if 2 * len(self.switches) > len(self.parts(MOST)) else BLOCKS, math.inf
        before = self.once(motion.options, blocks)
        while True:
            blocks *= 2
            finer = self.once(self.tighter, blocks)
            apart = np.abs(finer.values - before.values)
            worst = float(np.max(apart / self._scales(finer.sizes)))
            if worst <= AGREES or worst > last / GAINS or 2 * blocks > MOST:
                break
            before, last = finer, worst
        if last < math.inf:  # both were along the tighter motion: its error is not in their difference
            apart = np.abs(finer.values - self.once(motion.options, blocks // 2).values)
        rounding = ROUNDING * np.sqrt(len(self.parts(blocks)))  # of each part, by chance
        errors = np.maximum(apart, rounding * finer.sizes) + finer.doubts
        return self._rows(finer.values), self._rows(errors)

    def _scales(self, sizes: Array) -> Array:
        """Return what differences of derivatives are compared with, from the sizes of their terms.

        A row that is zero but for rounding is compared with the others of its kind.
        """
        nq, nv, scales = self.motion.problem.model.nq, self.motion.problem.model.nv, sizes.copy()
        kinds = [slice(0, 1), slice(1, 1 + nq), slice(1 + nq, 1 + nq + nv)]
        kinds += [slice(k, k + 1) for k in range(1 + nq + nv, len(sizes))]
        for rows in kinds:
            largest = sizes[rows].max(axis=0)
            scales[rows] = np.maximum(np.maximum(sizes[rows], PART * largest), 1e-300)
        return scales

    def _rows(self, rows: Array) -> EndSlopes:
        nq, n = self.motion.problem.model.nq, 1 + self.motion.problem.model.nq + self.motion.problem.model.nv
        return EndSlopes(rows[0], rows[1 : 1 + nq], rows[1 + nq : n], rows[n:])

    def once(self, options: Options, blocks: int) -> SlopesAtEnd:
        """Return the derivatives from one integration, with so many blocks of samples in each part of the motion."""
        course = follow(self.motion, options, self.parts(blocks), blocks)
        x = plain_states(self.motion.system, self.variational.system, course.x)
        along, nodes = self.variational.along(course.t, x, course.p), nodes_of(course.samples)
        lengths = course.t[nodes[:, -1]] - course.t[nodes[:, 0]]
        ways, shares = transfers(along.A[nodes], along.B[nodes], lengths, along.nq)
        last = nodes[:, -1]
        self.constraints.keep(ways, shares, course.t[last], x[last], course.p[last])
        switches = dict(zip((k * blocks for k in course.switched), self.switches))
        updates = self.updates.along(switches, along, last)
        S = self.start
        for k, (way, share) in enumerate(zip(ways, shares)):
            if k in switches:
                S = self._over(switches[k], along, int(last[k - 1]), S, updates.get(k))
            S = way @ S + share
        return self._at_end(along.point(-1, S), course.p[-1])

    def _over(
        self, switch: Switch, along: Linearised, last: int, S: Array, update: tuple[Array, Array] | None
    ) -> Array:
        """Return S (nx, K) at the sample behind a switch, from that at the ``last`` sample before it."""
        before, behind = self._at_switch(switch, along.point(last, S)), last + 1
        away = float(along.t[behind]) - before.t
        if (p := switch.behind) is not None:
            S = self._latched(switch, p, before, along.point(behind, S).moved(-away).rate)
            return along.point(behind, S).moved(away).S
        S = before.S if update is None else self.updates.over(before.S, *update)
        if switch.functions or switch.update is None:
            jump = before.rate - along.point(behind, S).moved(-away).rate
            S = S + np.outer(jump, self._shift(switch, before, jump))
        return along.point(behind, S).moved(away).S

    def _at_switch(self, switch: Switch, before: StatePoint) -> StatePoint:
        """Return the point at which this integration comes to a switch, a little before or after the first one did."""
        before = before.moved(switch.time - before.t)
        if not switch.of_state:
            return before
        at = self.variational.slopes(switch.functions, before.t, before.x)
        try:
            pace = self._pace(at, before.rate)
        except CapabilityError:  # whoever needs to know when that is asks again
            return before
        return before.moved(-float(at.values[0]) / pace)

    def _latched(self, switch: Switch, p: Array, before: StatePoint, rate: Array) -> Array:
        """Return S (nx, K) behind the closing of a latch, x+ = h(x-, k), with p and x-dot there.

        S+ = h_x (S- + x-dot- dt/dk) + h_k - x-dot+ dt/dk
        """
        at = self.variational.slopes(switch.functions, before.t, before.x)
        shift = -(at.keys[0] + at.state[0] @ before.S) / self._pace(at, before.rate)
        jump = self.variational.slopes(self._struck, before.t, before.x, p=p)
        S = before.S + np.outer(before.rate, shift)
        own, new = list(self.variational.system.v_places), S.copy()
        new[own] = jump.state @ S + jump.keys
        return new - np.outer(rate, shift)

    @cached_property
    def _struck(self) -> tuple[Scalar, ...]:
        """The rates behind the closing of a latch."""
        return tuple(closing_alone(self.motion.problem)["v"])

    def _shift(self, switch: Switch, before: StatePoint, jump: Array) -> Array:
        """Return the derivatives of the time of a switch by keys (K,); zero where the rates do not jump there.

        Raises
        ------
        CapabilityError : it is not known what they are.
        """
        if np.abs(jump).max() <= JUMPS * max(np.abs(before.rate).max(), 1e-300):
            return np.zeros(len(self.places))
        for function in switch.functions:
            at = self.variational.slopes([function], before.t, before.x)
            if switch.of_state or self._is_zero(at):
                return -(at.keys[0] + at.state[0] @ before.S) / self._pace(at, before.rate)
        if any(place.startswith(FORMULAS) for place in self.places):
            raise CapabilityError("rates jump at a time of which it is not known how it depends on the keys")
        return np.zeros(len(self.places))

    def _is_zero(self, at: Slopes) -> bool:
        """Tell whether a function of time is zero at a breakpoint."""
        return abs(float(at.values[0])) <= ZERO * self.ending.time * abs(float(at.time[0]))

    def _at_end(self, end: StatePoint, p: Array) -> SlopesAtEnd:
        """Return the derivatives at the end; this integration may come to its event a little before or after the first
        one.
        """
        plain, function = self.variational.system, self.ending.function
        if self.ending.closes is not None:
            row, p = self.motion.problem.latches[self.ending.closes], p.copy()
            p[row.place : row.place + 2] = 1.0  # closed, and it holds
        shift = self._lasting * self.ending.lasts
        if function is None:
            end = end.moved(self.ending.time - end.t)
        else:
            at = self.variational.slopes([function], end.t, end.x)
            end = end.moved(-float(at.values[0]) / self._pace(at, end.rate))
        (S, sizes), terms = self.constraints.end(end, p), np.abs(shift)
        if function is not None:
            at = self.variational.slopes([function], end.t, end.x)
            pace = self._pace(at, end.rate)
            shift = -(at.keys[0] + at.state[0] @ S) / pace
            terms = (np.abs(at.keys[0]) + np.abs(at.state[0]) @ np.abs(S)) / abs(pace)
        of_time = np.outer(end.rate, shift)
        places = [*plain.q_places, *plain.v_places]
        figures, at_end = self.ending.figures, dataclasses.replace(end, S=S)
        own = self.variational.figures(figures, at_end, shift, (sizes, terms), p)
        later = end.moved(self.ending.doubt)
        later = dataclasses.replace(later, S=S + later.S - end.S)
        moved = self.variational.figures(figures, later, shift, (sizes, terms), p)
        self.seen = own.values.tolist(), own.rates.tolist()
        values, sizes = S + of_time, sizes + np.abs(of_time)
        doubts = np.zeros_like(values[places])
        return SlopesAtEnd(
            np.vstack([shift, values[places], own.slopes]), np.vstack([terms, sizes[places], own.sizes]),
            np.vstack([0.0 * shift, doubts, np.abs(moved.slopes - own.slopes)]),
        )  # fmt: skip

    @staticmethod
    def _pace(at: Slopes, rate: Array) -> float:
        """Return how fast a switching function changes along the motion.

        Raises
        ------
        CapabilityError : it hardly does.
        """
        parts = at.state[0] * rate
        pace = float(at.time[0] + parts.sum())
        if abs(pace) <= GRAZES * max(np.abs(parts).max(initial=0.0), abs(at.time[0]), 1e-300):
            raise CapabilityError("the motion only touches a switch")
        return pace

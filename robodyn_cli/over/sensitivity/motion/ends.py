"""How the state of a motion at t = 0, and what it ends with, change with keys."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.closings import closing_alone
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.error import First, first_attempt
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.many.keys import OPTION, START, Key
from robodyn_cli.over.sensitivity.motion.constrained import ConstraintSlopes
from robodyn_cli.over.sensitivity.motion.course import (
    BESIDE,
    Switch,
    Updated,
    follow,
    parts_of,
    plain_states,
    refuse,
    step_times,
    switches_of,
)
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
from robodyn_cli.ready.prepare import held_columns, initial_positions
from robodyn_cli.record import record
from robodyn_cli.solve.closure import rank
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.led import position_columns, velocity_columns

STAYED = 1e-9  # of a given value: farther, the assembly has moved it to close the loops
CLOSES = 1e-8  # of the change of the constraints that a change of the state must take up


def start_slopes(motion: Motion, variational: Variational, keys: Sequence[Key]) -> Array:
    """Return dx/dk (nx, K) at t = 0, in the variational system's coordinates.

    Raises
    ------
    CapabilityError : the start does not depend smoothly on the keys, or the way that closes the loops decides about it.
    """
    model, system = motion.problem.model, variational.system
    given_q, given_v = (given_slopes(names, group, keys)
                        for names, group in ((model.q_names, "q"), (model.v_names, "qd")))  # fmt: skip
    if motion.problem.constraints.rows:
        if system.layout is not None:
            raise CapabilityError("loops of joints with quaternions are closed by differences")
        return _closed(motion, variational, given_q, given_v)
    S = np.zeros((system.size, len(keys)))
    S[list(system.q_places)], S[list(system.v_places)] = given_q, given_v
    if system.layout is not None and np.any(given_q):
        raise CapabilityError("positions of joints with quaternions are made of unit length")
    return S


def _closed(motion: Motion, variational: Variational, given_q: Array, given_v: Array) -> Array:
    """Return dx/dk (nx, K) at a start with closed loops."""
    problem, start, system = motion.problem, motion.assembled, variational.system
    closing = Closing(problem, start.q, start.v)
    x = system.join(start.q, start.v)
    dq = closing.positions(given_q, variational.slopes(closing.rows.eta, 0.0, x).keys)
    rate = variational.slopes(closing.rows.velocity_residual(problem.v), 0.0, x)
    dv = closing.rates(given_v, rate.keys + rate.state[:, : system.nq] @ dq)
    return np.concatenate([dq, dv, np.zeros((system.size - 2 * system.nq, dq.shape[1]))])


def given_slopes(names: Sequence[str], group: str, keys: Sequence[Key]) -> Array:
    """Return the derivatives of what is given of the start (n, K), by its own keys."""
    slopes = np.zeros((len(names), len(keys)))
    for k, key in enumerate(keys):
        if key.sort == START and key.place.startswith(f"{group}."):
            slopes[names.index(key.place.partition(".")[2]), k] = 1.0
    return slopes


class Closing:
    """How a closed state q, v (nv,) of a mechanism whose joints have q-dot = v follows from what is given of it."""

    def __init__(self, problem: Problem, q: Array, v: Array) -> None:
        self.problem, self.scene, self.q, self.v = problem, problem.scene, q, v
        self.rows = problem.all_constraints
        self.psi = problem.numbers(self.rows.psi(problem.model.nv), q)

    def positions(self, given: Array, eta_change: Array) -> Array:
        """Return dq (nv, K) from the changes of what is given of it, and those of eta (m, K) with the keys alone."""
        return self._solved(given, eta_change, self._unknown_positions())

    def rates(self, given: Array, change: Array) -> Array:
        """Return dv (nv, K); ``change`` : of Psi v + eta_t (m, K) with keys and positions."""
        return self._solved(given, change, self._unknown_rates())

    def _solved(self, given: Array, change: Array, unknown: Sequence[int]) -> Array:
        """Return the change (nv, K) of all coordinates: the given one, and what takes up the change of the rows."""
        solved = given.copy()
        solved[unknown] = 0.0
        right = change + self.psi @ solved
        columns = self.psi[:, unknown]
        solved[unknown] = -(np.linalg.pinv(columns, rcond=RANK_TOLERANCE) @ right)
        left = np.abs(right + columns @ solved[unknown]).max(axis=0, initial=0.0)
        scale = np.abs(right).max(axis=0, initial=0.0)
        if np.any(left > CLOSES * np.maximum(scale, 1e-300)):
            raise CapabilityError("with another value of a key the loops do not close")
        return solved

    def _unknown_positions(self) -> list[int]:
        """Return the coordinates that close the loops, where they do it in one way."""
        model, scene = self.problem.model, self.scene
        led = set(position_columns(scene.prescribed))
        held = set(held_columns(scene, self.problem)) - led
        given = initial_positions(scene, self.problem)
        free = [k for k, name in enumerate(model.q_names) if name not in held]
        if self._is_unique(free):
            return free
        missing = [k for k, name in enumerate(model.q_names) if name not in given or name in led]
        moved = [abs(self.q[k] - given[name]) for k, name in enumerate(model.q_names) if k not in missing]
        if max(moved, default=0.0) <= STAYED and missing and self._is_unique(missing):
            return missing
        raise CapabilityError(
            "nothing decides which coordinates close the loops; hold the others (initial.hold)"
        )

    def _unknown_rates(self) -> list[int]:
        """Return the coordinates whose rates follow from the others, where they do in one way or all is at rest."""
        model, scene = self.problem.model, self.scene
        led = set(velocity_columns(scene.prescribed))
        given = set(scene.initial.qd)
        hold = set(held_columns(scene, self.problem))
        v = np.array([scene.initial.qd.get(name, 0.0) for name in model.v_names])
        for fixed in (given | (hold - led), given, set[str]()):
            unknown = [k for k, name in enumerate(model.v_names) if name not in fixed]
            kept = [k for k in range(model.nv) if k not in unknown]
            if np.any(np.abs(self.v[kept] - v[kept]) > STAYED * (1.0 + np.abs(v[kept]))):
                continue
            if self._is_unique(unknown) or not np.any(self.v):
                return unknown
        raise CapabilityError(
            "nothing decides which rates follow from the loops at the start; give the others (initial.qd)"
        )

    def _is_unique(self, unknown: Collection[int]) -> bool:
        """Tell whether the rows determine these coordinates."""
        columns = list(unknown)
        return bool(columns) and rank(self.psi[:, columns], RANK_TOLERANCE) == len(columns)


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
        self.switches = switches_of(motion, end)
        steps = step_times(motion, end)
        first = First(motion.options, motion.choice.method, np.array([len(steps) + 1]), np.array([end]))
        tighter = first_attempt(first).alone
        self.tighter = dataclasses.replace(tighter, max_steps=motion.options.max_steps)
        # a sample at the end of a sampled motion would show what an update at the end has set
        whole = motion.system.updates is None and motion.system.closings is None
        last = end if whole else end * (1.0 - BESIDE)
        self.parts = parts_of(last, self.switches, steps)

    def found(self) -> tuple[EndSlopes, EndSlopes]:
        """Return the derivatives and their estimated errors.

        The error is the difference from a solution on half as many blocks along a motion with a looser tolerance.
        """
        motion = self.motion
        # updates of a controller end steps long before they are as long as the motion allows
        blocks, last = 1 if 2 * len(self.switches) > len(self.parts) else BLOCKS, math.inf
        before = self.once(motion.options, blocks)
        while True:
            blocks *= 2
            finer = self.once(self.tighter, blocks)
            apart = np.abs(finer.values - before.values)
            worst = float(np.max(apart / self._scales(finer.sizes)))
            if worst <= AGREES or worst > last / GAINS or 2 * blocks > MOST:
                break
            before, last = finer, worst
        errors = np.maximum(apart, ROUNDING * finer.sizes) + finer.doubts
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
        course = follow(self.motion, options, self.parts, blocks)
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
        before = along.point(last, S)
        before = before.moved(switch.time - before.t)
        if (p := switch.behind) is not None:
            behind = along.point(last + 1, S)
            away = behind.t - switch.time
            S = self._latched(switch, p, before, behind.moved(-away).rate)
            return along.point(last + 1, S).moved(away).S
        S = before.S if update is None else self.updates.over(before.S, *update)
        behind = along.point(last + 1, S)
        away = behind.t - switch.time
        if switch.functions or switch.update is None:
            jump = before.rate - behind.moved(-away).rate
            S = S + np.outer(jump, self._shift(switch, before, jump))
        return along.point(last + 1, S).moved(away).S

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

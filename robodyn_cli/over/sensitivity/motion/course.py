"""The course of a motion as its variational equations see it: smooth stretches, and the switches between them.

How sensitivities go over the updates of a sampled controller, z+ = u(t, q, v, z-, k) at known instants:

S_z+ = u_x S- + u_k,   S_q and S_v as they are
"""

from __future__ import annotations

import dataclasses
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.control.control import NOISE
from robodyn_cli.equations.discontinuities import is_of_time
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.events import (
    Event,
    EventFunction,
    EventKind,
    Jump,
    Jumped,
    Leap,
    Outcome,
    Owner,
)
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.contact.latch_states import LatchStates
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.method import supervisor_for
from robodyn_cli.motion.motion import Motion
from robodyn_cli.motion.second_run import watched_again
from robodyn_cli.over.sensitivity.gradients import Gradients
from robodyn_cli.over.sensitivity.motion.variational import NEW, Linearised, Variational
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

# part of the time by which samples stay on their own side of a switch; S changes by about as little over it
BESIDE = 1e-10
SIDE = 10.0  # times as far as integrations come to a switch apart, by which samples stay on their own side at least
SHORTEST = 1e-3  # part of the way between switches: a shorter step is no part of its own


@record
class Switch:
    """A time [s] at which the rates may jump, and the functions that may be zero there, in the integrator's symbols.

    of_state : whether the motion comes to the switch, or the clock. update : number and phase of the update of a
    sampled controller at that time, None where there is none. behind : parameters p behind the closing of a latch, None
    where none closes. apart : how far from each other two integrations come to it [s].
    """

    time: float
    functions: tuple[Scalar, ...]
    of_state: bool
    update: tuple[int, int] | None = None
    behind: Array | None = None
    apart: float = 0.0


@record
class StateCourse:
    """Samples of a motion, part by part: times (N,), states (N, nx), parameters (N, np), and how many each part has,
    8 blocks + 1.

    switched : the parts that a switch comes before.
    """

    t: Array
    x: Array
    p: Array
    samples: tuple[int, ...]
    switched: tuple[int, ...]


def refuse(motion: Motion) -> None:
    """Refuse motions that jump, or whose controller has no derivative.

    Raises
    ------
    CapabilityError
    """
    if motion.problem.is_held and motion.system.closings is None:
        raise CapabilityError("joints stick, slip, meet rigid stops or latch")
    control = motion.problem.control
    if control is None:
        return
    if control.function is not None:
        raise CapabilityError("a function in Python controls the motion")
    if control.controller.sensors.resolution:
        raise CapabilityError("encoders round what the controller sees")


def switches_of(motion: Motion, end: float, tighter: Options) -> list[Switch]:
    """Return the switches of a motion before ``end`` [s], in order. tighter : options of a second integration.

    Raises
    ------
    CapabilityError : the motion leaps over a singular pose, or the second integration meets other switches.
    """
    switching, t = motion.problem.switching, motion.problem.t
    of_time = tuple(g for _, g in switching.switches if is_of_time(g, t)) if motion.system.breakpoints else ()
    by_time = [Switch(time, of_time, False) for time in motion.system.breakpoints if 0.0 < time < end]
    by_time = sorted(
        [*by_time, *_apart(motion, end, tighter), *_updates(motion, end)], key=lambda switch: switch.time
    )
    return _together(by_time, 4.0 * BESIDE * end)


def _updates(motion: Motion, end: float) -> list[Switch]:
    """Return the updates of a sampled controller behind t = 0, whose first belongs to the start."""
    updates = motion.system.updates
    switches: list[Switch] = []
    time = 0.0
    while updates is not None:
        number, phase, time = updates.after(time)
        if time >= end * (1.0 - 4.0 * BESIDE):
            break
        switches.append(Switch(time, (), False, (number, phase)))
    return switches


def _together(switches: Sequence[Switch], near: float) -> list[Switch]:
    """Return switches with those by the clock that come at one time as one."""
    merged: list[Switch] = []
    for switch in switches:
        last = merged[-1] if merged else None
        if last is None or switch.time - last.time > near or last.of_state or switch.of_state:
            merged.append(switch)
            continue
        if last.update is not None and switch.update is not None:
            raise CapabilityError("two updates of the controller come at one time")
        both = last.functions + switch.functions
        merged[-1] = dataclasses.replace(last, functions=both, update=last.update or switch.update)
    return merged


def _apart(motion: Motion, end: float, tighter: Options) -> list[Switch]:
    """Return the switches that depend on the state, and how far from them another integration comes to them."""
    first = _met(motion, motion.options, end)
    if not first:
        return []
    second = _met(motion, tighter, end)[: len(first)]  # it may come to one at the end a little earlier
    if [one.functions for one in first] != [two.functions for two in second]:
        raise CapabilityError("the motion only touches a switch")
    return [dataclasses.replace(two, apart=abs(two.time - one.time)) for one, two in zip(first, second)]


def _met(motion: Motion, options: Options, end: float) -> list[Switch]:
    """Return the switches that depend on the state, by integrating the motion."""
    system, watchers = watched_again(motion)
    if all(e.kind is EventKind.REPARTITION for e in system.events):
        return []
    met: list[Switch] = []
    noting = {id(e.owner): _Noting(e.owner, met) for e in system.events if e.owner is not None}

    def owner_of(function: EventFunction) -> Owner | None:
        own = function.kind is EventKind.REPARTITION or isinstance(function.owner, LatchStates)
        return function.owner if own else noting.get(id(function.owner))

    driver = Driver(
        system.watched_by(owner_of), motion.choice.method, options, watchers,
        supervisor_for(motion.choice),
    )  # fmt: skip
    driver.met = []
    driver.start(0.0, motion.start)
    driver.run(end, Grid(end, 0.0, 0), lambda t, x: None)
    last = end * (1.0 - BESIDE)  # a latch that closes there ends the motion
    return [
        s
        for s in [*met, *_closings(motion, driver.met)]
        if 0.0 < s.time < (end if s.behind is None else last)
    ]


def _closings(motion: Motion, met: Sequence[Jumped]) -> list[Switch]:
    """Return the closings of latches among what a motion has met.

    Raises
    ------
    CapabilityError : several close together.
    """
    switches = []
    for one in met:
        time, before, behind = one.time, one.parameters_before, one.parameters_behind
        closed = [row for row in motion.problem.latches if behind[row.place] != before[row.place]]
        if len(closed) > 1:
            raise CapabilityError("latches close together")
        switches += [
            Switch(time, (row.closes,), True, behind=behind) for row in closed if row.closes is not None
        ]
    return switches


class _Noting:
    """Notes the events of another owner."""

    def __init__(self, owner: Owner, noted: list[Switch]) -> None:
        self.owner, self.found = owner, noted

    def handle(self, event: Event) -> Outcome:
        outcome = self.owner.handle(event)
        if isinstance(outcome, (Jump, Leap)):
            raise CapabilityError("the motion leaps or jumps on its way")
        if event.function.is_discontinuity:
            self.found.append(Switch(event.time, (event.function.value,), True))
        return outcome

    def again(self) -> Owner | None:
        return self.owner.again()


def step_times(motion: Motion, end: float) -> list[float]:
    """Return the times [s] at which the integrator's steps end, up to ``end``."""
    driver, watch = _again(motion, motion.options)
    driver.noted = []
    driver.start(0.0, motion.start)
    driver.run(end, Grid(end, 0.0, 0), lambda t, x: None, watch=watch)
    return list(dict.fromkeys(time for time in driver.noted if 0.0 < time < end))


def _again(motion: Motion, options: Options) -> tuple[Driver, bool]:
    """Return the driver of another integration, and whether it has events to watch."""
    system, watchers = watched_again(motion)
    watch = any(e.kind is not EventKind.REPARTITION for e in system.events)
    own = system if watch else motion.system  # whose code is there
    return Driver(own, motion.choice.method, options, watchers, supervisor_for(motion.choice)), watch


def follow(
    motion: Motion, options: Options, parts: Sequence[tuple[float, float, bool]], blocks: int
) -> StateCourse:
    """Integrate a motion from its start and return samples of its smooth parts.

    Parameters
    ----------
    parts : where each begins and ends [s], and whether a switch comes before. blocks : of samples in each part.
    """
    driver, watch = _again(motion, options)
    driver.start(0.0, motion.start)
    times, states, parameters = [], [], []
    for first, last, switched in parts:
        if switched:
            driver.run(first, Grid(first, 0.0, 0), lambda t, x: None, watch=watch)
        grid = Grid(first, (last - first) / (NEW * blocks), NEW * blocks + 1, last)
        times.append(grid.times(0, grid.count))
        states.append(_samples(driver, grid, watch))
        parameters.append(np.tile(driver.parameters, (grid.count, 1)))
    switches = tuple(k for k, (_, _, switched) in enumerate(parts) if switched)
    t, x, p = (np.concatenate(parts) for parts in (times, states, parameters))
    return StateCourse(t, x, p, tuple(map(len, times)), switches)


def _samples(driver: Driver, grid: Grid, watch: bool) -> Array:
    """Return the states at all samples of a grid that ends where the run is to go."""
    states = driver.samples(float(grid.times(grid.count - 1, grid.count)[0]), grid, watch)
    if len(states) != grid.count:
        raise CapabilityError("the motion ends on the way")
    return states


def parts_of(
    end: float, switches: Sequence[Switch], steps: Sequence[float], side: float
) -> list[tuple[float, float, bool]]:
    """Return the smooth parts of a motion, as ``follow`` takes them: steps, ending a little beside the switches.

    side : how far, times what two integrations come to the switch apart.
    """
    parts: list[tuple[float, float, bool]] = []
    begin, switched = 0.0, False
    for k in range(len(switches) + 1):
        beside = max(BESIDE * end, side * switches[k].apart) if k < len(switches) else 0.0
        stop = switches[k].time - beside if k < len(switches) else end
        if stop <= begin:
            raise CapabilityError("switches follow one another at once")
        margin = SHORTEST * (stop - begin)
        first, last = bisect_right(steps, begin + margin), bisect_left(steps, stop - margin)
        bounds = [begin, *steps[first:last], stop]
        parts += [(a, b, switched and a == begin) for a, b in zip(bounds, bounds[1:])]
        begin, switched = stop + 2.0 * beside, True
    return parts


def plain_states(system: System, plain: System, x: Array) -> Array:
    """Return states x (T, nx) of a motion's system as states of the same equations without work."""
    q, v, z = system.split(x)
    states = np.zeros((len(x), plain.size))
    states[:, list(plain.q_places)], states[:, list(plain.v_places)] = q, v
    states[:, list(further_places(plain))] = z[:, : plain.further]
    return states


def further_places(plain: System) -> Sequence[int]:
    """Return the places in x of the states beside q and v: those of a controller."""
    return range(plain.nq + plain.nv, plain.size) if plain.layout is None else plain.layout.z


class Updated:
    """The updates of a motion's controller; none where it has no sampled one."""

    def __init__(self, motion: Motion, variational: Variational) -> None:
        self.motion, self.variational = motion, variational
        control: Any = motion.problem.control
        self.control = control
        self.updates = variational.system.updates
        self.places = list(further_places(variational.system))
        layout = variational.system.layout
        phases = [] if self.updates is None else control.phases
        self.phases = [
            Gradients({"z": phase}, variational.columns(phase), (*STATE_GROUPS, NOISE))
            for phase in (phases if layout is None else map(layout.renamed, phases))
        ]

    def along(
        self, switches: Mapping[int, Switch], along: Linearised, last: NDArray[np.int64]
    ) -> dict[int, tuple[Array, Array]]:
        """Return the derivatives of updates by the number of the block behind; last : the last samples of blocks."""
        own = {k: switch.update for k, switch in switches.items() if switch.update is not None}
        before = last[np.array(list(own), dtype=int) - 1]
        times = np.array([switches[k].time for k in own])
        x = along.x[before] + (times - along.t[before])[:, None] * along.rate[before]
        return dict(zip(own, zip(*self.slopes(list(own.values()), times, x))))

    def slopes(self, updates: Sequence[tuple[int, int]], t: Array, x: Array) -> tuple[Array, Array]:
        """Return the derivatives of what updates set, by the state (U, nz, nx) and by keys (U, nz, K).

        Parameters
        ----------
        updates : numbers and phases. t, x : times (U,) and states (U, nx) right before them.
        """
        system, n, count = self.variational.system, self.variational.system.size, self.variational.keys
        J = np.zeros((len(updates), len(self.places), n + 1 + count))
        for phase, gradients in enumerate(self.phases):
            own = [k for k, (_, other) in enumerate(updates) if other == phase]
            if not own or self.updates is None:
                continue
            noise = self.updates.noise[[min(updates[k][0], len(self.updates.noise) - 1) for k in own]]
            groups = {**system.own_groups(t[own], x[own], np.zeros(0)), NOISE: noise}
            J[own] = gradients(len(own), groups)["z"][1]
        return J[:, :, :n], J[:, :, n + 1 :]

    def over(self, S: Array, state: Array, keys: Array) -> Array:
        """Return S (nx, K) behind an update with these derivatives (nz, nx) and (nz, K)."""
        new = S.copy()
        new[self.places] = state @ S + keys
        return new

    def begun(self, S: Array) -> Array:
        """Return S at t = 0 with the states of a controller, which the first update sets."""
        if self.updates is None:
            return S
        system, control = self.variational.system, self.control
        q, v = self.motion.assembled.q, self.motion.assembled.v
        z = control.before_start(q, v, self.motion.system.parameters_at(0.0, q), self.updates.noise[0])
        S = S.copy()
        if control.last:  # what was measured last is where the joints are
            S[np.array(self.places)[control.last]] = S[list(system.q_places)]
        state, keys = self.slopes([(0, 0)], np.zeros(1), system.join(q, v, z)[None])
        return self.over(S, state[0], keys[0])

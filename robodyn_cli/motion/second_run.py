"""The error of a simulation, estimated by a second and more accurate integration."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import NumericalError, RobodynError, SingularConfigurationError
from robodyn_cli.formulations.events import EventFunction, Owner
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.error import (
    AT_ROUNDING,
    Attempt,
    Courses,
    First,
    Floor,
    difference,
    integrate_again,
    remainder,
)
from robodyn_cli.motion.method import supervisor_for
from robodyn_cli.motion.motion import Beginning, Motion, Watcher
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.motion import NOT_MEANINGFUL, MotionErrors

Tick = Callable[[float], None] | None
REST = 1e-14  # of 1 rad, 1 m or their rates, or of larger ones: what rounding moves of a structure at rest


@record
class FirstRun(First):
    """The run whose error is asked for: its beginning, samples, end [s], the state x (nx,) there, and what rounding has
    made of its rates [rad/s, m/s].

    start : where the second integration begins (nx,), off from the first by the error of what came before; None: there.
    latest : of a run that an event ended: until when the second one may go on to its own [s]; None: to ``end``.
    """

    beginning: Beginning
    grid: Grid
    end: float
    state: Array
    start: Array | None = None
    rounded: float = 0.0
    latest: float | None = None

    @staticmethod
    def of(driver: Driver, beginning: Beginning, grid: Grid, recorder: Recorder) -> FirstRun:
        """Return the run that a driver has made, as far as it is recorded."""
        end, steps = recorder.last_time, np.array([driver.counters.steps])
        state = driver.state if driver.time == end else recorder.last_state
        went = np.array([end - beginning.time])
        return FirstRun(
            driver.options, driver.first, steps, went, beginning, grid, end, state, rounded=driver.rounded
        )


def grid_of(scene: Scene, beginning: Beginning) -> Grid:
    """Return the samples of a scene that a run takes: those from its beginning on."""
    return Grid.over(scene.simulate.duration, scene.simulate.samples).from_time(beginning.time)


@record
class Second:
    """What the second integration came to: times, states and parameters by blocks, the end [s] and the state
    there, its steps, how it differed, in words, what its watchers say for the summary, and all states (T, nx)."""

    blocks: list[tuple[Array, Array, Array]]
    end: float
    state: Array
    steps: int
    how: str
    facts: Mapping[str, Any]
    states: Array
    watchers: tuple[Watcher, ...]


@record
class Estimate:
    """The errors of a motion, and what those of its figures follow from.

    recorder : the second run's samples, None where nothing is asked for that follows from samples. facts : what the
    watchers of the second run, and of a third one, say. factor : times a difference from the first is an error, see
    ``remainder``. watchers : of the second run. end : when that ended [s].
    """

    errors: MotionErrors
    recorder: Recorder | None = None
    facts: Sequence[Mapping[str, Any]] = ()
    factor: float = 1.0
    watchers: tuple[Watcher, ...] = ()
    end: float = math.nan


class SecondFailed(Exception):
    """The second integration did not come to the end. how : it differed from the first."""

    def __init__(self, how: str, cause: RobodynError) -> None:
        super().__init__(cause.message)
        self.how, self.message = how, cause.message


def watched_again(motion: Motion, every: bool = False) -> tuple[System, list[Watcher]]:
    """Return the system and the watchers of a second integration: those of events that change the motion.

    every : see ``System.watched_by``.
    """
    twins = {id(w): w.again() for w in motion.watchers}

    def owner_of(function: EventFunction) -> Owner | None:
        owner = function.owner
        return None if owner is None else twins[id(owner)] if id(owner) in twins else owner.again()

    system = motion.system.watched_by(owner_of, every)
    return system, [twin for twin in twins.values() if twin is not None]


def driver_again(
    motion: Motion, first: FirstRun, options: Options
) -> tuple[Driver, Callable[[], None], bool]:
    """Return the driver of another integration of a run, what starts it, and whether it has events to watch."""
    begun, updates = first.beginning, motion.system.updates
    # a function in Python that controls starts anew, too
    calls = updates is not None and updates.function is not None and begun.time == 0.0
    # with every event, whoever watches it, the compiled code of the first run serves
    system, watchers = watched_again(motion, every=True)
    watch = any(e.owner is not None for e in system.events)
    driver = Driver(system, first.method, options, watchers, supervisor_for(motion.choice))
    state = begun.state if first.start is None else first.start
    return driver, lambda: driver.start(begun.time, motion.start if calls else state), watch


def second_run(motion: Motion, first: FirstRun, tick: Tick) -> Second:
    """Integrate once more, more accurately and without observing.

    Raises
    ------
    SecondFailed : it did not come to the end.
    """
    came_to: Second | SecondFailed

    def once(attempt: Attempt) -> tuple[Any, Any]:
        nonlocal came_to
        driver, start, watch = driver_again(motion, first, attempt.alone)
        driver.tick = tick
        blocks: list[tuple[Array, Array, Array]] = []
        try:
            start()
            driver.run(
                first.latest or first.end,
                first.grid,
                lambda t, x: blocks.append((t, x, driver.parameters)),
                watch=watch,
            )
        except (NumericalError, SingularConfigurationError) as error:
            came_to = SecondFailed(attempt.how, error)
            if error.details.get("status") != "max_steps":
                raise came_to from error
            return np.array([driver.counters.steps]), np.array([True])
        states = np.concatenate([x for _, x, _ in blocks])
        facts = {key: value for w in driver.watchers for key, value in w.facts(driver.time).items()}
        came_to = Second(
            blocks,
            driver.time,
            driver.state,
            driver.counters.steps,
            attempt.how,
            facts,
            states,
            tuple(driver.watchers),
        )
        return np.array([came_to.steps]), np.array([False])

    integrate_again(first, once)
    if isinstance(came_to, SecondFailed):
        raise came_to
    return came_to


def estimate_error(
    motion: Motion, first: FirstRun, recorder: Recorder, tick: Tick = None, figures: bool = False
) -> Estimate:
    """Estimate the global error by a second integration that is more accurate than the first.

    The difference of the two, D = e_1 - e_2, is the error of the first up to that of the second, which is smaller by
    (n_1 / n_2)^p for n steps each and order p: e_1 = D / (1 - (n_1 / n_2)^p). Reported are the largest over all samples
    and those at the end (``Courses.at_end``), for q and qd apart, and no less than what rounding is expected to leave.
    Nothing else about the two runs is shared but the method. Where both may be off alike by chance, a third integration
    counts as well (``Courses.settled``). What the first run's figures are compared with comes along, with samples
    where the scene asks for what follows from them, or where ``figures`` are asked for.
    """
    grid = first.grid.every(recorder.every)
    again = dataclasses.replace(first, grid=grid)
    try:
        second = second_run(motion, again, tick)
    except SecondFailed as failed:
        reason = f"the second integration failed: {failed.message}"
        how = f"difference from a second integration with {failed.how}"
        return Estimate(MotionErrors(how, reason=reason))
    courses, times = judged_courses(motion, first, second, recorder)
    watched = sum(watcher.rounding for watcher in motion.watchers)
    lasted = times[-1] - times[0]
    floor = courses.floor(
        first.steps,
        lasted,
        lambda near: motion.conditioning(times[None], courses.first),
        first.rounded,
        watched,
    )
    factor = float(courses.scale[0])  # of figures, as in many runs
    courses, doubt = courses.settled(floor, motion.is_steep)
    dq, dv = sampled_errors(motion, grid, second, recorder, courses.scale)
    facts = [second.facts]
    if doubt[0] and (third := _third_run(motion, again, tick)) is not None:
        other, _ = judged_courses(motion, first, third, recorder)
        if other.apart.shape == courses.apart.shape:
            courses = courses.beside(other.apart, True, motion.is_steep)
            more = sampled_errors(motion, grid, third, recorder, courses.scale)
            dq, dv = (_larger(x, y) for x, y in zip((dq, dv), more))
            facts.append(third.facts)
    errors = _errors(first, recorder, second, courses, floor, (dq, dv))
    observed = _observed(recorder, second) if figures or recorder.observer.figures else None
    return Estimate(errors, observed, facts if second.facts else (), factor, second.watchers, second.end)


def _errors(
    first: FirstRun,
    recorder: Recorder,
    second: Second,
    courses: Courses,
    floor: Floor,
    sampled: tuple[Array, Array],
) -> MotionErrors:
    """Return the errors of a motion, by those of q and qd (T, n) at the samples and by the courses at the end."""
    dq, dv = sampled
    least_q, least_v = float(floor.q[0]), float(floor.qd[0])
    largest = max(float(dq.max(initial=0.0)), float(dv.max(initial=0.0)))
    q_max, qd_max = float(dq.max(initial=least_q)), float(dv.max(initial=least_v))
    at_rounding = largest < AT_ROUNDING * max(least_q, least_v)
    lost = _is_lost(dq, recorder.array("q"), first.options) | _is_lost(
        dv, recorder.array("qd"), first.options
    )
    time = float(recorder.array("time")[int(np.argmax(lost))])
    q_end, qd_end, _ = courses.system.split(courses.at_end(floor)[0])
    return MotionErrors(
        method=f"difference from a second integration with {second.how}",
        q_max=q_max,
        qd_max=qd_max,
        state_max=max(q_max, qd_max),
        q_end=float(q_end.max(initial=least_q)),
        qd_end=float(qd_end.max(initial=least_v)),
        rounding_floor=max(least_q, least_v),
        steps=second.steps,
        at_rounding=at_rounding,
        meaningful_until=time if lost.any() and not at_rounding else ABSENT,
    )


def _is_lost(error: Array, x: Array, options: Options) -> Array:
    """Tell at which samples (n,) an error of x (n, k) says no more than that the digits of a motion are lost."""
    x = x[: len(error)]
    spread = float(np.ptp(x, axis=0).max(initial=0.0))
    rounding = REST * max(float(np.abs(x).max(initial=0.0)), 1.0)
    # what ranges over less than the tolerance is at rest, if it errs by less
    least = NOT_MEANINGFUL * spread if spread > options.atol else options.atol
    lost: Array = error.max(axis=1, initial=0.0) > max(least, rounding)
    return lost


def _observed(recorder: Recorder, second: Second) -> Recorder:
    """Return the samples of the second integration, as far as the first one's are recorded."""
    observed = Recorder(recorder.observer)
    for t, x, p in second.blocks:
        within = t <= recorder.last_time
        if within.any():
            observed.emit(t[within], x[within], p)
    return observed


def judged_courses(
    motion: Motion, first: FirstRun, second: Second, recorder: Recorder
) -> tuple[Courses, Array]:
    """Return the states by which errors at the end are judged, and their times."""
    numbers = np.arange(len(second.states))
    judged = recorder.is_judged(recorder.every * numbers)
    times = first.grid.every(recorder.every).times(0, len(numbers))[judged]
    own, other = np.concatenate(recorder.judged), second.states[judged]
    count = min(len(own), len(other))
    own, other, times = own[:count], other[:count], times[:count]
    sampled_end = len(times) > 0 and times[-1] >= first.end
    if second.end >= first.end or first.latest is not None:
        own, other = np.vstack([own, first.state]), np.vstack([other, second.state])
        times = np.append(times, first.end)
    if motion.problem.constraints.rheonomic:  # where closing the loops leaves little of errors between steps
        own, other = (recorder.observer.project(times, x) for x in (own, other))
    scale = remainder(first, np.array([second.steps]))
    return Courses(motion.system, own[None], difference(own[None], other[None], sampled_end), scale), times


def sampled_errors(
    motion: Motion, grid: Grid, second: Second, recorder: Recorder, scale: Array
) -> tuple[Array, Array]:
    """Return the errors of q and qd (T, n) at the samples that a second integration came to."""
    states = recorder.observer.project(grid.times(0, len(second.states)), second.states)
    q, qd = recorder.array("q")[: len(states)], recorder.array("qd")[: len(states)]
    other_q, other_qd, _ = motion.system.split(states[: len(q)])
    return scale * np.abs(other_q - q), scale * np.abs(other_qd - qd)


def _larger(one: Array, two: Array) -> Array:
    """Return the larger errors at samples of two runs, one of which may have met its end a sample earlier."""
    less, more = sorted((one, two), key=len)
    both = more.copy()
    both[: len(less)] = np.maximum(less, more[: len(less)])
    return both


def _third_run(motion: Motion, first: FirstRun, tick: Tick) -> Second | None:
    """Return a third integration, None where it did not come to the end."""
    try:
        return second_run(motion, first.once_more(motion.is_steep), tick)
    except SecondFailed:
        return None

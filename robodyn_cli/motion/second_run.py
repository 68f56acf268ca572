"""The error of a simulation, estimated by a second and more accurate integration."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from robodyn_cli.errors import NumericalError, RobodynError, SingularConfigurationError
from robodyn_cli.formulations.events import EventFunction, Owner
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.integrators.runtime.grid import Grid
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.method import supervisor_for
from robodyn_cli.motion.motion import Beginning, Motion, Watcher
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.ready.prepare import held_columns
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.motion import MotionErrors

Tick = Callable[[float], None] | None
MORE_STEPS = 1.9  # times the steps of the first run: both together take less than three times its time
MOST_STEPS = 4  # times the steps of the first run, at which the second is given up
TIGHTER = 200.0  # times, at most: a tolerance so much tighter is enough even where it takes fewer steps
TIGHTEST_RTOL = 2e-14  # not below what double precision can resolve
FINEST_RTOL = 1e-12  # below it, methods of high order are at rounding, where a tighter tolerance says nothing
FINER = 0.45  # times a fixed step: where implicit methods halve theirs, the second run must not take the same steps
DECIDES = 0.5  # of the growth of the steps, as a power: below it something else than the tolerance decides about them
SHORTER = 0.6  # times the mean step of the first run, where a tighter tolerance says nothing
FIRST_STEPS = 0.4  # times the first steps, at the start and behind events: else both runs share their errors
HIGH_ORDER = 7
NOT_MEANINGFUL = 1e-2  # part of the range of a quantity above which its error means that its digits are lost
AT_ROUNDING = 100.0  # times the rounding floor
NEAR_ROUNDING = 1e3  # times the rounding of the state: below it what rounds the accelerations is looked at
HALF_UNIT = 1.1e-16


def tighter(options: Options, mean_step: float, method: str) -> tuple[Options, str]:
    """Return the options of the second run, and how it differs in words.

    A local error falls as h to the power p of the error estimate, so MORE_STEPS times the steps take a tolerance
    MORE_STEPS^p times tighter.
    """
    kind = registry[method]
    if options.step is not None:
        step = float(finer_step(options.step, mean_step))
        return dataclasses.replace(options, step=step, first=FIRST_STEPS), shorter(FINER)
    factor = min(TIGHTER, MORE_STEPS ** (kind.order / kind.proportion))
    if kind.order >= HIGH_ORDER:
        factor = min(factor, options.rtol / TIGHTEST_RTOL)
    rtol = options.rtol / factor
    fine = options.rtol >= FINEST_RTOL if kind.order >= HIGH_ORDER else rtol >= TIGHTEST_RTOL
    if kind.adaptive and fine:
        tight = dataclasses.replace(options, rtol=rtol, atol=options.atol / factor, first=FIRST_STEPS)
        return tight, f"rtol {rtol:.1g}"
    # at the limit of double precision a tighter tolerance says nothing; other steps show the rounding errors
    return other_steps(options, mean_step)


def finer_step(step: float, mean_step: Any) -> Any:
    """Return the fixed steps of second runs (numbers or arrays): a step longer than a run is as long as the run."""
    return FINER * np.where(step < 2.0 * mean_step, step, mean_step)


def shorter_step(options: Options, mean_step: Any) -> Any:
    """Return the longest steps of second runs (numbers or arrays) whose steps are other ones."""
    return np.minimum(options.max_step, SHORTER * mean_step)


def steps_between(options: Options, tight: Options, method: str, steps: Any) -> tuple[Any, Any]:
    """Return how many steps second runs must and may take (numbers or arrays), from those of the first.

    With fewer the tolerance does not decide about the steps, so that many of the same ones were taken once more. The
    tolerance alone would make them (rtol_1 / rtol_2)^(1/p) times as many.
    """
    kind = registry[method]
    growth = (options.rtol / tight.rtol) ** (DECIDES * kind.proportion / kind.order)
    fewest = growth * steps if options.step is None else 0
    return fewest, np.minimum(4 * options.max_steps, MOST_STEPS * steps + 1000)


def other_steps(options: Options, mean_step: float) -> tuple[Options, str]:
    """Return the options of a second run with shorter steps, and how it differs in words."""
    longest = float(shorter_step(options, mean_step))
    return dataclasses.replace(options, max_step=longest, first=FIRST_STEPS), shorter(SHORTER)


def shorter(part: float) -> str:
    """Say how a second run differs that takes shorter steps."""
    return f"steps {part:g} times as long"


@record
class FirstRun:
    """The run whose error is asked for: its first method, beginning, samples, end [s] and number of steps."""

    method: str
    beginning: Beginning
    grid: Grid
    end: float
    steps: int

    @staticmethod
    def of(motion: Motion, end: float, steps: int, beginning: Beginning | None = None) -> FirstRun:
        """Return the run of a motion to ``end`` [s] on the scene's grid, from t = 0 if nothing else is said."""
        begun = beginning or motion.beginning
        return FirstRun(motion.choice.method, begun, grid_of(motion.scene, begun), end, steps)


def grid_of(scene: Scene, beginning: Beginning) -> Grid:
    """Return the samples of a scene that a run takes: those from its beginning on."""
    return Grid.over(scene.simulate.duration, scene.simulate.samples).from_time(beginning.time)


@record
class Second:
    """What the second integration came to: states (T, nx), its steps, and how it differed, in words."""

    states: Array
    steps: int
    how: str


class SecondFailed(Exception):
    """The second integration did not come to the end. how : it differed from the first."""

    def __init__(self, how: str, cause: RobodynError) -> None:
        super().__init__(cause.message)
        self.how, self.message = how, cause.message


def watched_again(motion: Motion) -> tuple[System, list[Watcher]]:
    """Return the system and the watchers of a second integration: those of events that change the motion."""
    twins = {id(w): w.again() for w in motion.watchers}

    def owner_of(function: EventFunction) -> Owner | None:
        owner = function.owner
        return None if owner is None else twins[id(owner)] if id(owner) in twins else owner.again()

    system = motion.system.watched_by(owner_of)
    return system, [twin for twin in twins.values() if twin is not None]


def integrate_again(motion: Motion, first: FirstRun, options: Options, tick: Tick) -> tuple[Array, int]:
    """Integrate without observing; returns states (T, nx) and how many steps it took."""
    system, watchers = watched_again(motion)
    watch = bool(system.events)
    # without anything to watch the compiled code of the first run serves
    driver = Driver(
        system if watch else motion.system, first.method, options, watchers, supervisor_for(motion.choice)
    )
    driver.tick = tick
    begun = first.beginning
    # a function in Python that controls starts anew, too
    calls = system.updates is not None and system.updates.function is not None and begun.time == 0.0
    driver.start(begun.time, motion.start if calls else begun.state)
    return driver.samples(first.end, first.grid, watch), driver.counters.steps


def second_run(motion: Motion, first: FirstRun, tick: Tick) -> Second:
    """Integrate once more, more accurately: with a tighter tolerance, or with other steps where that says nothing.

    Raises
    ------
    SecondFailed : it did not come to the end.
    """
    went = first.end - first.beginning.time
    options, mean_step = motion.options, went / max(first.steps, 1)
    tight, how = tighter(options, mean_step, first.method)
    fewest, most = (math.ceil(n) for n in steps_between(options, tight, first.method, first.steps))
    tight = dataclasses.replace(tight, max_steps=most)
    try:
        try:
            states, steps = integrate_again(motion, first, tight, tick)
        except NumericalError as error:
            if error.details.get("status") != "max_steps" or options.step is not None:
                raise
            # a tolerance that the method cannot keep
            tight, how = other_steps(dataclasses.replace(options, max_steps=most), mean_step)
            states, steps = integrate_again(motion, first, tight, tick)
            fewest = first.steps
        if steps < fewest:
            tight, how = other_steps(tight, mean_step)
            states, steps = integrate_again(motion, first, tight, tick)
    except (NumericalError, SingularConfigurationError) as error:
        raise SecondFailed(how, error) from error
    return Second(states, steps, how)


def estimate_error(motion: Motion, first: FirstRun, recorder: Recorder, tick: Tick = None) -> MotionErrors:
    """Estimate the global error by a second integration that is more accurate than the first.

    The difference of the two, D = e_1 - e_2, is the error of the first up to that of the second, which is smaller by
    (n_1 / n_2)^p for n steps each and order p: e_1 = D / (1 - (n_1 / n_2)^p). Reported are the largest over all samples
    and those at the end (``end_errors``), for q and qd apart, and no less than what rounding is expected to leave.
    Nothing else about the two runs is shared but the method.
    """
    grid = first.grid.every(recorder.every)
    try:
        second = second_run(motion, dataclasses.replace(first, grid=grid), tick)
    except SecondFailed as failed:
        reason = f"the second integration failed: {failed.message}"
        return MotionErrors(f"difference from a second integration with {failed.how}", reason=reason)
    states = recorder.observer.project(grid.times(0, len(second.states)), second.states)
    q, qd = recorder.array("q")[: len(states)], recorder.array("qd")[: len(states)]
    other_q, other_qd, _ = motion.system.split(states[: len(q)])
    scale = remainder(first.method, first.steps, second.steps)
    dq, dv = scale * np.abs(other_q - q), scale * np.abs(other_qd - qd)
    found_q, found_v = float(dq.max(initial=0.0)), float(dv.max(initial=0.0))
    floor = rounding_floor(motion, recorder, len(q), first.steps, max(found_q, found_v))
    q_max, qd_max = max(found_q, floor.q), max(found_v, floor.qd)
    at_rounding = bool(max(found_q, found_v) < AT_ROUNDING * max(floor.q, floor.qd))
    lost = np.zeros(
        len(q), dtype=bool
    )  # where an estimate says no more than that the digits of a motion are lost
    for error, x in ((dq, q), (dv, qd)):
        spread = max(float(np.ptp(x, axis=0).max(initial=0.0)), 1e-300)
        lost |= error.max(axis=1, initial=0.0) > NOT_MEANINGFUL * spread
    time = float(recorder.array("time")[int(np.argmax(lost))])
    return MotionErrors(
        method=f"difference from a second integration with {second.how}",
        q_max=q_max,
        qd_max=qd_max,
        state_max=max(q_max, qd_max),
        q_end=float(end_errors(dq, scale).max(initial=floor.q)),
        qd_end=float(end_errors(dv, scale).max(initial=floor.qd)),
        rounding_floor=max(floor.q, floor.qd),
        steps=second.steps,
        at_rounding=at_rounding,
        meaningful_until=time if lost.any() and not at_rounding else ABSENT,
    )


def remainder(method: str, steps: Any, more: Any) -> Any:
    """Return 1 / (1 - (n_1 / n_2)^p), at most 2: what the second run's own error hides of the first one's.

    steps, more : numbers or arrays.
    """
    kind = registry[method]
    # between steps the dense output decides
    power = min(kind.order, kind.dense_order + 1)
    left = np.minimum(1.0, steps / np.maximum(more, 1)) ** power
    return 1.0 / (1.0 - np.minimum(left, 0.5))


def end_errors(errors: Array, scale: Any) -> Array:
    """Return errors at the last sample (..., n) from estimates (..., T, n), differences of two runs times ``scale``.

    At a single sample the errors of both may agree by chance. So they are no less than what the second run's own error,
    a part 1 - 1/scale of the first one's (see ``remainder``), typically is over the second half of the samples.
    """
    largest = errors.max(axis=-1, initial=0.0)
    typical = np.median(largest[..., largest.shape[-1] // 2 :], axis=-1)
    found: Array = np.maximum(errors[..., -1, :], ((1.0 - 1.0 / scale) * typical)[..., None])
    return found


def rounding_walk(steps: Any) -> Any:
    """Return by which part of the largest state rounding moves it over so many steps (a number or an array)."""
    return HALF_UNIT * np.sqrt(np.maximum(1.0, steps))


@record
class Floor:
    """Errors that rounding is expected to leave, of positions and of rates."""

    q: float
    qd: float


def rounding_floor(motion: Motion, recorder: Recorder, samples: int, steps: int, found: float) -> Floor:
    """Return the errors that rounding alone is expected to leave over so many samples and steps.

    The state's own rounding grows as sqrt(steps). Where an estimate ``found`` is not far above that, what constants and
    the conditioning of the equations do counts too: delta(v-dot) over the run in the rates, and over the time in which
    rates change in the positions; what closing the loops leaves. Both runs share some of it, so that their difference
    hides it. Beside that there is what watchers say of their own integrations.
    """
    q, qd, qdd = (recorder.array(path)[:samples] for path in ("q", "qd", "qdd"))
    largest_q, largest_v = float(np.abs(q).max(initial=0.0)), float(np.abs(qd).max(initial=0.0))
    walk = rounding_walk(steps)
    watched = sum(watcher.rounding for watcher in motion.watchers)
    floor = Floor(max(walk * largest_q, watched), max(walk * largest_v, watched))
    if found > NEAR_ROUNDING * max(floor.q, floor.qd):
        return floor
    from robodyn_cli.observe.rounding import acceleration_rounding, closing_rounding

    problem, time = motion.problem, recorder.array("time")[:samples]
    names = held_columns(motion.scene, problem)
    held = [k for k, name in enumerate(problem.model.v_names) if name in names]
    closed = closing_rounding(problem, time, q, qd, held)
    states = recorder.blocks.get("control/states")
    z = np.zeros((samples, 0)) if states is None else recorder.array("control/states")[:samples]
    off = acceleration_rounding(problem, time, q, qd, z)
    if off is None:
        return Floor(max(floor.q, closed), floor.qd)
    duration = float(time[-1] - time[0])
    change = min(duration, largest_v / max(float(np.abs(qdd).max(initial=0.0)), 1e-300))
    return Floor(max(floor.q, closed, off * duration * change), max(floor.qd, off * duration))

"""Forward dynamics: what motion do these torques give."""

from __future__ import annotations

from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import RobodynError
from robodyn_cli.integrators.runtime.grid import Grid
from robodyn_cli.record import record
from robodyn_cli.results.hdf5.writer import ResultWriter
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import ABSENT, Absent, as_keys
from robodyn_cli.run.driver.build import build_motion
from robodyn_cli.run.driver.driver import Driver
from robodyn_cli.run.driver.method import supervisor_for
from robodyn_cli.run.driver.motion import Motion
from robodyn_cli.run.driver.second_run import ErrorEstimate, FirstRun, estimate_error
from robodyn_cli.run.driver.self_check import (
    accuracy_warnings,
    energy_out_of_balance,
    is_judged_by_energy,
    shortened_steps,
)
from robodyn_cli.run.driver.summary import MotionSummary, motion_facts, redundant_rows
from robodyn_cli.run.observation.recorder import Recorder
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array


@record
class SimulateSummary(MotionSummary):
    """Keys of the summary of ``simulate``."""

    wall_time_s: dict[str, float] | Absent = ABSENT


def simulate(
    scene: Scene,
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
    writer: ResultWriter | None = None,
) -> Result:
    """Integrate the scene over its duration.

    Parameters
    ----------
    writer : takes the datasets block by block while the run goes on; the Result then holds a selection of the
        samples, and the caller finishes the file.

    Returns
    -------
    A Result with the contract's datasets (``docs/hdf5.md``) and its error estimate in the summary.

    Raises
    ------
    RobodynError : with ``result`` holding what was computed until then.
    """
    watch = watch or Stopwatch()
    motion = build_motion(scene, watch)
    with watch.stage("equations"):
        recorder = Recorder.of(motion.observer, writer)
    with watch.stage("method"):
        driver = Driver.of(motion, supervisor_for(motion.choice))
    failure = _drive(motion, driver, recorder, progress, watch)
    redundant = redundant_rows(motion, recorder)
    facts = motion_facts(motion, driver, recorder, redundant)
    facts |= _warnings(motion, driver, facts.get("warnings", []))
    failure = (redundant and redundant.violated) or failure or recorder.not_finite
    failure = failure or _judge_energy(motion, driver, recorder, facts)
    if failure is None and motion.scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            facts["error_estimate"] = _estimate(motion, driver, recorder, progress)
    return _report(motion, driver, recorder, facts, failure, watch)


def _drive(
    motion: Motion, driver: Driver, recorder: Recorder, progress: Progress, watch: Stopwatch
) -> RobodynError | None:
    """Integrate over the duration and record; return why the run ended before, with its last state recorded."""
    s = motion.scene.simulate
    driver.tick = lambda time: progress(time, s.duration)

    def emit(t: Array, x: Array) -> None:
        recorder.observer.parameters = driver.parameters
        recorder.emit(t, x)
        progress(float(t[-1]), s.duration)

    with watch.stage("method"):
        driver.start(0.0, motion.start)
    with watch.stage("integrate"):
        try:
            driver.run(s.duration, Grid.over(s.duration, s.samples), emit)
        except RobodynError as error:
            from robodyn_cli.run.driver.failure import explained

            recorder.keep_last_state(driver.time, driver.state)
            return explained(error, motion, driver)
    return None


def _warnings(motion: Motion, driver: Driver, said: list[str]) -> dict[str, Any]:
    """Return the field of the summary that says what is doubtful about the motion, where anything is.

    said : warnings so far.
    """
    warnings = [*said, *_unresolved_formulas(motion.problem)]
    if motion.passive:
        from robodyn_cli.run.driver.start import start_warnings

        warnings += start_warnings(motion.problem, motion.assembled.q, motion.passive)
    warnings += shortened_steps(motion, driver)
    return {"warnings": warnings} if warnings else {}


def _beyond_limits(motion: Motion, result: Result) -> list[str]:
    """Return warnings about limits of acceleration and jerk that samples are beyond; a watcher locates the others."""
    if not motion.scene.robot.limited:
        return []
    from robodyn_cli.run.observation.joint_limits import limit_warnings, limited_joints

    joints = limited_joints(motion.scene, motion.problem.model)
    return limit_warnings(joints, result["time"], {"qdd": result["qdd"]})


def _judge_energy(
    motion: Motion, driver: Driver, recorder: Recorder, facts: dict[str, Any]
) -> RobodynError | None:
    """Return the error of a balance of energy that is lost; a warning where the scene has chosen a method that may."""
    lost = energy_out_of_balance(motion, driver, recorder)
    if lost is None or is_judged_by_energy(motion):
        return lost
    facts["warnings"] = [*facts.get("warnings", ()), lost.message]
    return None


def _unresolved_formulas(problem: Problem) -> list[str]:
    """Return warnings about formulas of time that change too often for all of it to be found."""
    return [
        f"{key}: this function of time changes so often, or on so short a scale, that not every change was found; "
        "steps may miss some: set simulate.max_step below the shortest"
        for key, found in problem.switching.time_structures
        if not found.resolved
    ]


def _estimate(motion: Motion, driver: Driver, recorder: Recorder, progress: Progress) -> ErrorEstimate:
    """Return the error of the run just made."""
    s = motion.scene.simulate
    first = FirstRun(
        motion.choice.method,
        motion.start,
        Grid.over(s.duration, s.samples),
        driver.time,
        driver.counters.steps,
    )
    return estimate_error(motion, first, recorder, lambda time: progress(time, s.duration))


def _report(
    motion: Motion,
    driver: Driver,
    recorder: Recorder,
    facts: dict[str, Any],
    failure: RobodynError | None,
    watch: Stopwatch,
) -> Result:
    """Return the result with its summary.

    Raises
    ------
    RobodynError : the ``failure``, with the result.
    """
    scene = motion.scene
    estimate = facts.get("error_estimate")
    if estimate is not None and estimate.reason is not ABSENT:
        words = f"no second run confirms this motion: {estimate.reason}"
        facts["warnings"] = [*facts.get("warnings", ()), words]
    if doubts := accuracy_warnings(estimate):
        facts["warnings"] = [*facts.get("warnings", ()), *doubts]
    status, termination = "ok", {"reason": "duration", "time": driver.time}
    if failure is not None:
        status, termination = "failed", {"reason": failure.message, **failure.details}
    events = [event for watcher in driver.watchers for event in watcher.log]
    result = Result("simulate", scene.title or "simulate", status, scene.text, events=events)
    recorder.fill(result)
    if beyond := _beyond_limits(motion, result):
        facts["warnings"] = [*facts.get("warnings", ()), *beyond]
    summary = SimulateSummary(status=status, termination=termination, **facts, wall_time_s=watch.report())
    result.summary = as_keys(summary)
    if failure is not None:
        failure.result = result
        raise failure
    return result

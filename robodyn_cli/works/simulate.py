"""Forward dynamics: what motion do these torques give."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.motion.build import build_motion, follow_latches, follow_motion
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.figures import with_figures, with_latches_beside
from robodyn_cli.motion.method import supervisor_for
from robodyn_cli.motion.motion import Beginning, Motion
from robodyn_cli.motion.second_run import Estimate, FirstRun, estimate_error, grid_of
from robodyn_cli.motion.self_check import Judgement, Run, judge, motion_records
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.observe.units import add_joint_limits
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress

if TYPE_CHECKING:
    from robodyn_cli.motion.going_on import Journal
    from robodyn_cli.results.hdf5.writer import ResultWriter


def simulate(
    scene: Scene,
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
    writer: ResultWriter | None = None,
    journal: Journal | None = None,
) -> Result:
    """Integrate the scene over its duration.

    Parameters
    ----------
    writer : takes the datasets block by block while the run goes on; the Result then holds a selection of the
        samples, and the caller finishes the file.
    journal : takes what a run that is killed goes on from; one with blocks of such a run goes on with them.

    Returns
    -------
    A Result with the contract's datasets (``docs/hdf5.md``) and its error estimate in the summary.

    Raises
    ------
    RobodynError : with ``result`` holding what was computed until then.
    """
    watch = watch or Stopwatch()
    run = _start(scene, writer, watch)
    stopped = _drive(run, progress, watch, journal)
    judgement = judge(run, stopped)
    estimate = None
    if judgement.failure is None and scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            estimate = _estimate(run, progress)
    return _report(run, judgement, estimate, watch)


def _start(scene: Scene, writer: ResultWriter | None, watch: Stopwatch) -> Run:
    """Build everything, and put the driver to the start."""
    motion, beginning = motion_of(scene, watch)
    with watch.stage("equations"):
        recorder = Recorder.of(motion.observer, writer, grid_of(scene, beginning).count)
    with watch.stage("method"):
        driver = Driver.of(motion, supervisor_for(motion.choice))
        driver.start(beginning.time, beginning.state)
    return Run(motion, beginning, driver, recorder)


def motion_of(scene: Scene, watch: Stopwatch) -> tuple[Motion, Beginning]:
    """Return the motion of a scene, and where its run begins: at t = 0, or where a stored one is."""
    if scene.initial.source is None:
        motion = build_motion(integrable(scene, watch), watch)
        _refuse_undriven(motion)
        return motion, motion.beginning
    from robodyn_cli.motion.going_on import stored_run

    stored = stored_run(scene)
    scene, follow = stored.completed(), follow_motion
    if stored.latched and scene.deploy.latches:  # the same mechanism, to the end of the duration
        deploy = dataclasses.replace(scene.deploy, until="end")
        scene, follow = dataclasses.replace(scene, latched=True, deploy=deploy), follow_latches
    motion = build_motion(integrable(scene, watch), watch, follow)
    _refuse_undriven(motion)
    return motion, stored.beginning(motion)


def _refuse_undriven(motion: Motion) -> None:
    """Refuse a scene that asks for margins of motorisation that it does not have (see ``acting``)."""
    if motion.scene.motorisation is not None:
        from robodyn_cli.drives.motorisation import acting

        acting(motion.problem, inertia=False)


def _drive(run: Run, progress: Progress, watch: Stopwatch, journal: Journal | None) -> RobodynError | None:
    """Integrate over the duration and record; return why the run ended before, with its last state recorded."""
    s, driver, recorder = run.motion.scene.simulate, run.driver, run.recorder
    driver.tick = lambda time: progress(time, s.duration)

    def emit(t: Array, x: Array) -> None:
        if t[0] <= recorder.last_time:  # a run that is taken up begins with the last sample that it has
            t, x = t[1:], x[1:]
        if not len(t):
            return
        recorder.emit(t, x, driver.parameters)
        if journal is not None:
            journal.add(t, x, driver)
        progress(float(t[-1]), s.duration)

    with watch.stage("integrate"):
        if journal is not None and journal.taken:
            _take_up(run, journal)
        try:
            driver.run(s.duration, grid_of(run.motion.scene, run.beginning), emit)
        except RobodynError as error:
            from robodyn_cli.motion.failure import explained

            recorder.keep_last_state(driver.time, driver.state, driver.parameters)
            return explained(error, run.motion, driver)
    return None


def _take_up(run: Run, journal: Journal) -> None:
    """Record the samples that an earlier process has come to, and put the driver to the last of them.

    Raises
    ------
    CapabilityError : events have changed the motion, and who answers them does not know of earlier ones.
    """
    if any(watcher.changes_motion for watcher in run.driver.watchers):
        raise CapabilityError(
            "a run with joints that stick or meet rigid stops, that picks up masses, or "
            "that passes singular poses, does not go on after it was killed; run it without --resume",
            (run.motion.scene.path,),
        )
    for block in journal.blocks():
        for watcher in run.driver.watchers:
            watcher.see(block.t, block.x)
        run.recorder.emit(block.t, block.x, block.p)
    run.driver.go_on(Beginning(float(block.t[-1]), block.x[-1]), block.counters, block.changes)
    for watcher, noted in zip(run.driver.watchers, block.noted):
        watcher.recall(noted)


def _estimate(run: Run, progress: Progress) -> Estimate:
    """Return the error of the run just made."""
    duration = run.motion.scene.simulate.duration
    first = FirstRun.of(run.driver, run.beginning, grid_of(run.motion.scene, run.beginning), run.recorder)
    return estimate_error(run.motion, first, run.recorder, lambda time: progress(time, duration))


def _report(run: Run, judgement: Judgement, estimate: Estimate | None, watch: Stopwatch) -> Result:
    """Return the result with its summary.

    Raises
    ------
    RobodynError : why the run failed, with the result.
    """
    failure = judgement.failure
    result = Result.of("simulate", run.motion.scene, "ok" if failure is None else "failed")
    result.events = run.driver.log
    run.recorder.fill(result)
    for watcher in run.driver.watchers:
        watcher.add_to(result)
    if run.motion.scene.robot.limited:
        add_joint_limits(result, run.motion.scene, run.motion.problem.model)
    summary, *others = motion_records(run, judgement, estimate)
    records = [with_latches_beside(summary, run, estimate), *others]
    if failure is None:
        records = with_figures(records, result, run, estimate, watch)
    result.summarise(*records, seconds=watch.report())
    return result.unless(failure)

"""Deployment of a mechanism until it locks."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.motion.between.extremes import RecordedMotion
from robodyn_cli.motion.build import build_motion, follow_latches
from robodyn_cli.motion.figures import recorded, with_figures, without_figures
from robodyn_cli.motion.motion import Beginning, Motion
from robodyn_cli.motion.second_run import Estimate, FirstRun, estimate_error, grid_of
from robodyn_cli.motion.self_check import (
    Judgement,
    Run,
    motion_records,
    motion_warnings,
    redundant_rows,
)
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.observe.units import add_joint_limits
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.ready.prepare import refuse_changes
from robodyn_cli.ready.singularity import refuse_singular_start
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.apart import with_others
from robodyn_cli.summaries.deploy import AfterLock, DeploySummary, LockKeys, Overload
from robodyn_cli.summaries.facts import ABSENT, Absent
from robodyn_cli.summaries.motion import FinalState
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.trajectories.led import led_joints
from robodyn_cli.works.deploy.lock import (
    ClosedLatch,
    Lock,
    Relocated,
    Rescan,
    bifurcation_error,
    close,
    criteria,
    describe_lock,
    doubt,
    events,
    find_lock,
    relocate,
    rescan,
    with_multipliers_beside,
    with_rounding,
)  # fmt: skip
from robodyn_cli.works.deploy.recording import (
    FollowedLock,
    add_followed,
    first_overload,
    follow_locked,
    overload_text,
    record_motion,
)
from robodyn_cli.works.deploy.scan import (
    Scan,
    ScanEnd,
    decide,
    driven_extremes,
    follow_deployment,
    latch_position,
    scan,
)

if TYPE_CHECKING:
    from robodyn_cli.results.hdf5.writer import ResultWriter


@record
class Deployment(Run):
    """What a deployment came to.

    estimate : of the error of the recorded run. lock : None where no criterion fired, or the run failed before.
    again : a second scan. relocated : where it puts the lock. followed : the locked structure, where that was asked
    for.
    """

    found: Scan
    end: ScanEnd
    estimate: Estimate | None = None
    lock: Lock | None = None
    latch: ClosedLatch | None = None
    again: Rescan | None = None
    relocated: Relocated | None = None
    followed: FollowedLock | None = None


def deploy(
    scene: Scene,
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
    writer: ResultWriter | None = None,
) -> Result:
    """Simulate a mechanism until it locks.

    Parameters
    ----------
    writer : as for ``simulate``.

    Returns
    -------
    A Result with status ``locked``, ``no_lock`` or ``overload``, and ``summary["lock"]``.

    Raises
    ------
    RobodynError : with ``result``; SingularConfigurationError at a bifurcation.
    """
    watch = watch or Stopwatch()
    motion, beginning = deployment_of(scene, watch)
    if scene.deploy.latches:
        from robodyn_cli.works.deploy.latched import deploy_latched

        return deploy_latched(motion, beginning, progress, watch, writer)
    with watch.stage("scan"):
        scanned = scan(motion, motion.options, progress=progress)
    done = _record(motion, scanned, writer, progress, watch)
    redundant = redundant_rows(done)
    failure = (redundant and redundant.violated) or failure_of_motion(done)
    if failure is None:
        done = _lock(_estimate(done, watch), watch)
        failure = doubt(done.lock, done.relocated.error if done.relocated is not None else None)
        if failure is None and scanned.driven and done.lock is not None and scene.outputs.extremes:
            failure = driven_extremes()
    if failure is None:
        try:
            done = _follow(done, watch)
            if done.followed is not None and done.followed.recorder is not None:
                failure = done.followed.recorder.not_finite
        except CapabilityError as refusal:
            failure = CapabilityError(
                f"continue: the locked structure: {refusal.message}", ("deploy.after",), key="deploy.after"
            )
    return report(done, Judgement(failure, tuple(motion_warnings(done)), redundant), watch)


def deployment_of(scene: Scene, watch: Stopwatch) -> tuple[Motion, Beginning]:
    """Return the motion of a deployment, and where it begins: at t = 0, or where a stored run is.

    Raises
    ------
    RobodynError : see ``build_deployment``; SceneError : it cannot go on from there.
    """
    if scene.initial.source is None:
        motion = build_deployment(scene, watch)
        return motion, motion.beginning
    from robodyn_cli.motion.going_on import refused, stored_run

    if not scene.deploy.latches:
        raise refused(scene, "'deploy' goes on from a stored run with 'deploy.latches' alone")
    stored = stored_run(scene)
    motion = build_deployment(stored.completed(), watch)
    return motion, stored.beginning(motion)


def build_deployment(scene: Scene, watch: Stopwatch, plan: bool = False) -> Motion:
    """Build the motion of a mechanism that is to lock; ``plan`` as for ``build_motion``.

    Raises
    ------
    CapabilityError : it has a controller, or neither loops nor a latch.
    SingularConfigurationError : it starts where it is to end.
    """
    if scene.control is not None and not scene.deploy.latches:
        raise CapabilityError(
            "'deploy' up to a dead point follows a mechanism without a controller; allowed: "
            "deploy.latches, or the command 'simulate'",
            (scene.path, "control"),
            key="control",
        )
    if not scene.deploy.latches:
        refuse_changes(scene, "deploy")
    else:
        scene = dataclasses.replace(scene, latched=True)
        ready, loads = integrable(scene, watch), bool(scene.deploy.loads)
        return build_motion(ready, watch, follow_latches, reactions=loads, plan=plan)
    _refuse_open_chain(scene)
    reactions = bool(scene.deploy.loads) or scene.deploy.after == "continue"
    motion = build_motion(integrable(scene, watch), watch, follow_deployment, reactions=reactions, plan=plan)
    if scene.motorisation is not None:
        from robodyn_cli.drives.motorisation import acting

        acting(motion.problem, inertia=False)
    refuse_singular_start(motion.problem, motion.assembled.q, motion.passive)
    return motion


def _refuse_open_chain(scene: Scene) -> None:
    """Refuse a scene without closed loops, in which nothing locks but a latch at a position.

    Raises
    ------
    CapabilityError
    """
    if not scene.loops and not scene.couplers and scene.deploy.criterion != "latch":
        raise CapabilityError(
            "deploy needs a mechanism with closed loops; this scene has none; allowed in an open chain: "
            "latches that close at positions (deploy.latches)",
            (scene.path,),
            key="loops",
        )


def _record(
    motion: Motion, scanned: Scan, writer: ResultWriter | None, progress: Progress, watch: Stopwatch
) -> Deployment:
    """Integrate the motion once more and record it, up to what ends the deployment."""
    end = decide(motion, scanned)
    with watch.stage("equations"):
        recorder = Recorder.of(motion.observer, writer, motion.scene.simulate.samples)
    with watch.stage("integrate"):
        driver = record_motion(motion, scanned, end, recorder, progress)
    return Deployment(motion, motion.beginning, driver, recorder, scanned, end)


def failure_of_motion(done: Deployment) -> RobodynError | None:
    """Return why there is no lock to speak of: the loops lose rank first, the integration could not go on, or numbers
    are not finite.
    """
    if done.end.bifurcated:
        return bifurcation_error(done.motion, done.found)
    stopped = done.found.stopped if done.end.time is None else None
    return stopped or done.recorder.not_finite


def _estimate(done: Deployment, watch: Stopwatch) -> Deployment:
    """Estimate the error of the recorded run, where that is asked for."""
    if not done.motion.scene.simulate.error_estimate:
        return done
    first = FirstRun.of(
        done.driver, done.beginning, grid_of(done.motion.scene, done.beginning), done.recorder
    )
    with watch.stage("error_estimate"):
        estimate = estimate_error(done.motion, first, done.recorder, figures=bool(done.found.growth))
    return dataclasses.replace(done, estimate=estimate)


def _lock(done: Deployment, watch: Stopwatch) -> Deployment:
    """Look at the lock: its kind, the latch that closes there, the error of its time."""
    motion, scanned = done.motion, done.found
    with watch.stage("lock"):
        lock = find_lock(motion, scanned, done.end, done.recorder)
        latch = close(motion, scanned, lock)
    done = dataclasses.replace(done, lock=lock, latch=latch)
    met = lock is not None or scanned.dead_points or (scanned.growth is not None and scanned.growth.times)
    if not met or not motion.scene.simulate.error_estimate:
        return done
    with watch.stage("error_estimate"):
        again = rescan(motion, scanned)
        relocated = None if lock is None else relocate(motion, again, lock, done.recorder)
    return dataclasses.replace(done, again=again, relocated=relocated)


def _follow(done: Deployment, watch: Stopwatch) -> Deployment:
    """Go on as the locked structure, where that is asked for and a latch has closed."""
    if done.motion.scene.deploy.after != "continue" or done.lock is None or done.latch is None:
        return done
    followed = follow_locked(done.motion, done.lock, done.latch, done.relocated, done.recorder, watch)
    return dataclasses.replace(done, followed=followed)


# -- the report ---------------------------------------------------------------------------------------------
def report(done: Deployment, judgement: Judgement, watch: Stopwatch) -> Result:
    """Return the result with its summary.

    Raises
    ------
    RobodynError : why the deployment failed, with the result.
    """
    failure, limits = judgement.failure, done.motion.scene.deploy.loads
    summary, *others = motion_records(done, judgement, done.estimate)
    result = Result.of("deploy", done.motion.scene, "failed")
    result.events = [*events(done.found), *done.driver.log]
    done.recorder.fill(result)
    add_joint_limits(result, done.motion.scene, done.motion.problem.model)
    overload: Overload | None = None
    unbounded = done.lock if done.found.driven else None  # its end, a dead point that it is driven into
    if failure is None:
        if done.followed is not None:
            assert done.lock is not None and done.latch is not None
            add_followed(result, done.lock, done.latch, done.recorder, done.followed.recorder)
        motions = _motions(done)
        with watch.stage("reactions"):
            overload = first_overload(motions, limits)
        result.status, termination = verdict(done, overload)
        summary = dataclasses.replace(summary, termination=termination, samples=len(result.time))
        if unbounded is not None:
            summary = without_figures(summary, done)
        else:
            summary, *others = with_figures([summary, *others], result, done, done.estimate, watch, motions)
    if unbounded is not None:  # the state there
        q = done.motion.system.split(unbounded.state)[0]
        names = done.motion.problem.model.q_names
        summary = dataclasses.replace(
            summary, final=FinalState(unbounded.time, dict(zip(names, q.tolist())), {})
        )
    if overload is not None:
        result.events.append({"time": overload.time, "name": overload.name, "kind": "overload"})
    result.events.sort(key=lambda event: float(event["time"]))
    keys = DeploySummary(
        criteria=criteria(done.motion, done.found, done.again),
        lock=_lock_keys(done),
        after_lock=ABSENT if failure is not None else _after_lock(done),
        overload=overload if limits and failure is None else ABSENT,
    )
    records = [summary, *others, keys]
    result.summarise(*records, seconds=watch.report())
    return result.unless(failure)


def _motions(done: Deployment) -> list[RecordedMotion]:
    """Return the motion up to the lock, and that behind it."""
    motion, relocated = recorded(done, done.estimate), done.relocated
    motion = dataclasses.replace(
        motion, first=FirstRun.of(done.driver, done.beginning, motion.first.grid, done.recorder)
    )
    if done.estimate is not None:
        again = motion.first
        if relocated is not None and relocated.lock is not None and not done.found.driven:
            again = dataclasses.replace(again, end=relocated.lock.time)
        motion = dataclasses.replace(motion, again=again)
    followed = done.followed
    return [motion, *([followed.whole] if followed is not None and followed.whole is not None else [])]


def _lock_keys(done: Deployment) -> LockKeys | None:
    if done.lock is None:
        return None
    relocated = done.relocated
    error = None if relocated is None else relocated.error
    keys = describe_lock(done.motion, done.found, done.lock, done.latch, error, done.recorder)
    if relocated is None or relocated.lock is None or done.estimate is None:
        return keys
    recorder = done.recorder
    if done.estimate.recorder is not None:
        recorder = done.estimate.recorder
        if not done.found.driven:
            # it may lock before the last sample that the first run has come to
            time, state = relocated.lock.time, relocated.lock.state
            recorder.go_back(time)
            recorder.emit(np.array([time]), state[None, :].copy(), done.driver.parameters)
    other = describe_lock(done.motion, relocated.scanned, relocated.lock, relocated.latch, error, recorder)
    other, keys = with_multipliers_beside(other, done.motion, done.lock), with_rounding(keys, done.latch)
    # the error of the time is known already
    return dataclasses.replace(with_others(keys, [other], relocated.factor, ("lock",)), time_error=error)


def _after_lock(done: Deployment) -> AfterLock | Absent | None:
    """Return what followed the lock; None where it was asked for and no latch could close."""
    if done.followed is not None:
        return done.followed.keys
    locked = done.lock is not None and done.lock.kind != "overload"
    return None if locked and done.motion.scene.deploy.after == "continue" else ABSENT


def verdict(done: Deployment, overload: Overload | None) -> tuple[str, dict[str, Any]]:
    """Return the status and how the run ended, in words."""
    lock = done.lock
    termination: dict[str, Any]
    if lock is None:
        status = "no_lock"
        termination = {"reason": "duration: no lock", "time": done.motion.scene.simulate.duration}
    else:
        status = "overload" if lock.kind == "overload" else "locked"
        termination = {"reason": _reason(done, lock), "time": lock.time, "kind": lock.kind}
    if done.followed is not None and done.followed.recorder is not None:
        termination["reason"] += "; then followed as the locked structure"
        termination["followed_until"] = done.followed.keys.until
    if overload is None:
        return status, termination
    termination["overload"] = overload_text(overload)
    return "overload", termination


def _reason(done: Deployment, lock: Lock) -> str:
    """Return why the run ended at the lock."""
    if lock.kind == "overload":
        return "the multipliers passed their threshold away from any singular configuration: overload"
    if lock.criterion == "latch":
        joint, at = latch_position(done.motion.scene)
        unit = done.motion.problem.model.coordinate_units[joint]
        return f"joint {joint} has come to {at:.6g} {unit}, where the latch closes"
    if lock.criterion == "multipliers":
        reason = "the multipliers passed their threshold"
        if lock.kind != "approaching_dead_point":
            return reason
        return f"{reason}, on the way to a dead point (criteria.dead_point)"  # with its error
    if done.found.driven:
        names = ", ".join(led_joints(done.motion.scene.prescribed))
        return (
            f"dead point under the prescribed motion of {names}: the passive joints cannot follow, and the "
            "multipliers diverge"
        )
    return "dead point: the passive block of Psi loses rank while Psi keeps it"

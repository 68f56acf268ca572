"""Deployment of a mechanism until it locks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import NumericalError
from robodyn_cli.integrators.runtime.integrator import Event, Grid, Integrator
from robodyn_cli.results.hdf5.writer import ResultWriter
from robodyn_cli.results.result import Result
from robodyn_cli.run.deploy.lock_report import bifurcation, conclude, criteria, describe_lock, events
from robodyn_cli.run.deploy.locked_motion import first_overload, follow_locked
from robodyn_cli.run.deploy.scan import Deployment, Found
from robodyn_cli.run.driver.gains import with_gains
from robodyn_cli.run.driver.redundancy import check_redundant
from robodyn_cli.run.driver.second_run import estimate_error
from robodyn_cli.run.observation.observe import Observer
from robodyn_cli.run.observation.reactions import ReactionSamples
from robodyn_cli.run.observation.recorder import Recorder
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.simulate import describe_run, fail, keep_last_state, kept_every, new_result
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene

Array = NDArray[np.float64]

# smallest singular value of the passive block, relative to the largest of Psi, that is still worth reporting
NEAR_SINGULAR = 1e-3

TRUSTED = 0.01  # relative error of a lock's time beyond which it is not reported as a lock


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
    RobodynError : with attribute ``result``; SingularConfigurationError at a bifurcation.
    """
    watch = watch or Stopwatch()
    scene, gains = with_gains(scene, watch)
    run = Deployment(scene, watch)
    with watch.stage("scan"):
        found = run.scan(run.options, progress=progress)
    stop, criterion = run.stop_time(found)
    bifurcated = found.bifurcation is not None and (stop is None or found.bifurcation[0] <= stop)
    met = found.bifurcation[0] if bifurcated and found.bifurcation is not None else stop
    recorder, integrator = _record(run, found, met, progress, watch, writer)
    result = new_result(scene, "deploy", recorder, events(run, found))
    describe_run(result, run.setup, recorder, integrator, run.choice)
    if gains is not None:
        result.summary["baumgarte"] = gains
    violated = check_redundant(run.problem, run.setup.assembled, recorder, result.summary)
    if violated is not None:
        raise fail(result, violated, watch)
    summary = result.summary
    summary["criteria"] = criteria(run, found)
    if bifurcated and found.bifurcation is not None:
        raise fail(result, bifurcation(run, found), watch)
    if stop is None and found.stopped is not None:
        raise fail(result, found.stopped, watch)
    if scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            grid = Grid.over(scene.simulate.duration, scene.simulate.samples)
            summary["error_estimate"] = estimate_error(
                run.problem, run.system, run.method, run.start, grid,
                float(recorder.array("time")[-1]), run.options, recorder, integrator.counters,
            )  # fmt: skip
    if stop is None:
        result.status = summary["status"] = "no_lock"
        summary["termination"] = {"reason": "duration: no lock", "time": scene.simulate.duration}
        summary["lock"] = None
    else:
        with watch.stage("lock"):
            summary["lock"] = describe_lock(run, found, stop, criterion, recorder, watch)
        conclude(result, run, found, stop, criterion)
        error = summary["lock"]["time_error"]
        if criterion == "dead_point" and error is not None and error > TRUSTED * stop:
            doubt = NumericalError(
                f"a dead point at t = {stop:.4g} s, but a second, tighter integration puts it {error:.2g} s away: the "
                "motion is too sensitive to say when it locks",
                time=stop,
                time_error=error,
            )
            raise fail(result, doubt, watch)
        if scene.deploy.after == "continue" and result.status == "locked":
            _follow(result, run, found, stop, criterion, recorder, watch)
    if scene.deploy.loads:
        _judge_loads(result, scene)
    summary["wall_time_s"] = watch.report()
    return result


def _follow(
    result: Result,
    run: Deployment,
    found: Found,
    stop: float,
    criterion: str,
    recorder: Recorder,
    watch: Stopwatch,
) -> None:
    """Go on as the locked structure, where the latch could close."""
    summary = result.summary
    if run.latch is None or run.impact is None:
        summary["after_lock"] = None
        return
    lost = {"energy_lost": run.impact.energy_lost, "degrees_of_freedom": run.latch.freedom}
    result.events.append({"time": stop, "name": run.latch.name, "kind": "lock", **lost})
    result.events.sort(key=lambda event: float(event["time"]))
    if found.dead_point is not None and criterion == "dead_point":
        state = found.dead_point[1]
    else:
        z = recorder.array("energy/work")[-1:] if "energy/work" in recorder.blocks else None
        state = run.system.join(recorder.array("q")[-1], recorder.array("qd")[-1], z)
    follow_locked(result, run, recorder, run.latch, run.impact, stop, state, watch)


def _judge_loads(result: Result, scene: Scene) -> None:
    """Turn the status into an overload where a joint or closure bore more than it may."""
    over = first_overload(result, scene.deploy.loads)
    result.summary["overload"] = over
    if over is None:
        return
    unit = "N" if over["quantity"] == "force" else "N m"
    result.status = result.summary["status"] = "overload"
    result.summary["termination"]["overload"] = (
        f"{over['name']} bears a {over['quantity']} of {over['value']:.6g} {unit} at t = {over['time']:.6g} s, more "
        f"than its {over['limit']:.6g} {unit}"
    )
    result.events.append({"time": over["time"], "name": over["name"], "kind": "overload"})
    result.events.sort(key=lambda event: float(event["time"]))


def _record(
    run: Deployment,
    found: Found,
    stop: float | None,
    progress: Progress,
    watch: Stopwatch,
    writer: ResultWriter | None,
) -> tuple[Recorder, Integrator]:
    """Integrate to ``stop`` on the scene's grid and observe; the last sample is the stop itself.

    The events are those of the scan, so that the steps are the same and a singular configuration is met in the
    same way: by a step from afar, never by creeping up to it.
    """
    scene = run.scene
    duration = scene.simulate.duration
    located = [x[0] for x in (found.dead_point, found.bifurcation) if x is not None and not found.driven]
    at_event = stop is not None and stop in located
    with watch.stage("equations"):
        observer = Observer(run.problem, run.system, run.passive)
        if scene.deploy.loads or scene.deploy.after == "continue":
            observer.reactions = ReactionSamples(run.problem, scene.simulate.samples)
        integrator = Integrator(run.system, run.method)
    recorder = Recorder(observer, writer, kept_every(scene, writer))
    grid = Grid.over(duration, scene.simulate.samples)
    integrator.reset(0.0, run.start, run.options)
    end = duration if stop is None or at_event else stop
    if found.stopped is not None:
        end = min(end, found.end)
    integrator.tick = lambda time: progress(time, end)

    def emit(t: Array, x: Array) -> None:
        if found.driven:
            # close to the dead point the rates of the passive joints grow without bound: nothing to report there
            angle = observer.singular_ratio(t, x)
            t, x = t[angle > NEAR_SINGULAR], x[angle > NEAR_SINGULAR]
        if len(t):
            recorder.emit(t, x)
        progress(float(t[-1]) if len(t) else end, end)

    if found.bifurcation is not None and stop == found.bifurcation[0]:
        # the way from the threshold on was travelled by extrapolation; samples stop short of the pose
        end = stop - 1e-2 * (stop - found.clean_until)
        grid = grid.up_to(int(end / grid.step) + 1)

    def on_event(event: Event) -> bool:
        return not (at_event and stop is not None and event.time >= stop - 1e-9 * max(1.0, stop))

    with watch.stage("integrate"):
        try:
            integrator.run(end, grid, emit, on_event)
        except NumericalError:
            if found.stopped is None:
                raise
        if found.bifurcation is not None and stop == found.bifurcation[0]:
            recorder.emit(np.array([stop]), found.bifurcation[1][None, :].copy(), project=False, extra=True)
            recorder.make_last_least_norm(stop)
        elif not found.driven:
            keep_last_state(recorder, integrator)
    return recorder, integrator

"""Forward dynamics: what motion do these torques give."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import (
    NumericalError,
    RobodynError,
    SingularConfigurationError,
)
from robodyn_cli.formulations.index1 import index1
from robodyn_cli.formulations.system import EventFunction
from robodyn_cli.integrators.runtime.integrator import Event, Grid, Integrator
from robodyn_cli.results.hdf5.writer import ResultWriter
from robodyn_cli.results.result import Result
from robodyn_cli.run.driver.contact_states import Modes
from robodyn_cli.run.driver.divergence import breakdown
from robodyn_cli.run.driver.mass_matrix import nearly_singular
from robodyn_cli.run.driver.method import Choice, Run
from robodyn_cli.run.driver.passage import Passage, passage_event
from robodyn_cli.run.driver.prepare import Setup, options_for, passive_coordinates, prepare
from robodyn_cli.run.driver.redundancy import check_redundant, describe_dependence
from robodyn_cli.run.driver.second_run import estimate_error
from robodyn_cli.run.driver.singularity import driven_dead_point, rank_loss_event, stop_at_rank_loss
from robodyn_cli.run.driver.start import start_warnings
from robodyn_cli.run.observation.observe import Observer
from robodyn_cli.run.observation.recorder import Recorder
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene

Array = NDArray[np.float64]
KEPT_IN_MEMORY = 100_000  # samples, when the whole goes to a file


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
    RobodynError : with attribute ``result`` holding what was computed until then.
    """
    watch = watch or Stopwatch()
    gains = None
    if scene.simulate.stabilisation == "baumgarte":
        from robodyn_cli.run.driver.gains import with_gains  # which needs this module

        scene, gains = with_gains(scene, watch)
    setup = prepare(scene, watch, modes=True)
    problem = setup.problem
    with watch.stage("equations"):
        events: tuple[EventFunction, ...] = ()
        if problem.model.closures and scene.simulate.singular == "stop":
            events = rank_loss_event(problem)
        elif problem.model.closures and not problem.gates:
            events = passage_event(problem)
        system = index1(problem, scene.simulate.stabilisation, events)
        observer = Observer(problem, system, passive_coordinates(problem))
        passing = scene.simulate.singular == "pass" and bool(events)
        passage = Passage(problem, system, observer) if passing else None
    grid = Grid.over(scene.simulate.duration, scene.simulate.samples)
    options = options_for(scene)
    start = system.join(setup.assembled.q, setup.assembled.v)
    with watch.stage("method"):
        modes = Modes(problem, system, options) if problem.gates else None
        first = start if modes is None else modes.start(0.0, start)
        run = Run(
            scene,
            problem,
            system,
            first,
            options,
            lambda time: progress(time, scene.simulate.duration),
            modes,
            passage,
        )
    recorder = Recorder(observer, writer, kept_every(scene, writer))
    found: list[dict[str, Any]] = []

    def emit(t: Array, x: Array) -> None:
        if modes is not None:
            modes.check(t, x)
            observer.parameters = modes.p.copy()
        recorder.emit(t, x)
        progress(float(t[-1]), scene.simulate.duration)

    def on_event(event: Event) -> bool:
        if system.events[event.index].kink:
            return True
        if modes is not None and modes.owns(event):
            return modes.on_event(event)
        stop_at_rank_loss(problem, system, run.choice.method, event, options)
        return True

    failure: RobodynError | None = None
    with watch.stage("integrate"):
        try:
            run.run(scene.simulate.duration, grid, emit, on_event)
        except RobodynError as error:
            keep_last_state(recorder, run.integrator)
            failure = explained(error, problem, run.integrator, scene.simulate.duration)
    integrator = run.integrator
    result = new_result(scene, "simulate", recorder, found if modes is None else modes.log)
    describe_run(result, setup, recorder, integrator, run.choice)
    if warnings := start_warnings(problem, setup.assembled.q, passive_coordinates(problem) or []):
        result.summary["warnings"] = warnings
    if gains is not None:
        result.summary["baumgarte"] = gains
    failure = check_redundant(problem, setup.assembled, recorder, result.summary) or failure
    result.summary["counters"] = run.counters.as_dict()
    if modes is not None:
        result.summary["transitions"] = dict(modes.counts)
    if passage is not None:
        result.summary["passed"] = list(passage.crossed)
    if run.switches:
        result.summary["switches"] = run.switches
    if failure is not None:
        raise fail(result, failure, watch)
    result.summary["termination"] = {"reason": "duration", "time": integrator.time}
    if scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            result.summary["error_estimate"] = estimate_error(
                problem, system, integrator.stepper.name, start, grid, integrator.time, options, recorder, run.counters,
                lambda time: progress(time, scene.simulate.duration), passage,
            )  # fmt: skip
        if reason := result.summary["error_estimate"].get("reason"):
            result.summary.setdefault("warnings", []).append(f"nothing vouches for this motion: {reason}")
    result.summary["wall_time_s"] = watch.report()
    return result


def explained(error: RobodynError, problem: Problem, integrator: Integrator, duration: float) -> RobodynError:
    """Return the error of a run that could not go on, with its cause where that can be told."""
    if not isinstance(error, NumericalError):
        return error
    q, _, _ = integrator.system.split(integrator.y)
    pose = driven_dead_point(problem, passive_coordinates(problem) or [], q, integrator.time, duration)
    if pose is not None:
        time, where, kind = pose
        names = ", ".join(problem.scene.prescribed or {})
        what = "dead point" if kind == "dead_point" else "singular configuration"
        return SingularConfigurationError(
            f"{what} at t = {time:.9g} s under the prescribed motion of {names}: the passive joints cannot follow, "
            "and the multipliers diverge",
            time=time, kind=kind, q=where.tolist(),
        )  # fmt: skip
    words, place = breakdown(problem, integrator, str(error.details.get("status")))
    cause = nearly_singular(problem.model, q)
    return NumericalError(error.message + words + cause, **{**place, **error.details})


def kept_every(scene: Scene, writer: ResultWriter | None) -> int:
    """Return which samples stay in memory beside the file: every n-th."""
    return 1 if writer is None else -(-scene.simulate.samples // KEPT_IN_MEMORY)


def keep_last_state(recorder: Recorder, integrator: Integrator) -> None:
    """Record the last state that a failed run reached, if it lies beyond the last sample."""
    if not np.all(np.isfinite(integrator.y)):
        return
    if integrator.time > recorder.last_time:
        recorder.emit(np.array([integrator.time]), integrator.y[None, :].copy(), extra=True)


def new_result(scene: Scene, command: str, recorder: Recorder, events: list[dict[str, Any]]) -> Result:
    """Return a Result with everything that was recorded."""
    result = Result(command, scene.title or command, "ok", scene.text, events=events)
    recorder.fill(result)
    return result


def describe_run(
    result: Result, setup: Setup, recorder: Recorder, integrator: Integrator, choice: Choice
) -> None:
    """Fill in what every simulation reports: integrator, counters, energy drift, residuals."""
    summary = result.summary
    summary["status"] = "ok"
    summary["termination"] = {}
    summary["integrator"] = choice.method
    summary["integrator_reason"] = choice.reason
    summary["tolerances"] = {"rtol": integrator.options.rtol, "atol": integrator.options.atol}
    if integrator.options.step is not None:
        summary["tolerances"] = {"step": integrator.options.step}
    summary["samples"] = recorder.samples
    summary["error_estimate"] = None
    summary["energy_drift"] = recorder.drift
    summary["energy_drift_relative"] = (
        recorder.drift / recorder.energy_scale if recorder.energy_scale else 0.0
    )
    summary["energy_balance"] = (
        "kinetic + potential - work" if integrator.system.further else "kinetic + potential"
    )
    if setup.problem.constraints.rows:
        summary["constraint_residual"] = {
            "position": recorder.position_residual, "velocity": recorder.velocity_residual,
        }  # fmt: skip
        summary["assembly"] = {
            "position_residual": setup.assembled.position_residual,
            "velocity_residual": setup.assembled.velocity_residual,
            "redundant_rows": list(setup.assembled.redundant),
            "vanishing_rows": list(setup.problem.constraints.dropped),
        }
        if setup.problem.scene.simulate.stabilisation == "independent":
            summary["repartitions"] = integrator.parameters.renewals
        summary["multipliers"] = describe_dependence(setup.problem, integrator.parameters.renewals)
    if recorder.observer.reactions is not None:
        summary["reactions"] = {**recorder.observer.reactions.note(), "largest": recorder.loads}
    summary["counters"] = integrator.counters.as_dict()


def fail(result: Result, error: RobodynError, watch: Stopwatch) -> RobodynError:
    """Mark the result as failed and hang it on the error."""
    result.status = "failed"
    result.summary["status"] = "failed"
    result.summary["termination"] = {"reason": error.message, **error.details}
    result.summary["wall_time_s"] = watch.report()
    error.result = result  # type: ignore[attr-defined]
    return error

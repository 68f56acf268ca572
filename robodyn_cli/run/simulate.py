"""Forward dynamics: what motion do these torques give."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, RobodynError, SceneError, SingularConfigurationError
from robodyn_cli.formulations.index1 import index1
from robodyn_cli.formulations.system import EventFunction, System
from robodyn_cli.integrators.integrator import Counters, Event, Grid, Integrator, Options
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.results.result import Result
from robodyn_cli.results.writer import ResultWriter
from robodyn_cli.run.divergence import breakdown
from robodyn_cli.run.mass_matrix import nearly_singular, refuse_singular
from robodyn_cli.run.method import Choice, Run
from robodyn_cli.run.observe import Observer, Recorder
from robodyn_cli.run.prescribed import check_prescribed, prescribed_starts
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.redundancy import check_redundant, dependent_rows, describe_dependence
from robodyn_cli.run.singularity import driven_dead_point, rank_loss_event, stop_at_rank_loss
from robodyn_cli.run.start import start_warnings
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.assembly import Assembled, assemble

Array = NDArray[np.float64]
# the second run of the error estimate: this much tighter, but not below what double precision can resolve
TIGHTER = 50.0
TIGHTEST_RTOL = 3e-14
KEPT_IN_MEMORY = 100_000  # samples, when the whole goes to a file


@dataclasses.dataclass
class Setup:
    """A scene made ready: equations, consistent initial state."""

    problem: Problem
    assembled: Assembled
    watch: Stopwatch


def prepare(scene: Scene, watch: Stopwatch | None = None) -> Setup:
    """Build the equations and close the loops at t = 0.

    Raises
    ------
    SceneError : an initial position is missing. GeometryError, SingularConfigurationError : from the assembly.
    """
    watch = watch or Stopwatch()
    with watch.stage("equations"):
        problem = Problem(scene)
        given = initial_positions(scene, problem)
        held = held_columns(scene, problem)
    with watch.stage("assemble"):
        check_prescribed(problem)
        hold = [*held, *(n for n in scene.prescribed or {} if n not in held)]
        assembled = assemble(problem, given, dict(scene.initial.qd or {}), hold)
        refuse_singular(problem.model, assembled.q)
    if assembled.redundant:
        with watch.stage("equations"):
            groups = dependent_rows(problem, assembled)
            keep = None if groups else assembled.independent
            problem = Problem(scene, keep_rows=keep, model=problem.model, dependent=groups)
    return Setup(problem, assembled, watch)


def held_columns(scene: Scene, problem: Problem) -> list[str]:
    """Return the coordinates of the joints in `initial.hold`."""
    return [column for name in scene.initial.hold for column in problem.model.q_columns(name)]


def initial_positions(scene: Scene, problem: Problem) -> dict[str, float]:
    """Return the positions at t = 0 that the scene gives, prescribed joints included, by coordinate.

    Raises
    ------
    SceneError : a position is missing.
    """
    given = {**(scene.initial.q or {}), **prescribed_starts(scene)}
    loops = bool(problem.model.closures)
    for name in held_columns(scene, problem) if loops else problem.model.q_names:
        if name not in given:
            why = (
                "`initial.hold` keeps it at its value" if loops else "an open chain needs one for each joint"
            )
            what = "coordinate" if "." in name else "joint"
            raise SceneError(
                f"{scene.path}: initial.q: {what} {name!r} has no initial position ({why})",
                file=scene.path, key="initial.q",
            )  # fmt: skip
    return given


def options_for(scene: Scene) -> Options:
    s = scene.simulate
    return Options(s.rtol, s.atol, s.step, max_steps=s.max_steps)


def tighter(options: Options, mean_step: float) -> tuple[Options, str]:
    """Return the options of the second run of the error estimate, and how it differs in words."""
    if options.step is not None:
        # a step longer than the run is as long as the run
        taken = options.step if options.step < 2.0 * mean_step else mean_step
        return dataclasses.replace(options, step=taken / 2), "step halved"
    if options.rtol >= 1e-12:
        rtol = max(options.rtol / TIGHTER, TIGHTEST_RTOL)
        atol = options.atol * rtol / options.rtol
        return dataclasses.replace(options, rtol=rtol, atol=atol), f"rtol {rtol:.1g}"
    # at the limit of double precision a tighter tolerance says nothing; other steps show the rounding errors
    return other_steps(options, mean_step)


def other_steps(options: Options, mean_step: float) -> tuple[Options, str]:
    """Return the options of a second run with shorter steps, and how it differs in words."""
    return dataclasses.replace(options, max_step=0.6 * mean_step), "steps 0.6 times as long"


def integrate_states(
    system: System, method: str, start: Array, grid: Grid, end: float, options: Options
) -> tuple[Array, Counters]:
    """Integrate without observing, looking for kinks only; returns states (T, nx) up to ``end`` and the counters."""
    kinks = tuple(event for event in system.events if event.kink or event.renewal)
    if kinks and len(kinks) < len(system.events):
        system = dataclasses.replace(system, events=kinks)
    integrator = Integrator(system, method)
    integrator.reset(grid.start, start, options)
    rows: list[Array] = []
    integrator.run(end, grid, lambda t, x: rows.append(x), watch=bool(kinks))
    return np.concatenate(rows), integrator.counters


def estimate_error(
    setup: Setup,
    system: System,
    method: str,
    start: Array,
    grid: Grid,
    end: float,
    options: Options,
    recorder: Recorder,
    counters: Counters,
) -> dict[str, Any]:
    """Estimate the global error by a second integration that is more accurate than the first.

    The difference of the two is the error of the first, up to the (much smaller) error of the second: the
    largest over all samples, for q and qd apart. Nothing else about the two runs is shared but the method.
    """
    second, how = tighter(options, end / max(counters.steps, 1))
    grid = grid.every(recorder.every)
    report: dict[str, Any] = {"method": f"difference from a second integration with {how}"}
    try:
        states, more = integrate_states(system, method, start, grid, end, second)
        if more.steps == counters.steps and options.step is None:
            # the tolerance does not decide about the steps, so the same ones were taken once more
            second, how = other_steps(options, end / max(counters.steps, 1))
            report["method"] = f"difference from a second integration with {how}"
            states, more = integrate_states(system, method, start, grid, end, second)
    except NumericalError as error:
        report.update(state_max=None, reason=f"the second integration failed: {error.message}")
        return report
    states = recorder.observer.project(grid.times(0, len(states)), states)
    q, qd = recorder.array("q")[: len(states)], recorder.array("qd")[: len(states)]
    states = states[: len(q)]
    halved = 2.0 ** registry[method].order
    scale = 1.0 if registry[method].adaptive else halved / (halved - 1.0)
    other_q, other_qd, _ = system.split(states)
    dq, dv = scale * np.abs(other_q - q), scale * np.abs(other_qd - qd)
    floor = rounding_floor(q, qd, counters.steps)
    report.update(
        q_max=float(dq.max(initial=0.0)), qd_max=float(dv.max(initial=0.0)),
        state_max=float(max(dq.max(initial=0.0), dv.max(initial=0.0))),
        q_end=float(dq[-1].max(initial=0.0)), qd_end=float(dv[-1].max(initial=0.0)), rounding_floor=floor,
        steps=more.steps,
    )  # fmt: skip
    spread = float(max(np.ptp(q, axis=0).max(initial=0.0), 1e-300))
    if report["state_max"] > 1e-2 * max(spread, float(np.ptp(qd, axis=0).max(initial=0.0))):
        times = recorder.array("time")
        bad = np.flatnonzero(np.max(dq, axis=1) > 1e-2 * spread)
        report["meaningful_until"] = float(times[bad[0]]) if len(bad) else float(times[-1])
    report["at_rounding"] = bool(report["state_max"] < 100 * floor)
    return report


def rounding_floor(q: Array, qd: Array, steps: int) -> float:
    """Return the error that rounding alone is expected to leave: eps times the state, growing as sqrt(steps)."""
    size = max(float(np.abs(q).max(initial=0.0)), float(np.abs(qd).max(initial=0.0)))
    return 1.1e-16 * size * max(1.0, steps) ** 0.5


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
        from robodyn_cli.run.gains import with_gains  # which needs this module

        scene, gains = with_gains(scene, watch)
    setup = prepare(scene, watch)
    problem = setup.problem
    with watch.stage("equations"):
        events: tuple[EventFunction, ...] = ()
        if problem.model.closures and scene.simulate.singular == "stop":
            events = rank_loss_event(problem)
        system = index1(problem, scene.simulate.stabilisation, events)
        observer = Observer(problem, system, passive_coordinates(problem))
    grid = Grid.over(scene.simulate.duration, scene.simulate.samples)
    options = options_for(scene)
    start = system.join(setup.assembled.q, setup.assembled.v)
    with watch.stage("method"):
        run = Run(
            scene, problem, system, start, options, lambda time: progress(time, scene.simulate.duration)
        )
    recorder = Recorder(observer, writer, kept_every(scene, writer))
    found: list[dict[str, Any]] = []

    def emit(t: Array, x: Array) -> None:
        recorder.emit(t, x)
        progress(float(t[-1]), scene.simulate.duration)

    def on_event(event: Event) -> bool:
        if system.events[event.index].kink:
            return True
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
    result = new_result(scene, "simulate", recorder, found)
    describe_run(result, setup, recorder, integrator, run.choice)
    if warnings := start_warnings(problem, setup.assembled.q, passive_coordinates(problem) or []):
        result.summary["warnings"] = warnings
    if gains is not None:
        result.summary["baumgarte"] = gains
    failure = check_redundant(problem, setup.assembled, recorder, result.summary) or failure
    result.summary["counters"] = run.counters.as_dict()
    if run.switches:
        result.summary["switches"] = run.switches
    if failure is not None:
        raise fail(result, failure, watch)
    result.summary["termination"] = {"reason": "duration", "time": integrator.time}
    if scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            result.summary["error_estimate"] = estimate_error(
                setup,
                system,
                integrator.stepper.name,
                start,
                grid,
                integrator.time,
                options,
                recorder,
                run.counters,
            )
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


def passive_coordinates(problem: Problem) -> list[int] | None:
    """Return the velocity coordinates that nothing drives, None without loops.

    Actuated are the joints of ``actuated`` (by default those in ``torques``) and prescribed ones.
    """
    scene, model = problem.scene, problem.model
    if not model.closures:
        return None
    driven = {*(scene.torques or {}), *(scene.prescribed or {})}
    if scene.actuated is not None:
        driven = {*(scene.prescribed or {}), *(x for name in scene.actuated for x in model.v_columns(name))}
    return [k for k, name in enumerate(model.v_names) if name not in driven]


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

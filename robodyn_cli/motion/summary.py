"""The summary of a motion that was integrated: the keys that ``simulate`` and ``deploy`` share."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.integrators.runtime.options import Counters, Options
from robodyn_cli.loops.base import closure_of
from robodyn_cli.motion.motion import Gains, Motion
from robodyn_cli.motion.second_run import ErrorEstimate
from robodyn_cli.motion.self_check import Judgement, Run, estimate_warnings
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent, Residual, Termination

if TYPE_CHECKING:
    from robodyn_cli.drives.figures import DriveFigures
    from robodyn_cli.motion.redundancy import Redundant
    from robodyn_cli.observe.control_summary import ControlSummary


@record
class Assembly:
    """Residuals of the loops at t = 0 [m, m/s]; rows that follow from others, and rows that vanish identically."""

    position_residual: float
    velocity_residual: float
    redundant_rows: list[str]
    vanishing_rows: list[str]


@record
class DependentRows:
    """Rows of which only ``rank`` are independent, and the loops that they belong to."""

    loops: list[str]
    rows: list[str]
    rank: int


@record
class Multipliers:
    """Whether the multipliers are unique, else which were chosen and why."""

    unique: bool
    choice: str | Absent = ABSENT
    dependent: list[DependentRows] | Absent = ABSENT
    renewals: int | Absent = ABSENT


@record
class MethodKeys:
    """A change of method on the way: time [s], the new method, time constant of the fastest decay there [s]."""

    time: float
    to: str
    fastest_decay: float | None


@record
class FinalState:
    """The last state of a run: time [s], positions [rad or m] and rates [rad/s or m/s] by joint."""

    time: float
    q: dict[str, float]
    qd: dict[str, float]

    @staticmethod
    def of(run: Run) -> FinalState:
        """Return the state that the driver has come to."""
        model = run.motion.problem.model
        q, v, _ = run.motion.system.split(run.driver.state)
        return FinalState(
            run.driver.time,
            dict(zip(model.q_names, q.tolist())),
            dict(zip(model.v_names, v.tolist())),
        )


@record
class MotionSummary:
    """Keys of the summary of every integrated motion, in their order.

    transitions : of contact states, how many of each kind. payloads : when each was gripped and released [s], and the
    energy that gripping it took [J]. passed : times of poses [s]. switches : of the method.
    """

    termination: Termination | dict[str, Any]
    integrator: str
    integrator_reason: str
    tolerances: dict[str, float]
    samples: int
    error_estimate: ErrorEstimate | None
    energy_drift: float
    energy_drift_relative: float
    energy_balance: str
    constraint_residual: Residual | Absent
    assembly: Assembly | Absent
    repartitions: int | Absent
    multipliers: Multipliers | Absent
    reactions: dict[str, Any] | Absent
    counters: Counters
    warnings: list[str] | Absent
    baumgarte: Gains | Absent
    switches: list[MethodKeys] | Absent
    control: ControlSummary | Absent = ABSENT
    transitions: dict[str, int] | Absent = ABSENT
    payloads: dict[str, dict[str, float]] | Absent = ABSENT
    passed: list[float] | Absent = ABSENT
    final: FinalState | Absent = ABSENT
    drives: dict[str, DriveFigures] | Absent = ABSENT
    catalogue: str | Absent = ABSENT


def motion_summary(run: Run, judgement: Judgement, estimate: ErrorEstimate | None) -> MotionSummary:
    """Return what samples, counters and watchers say of a run."""
    motion, driver, recorder, failure = run.motion, run.driver, run.recorder, judgement.failure
    problem, observer = motion.problem, recorder.observer
    constrained = bool(problem.constraints.rows)
    independent = constrained and motion.scene.simulate.stabilisation == "independent"
    summary = MotionSummary(
        termination=Termination("duration", driver.time) if failure is None else failure.termination,
        integrator=motion.choice.method,
        integrator_reason=motion.choice.reason,
        tolerances=tolerances(motion.options),
        samples=recorder.samples,
        error_estimate=estimate,
        energy_drift=recorder.drift,
        energy_drift_relative=recorder.drift / recorder.energy_scale if recorder.energy_scale else 0.0,
        energy_balance="kinetic + potential - work" if motion.system.work_done_by else "kinetic + potential",
        constraint_residual=residual_of(recorder, judgement.redundant) if constrained else ABSENT,
        assembly=_assembly(motion) if constrained else ABSENT,
        repartitions=driver.repartitions if independent else ABSENT,
        multipliers=describe_dependence(problem, driver.repartitions) if constrained else ABSENT,
        reactions={**observer.reactions.note(), "largest": recorder.loads} if observer.reactions else ABSENT,
        counters=driver.counters,
        warnings=[*judgement.warnings, *estimate_warnings(estimate)] or ABSENT,
        baumgarte=motion.gains or ABSENT,
        switches=[MethodKeys(c.time, c.to, c.decay_time) for c in driver.changes] or ABSENT,
        final=FinalState.of(run),
    )
    if problem.control is not None:
        from robodyn_cli.observe.control_summary import control_summary

        followed = control_summary(problem.control, recorder, driver.time, run.beginning.time)
        summary = dataclasses.replace(summary, control=followed)
    for watcher in driver.watchers:
        summary = dataclasses.replace(summary, **watcher.facts(driver.time))
    return summary


def residual_of(recorder: Recorder, redundant: Redundant | None = None) -> Residual:
    """Return the largest residuals of the loops over the samples."""
    left_out = ABSENT if redundant is None else redundant.residual
    return Residual(recorder.position_residual, recorder.velocity_residual, redundant=left_out)


def _assembly(motion: Motion) -> Assembly:
    closed, dropped = motion.assembled, motion.problem.constraints.dropped
    return Assembly(closed.position_residual, closed.velocity_residual, list(closed.redundant), list(dropped))


def tolerances(options: Options) -> dict[str, float]:
    """Return what the accuracy was asked by: tolerances, or a fixed step [s]."""
    if options.step is not None:
        return {"step": options.step}
    return {"rtol": options.rtol, "atol": options.atol}


def describe_dependence(problem: Problem, repartitions: int) -> Multipliers:
    """Return what the summary says about the multipliers: unique, or of least norm and why."""
    if not problem.dependent:
        return Multipliers(True)
    groups = [
        DependentRows(sorted({closure_of(name) for name in g.rows}), list(g.rows), g.rank)
        for g in problem.dependent
    ]
    return Multipliers(False, "least norm", groups, repartitions)

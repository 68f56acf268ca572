"""What the summary says of a motion that was integrated: the keys that ``simulate`` and ``deploy`` share."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.loops.base import closure_of
from robodyn_cli.motion.motion import Motion
from robodyn_cli.motion.self_check import Judgement, Run, estimate_warnings
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.summaries.facts import ABSENT, LoopResidual, Termination
from robodyn_cli.summaries.motion import (
    Accuracy,
    Assembly,
    DependentRows,
    FinalState,
    MethodKeys,
    MotionErrors,
    MotionSummary,
    MultiplierChoice,
)

if TYPE_CHECKING:
    from robodyn_cli.motion.self_check import Redundant


def final_state(run: Run) -> FinalState:
    """Return the state that the driver has come to."""
    model = run.motion.problem.model
    q, v, _ = run.motion.system.split(run.driver.state)
    return FinalState(
        run.driver.time, dict(zip(model.q_names, q.tolist())), dict(zip(model.v_names, v.tolist()))
    )


def motion_records(run: Run, judgement: Judgement, estimate: MotionErrors | None) -> list[Any]:
    """Return what samples, counters and watchers say of a run; what a controller did is a record of its own."""
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
        reactions=observer.reactions.described(recorder.loads) if observer.reactions else ABSENT,
        counters=driver.counters,
        warnings=[*judgement.warnings, *estimate_warnings(estimate)] or ABSENT,
        baumgarte=motion.gains or ABSENT,
        switches=[MethodKeys(c.time, c.to, c.decay_time) for c in driver.changes] or ABSENT,
        final=final_state(run),
    )
    for watcher in driver.watchers:
        summary = dataclasses.replace(summary, **watcher.facts(driver.time))
    if problem.control is None:
        return [summary]
    from robodyn_cli.observe.control_summary import control_keys

    return [summary, control_keys(problem.control, recorder, driver.time, run.beginning.time)]


def residual_of(recorder: Recorder, redundant: Redundant | None = None) -> LoopResidual:
    """Return the largest residuals of the loops over the samples."""
    left_out = ABSENT if redundant is None else redundant.residual
    return LoopResidual(recorder.position_residual, recorder.velocity_residual, redundant=left_out)


def _assembly(motion: Motion) -> Assembly:
    closed, dropped = motion.assembled, motion.problem.constraints.dropped
    return Assembly(closed.position_residual, closed.velocity_residual, list(closed.redundant), list(dropped))


def tolerances(options: Options) -> Accuracy:
    """Return what the accuracy was asked by: tolerances, or a fixed step [s]."""
    if options.step is not None:
        return Accuracy(step=options.step)
    return Accuracy(options.rtol, options.atol)


def describe_dependence(problem: Problem, repartitions: int) -> MultiplierChoice:
    """Return what the summary says about the multipliers: unique, or of least norm and why."""
    if not problem.dependent:
        return MultiplierChoice(True)
    groups = [
        DependentRows(sorted({closure_of(name) for name in g.rows}), list(g.rows), g.rank)
        for g in problem.dependent
    ]
    return MultiplierChoice(False, "least norm", groups, repartitions)

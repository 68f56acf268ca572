"""A run checks itself (redundant rows that were left out and do not hold, numbers that are not finite, energy out of
balance, doubts), and says in the summary what ``simulate`` and ``deploy`` share."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError, NumericalError, RobodynError
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.loops.base import closure_of
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.motion import Beginning, Motion
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.solve.closing.assembly import Assembled
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, LoopResidual, Termination
from robodyn_cli.summaries.motion import (
    NOT_MEANINGFUL,
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
    from robodyn_cli.equations.control.control import Control
    from robodyn_cli.motion.second_run import Estimate
    from robodyn_cli.summaries.control import ControlKeys

OPEN = 1e-6  # rad, or part of the size of the mechanism, from which on a constraint is violated


@record
class Redundant:
    """Largest residual of the redundant rows, and the error where they are violated."""

    residual: float
    violated: GeometryError | None = None


def check_redundant(problem: Problem, assembled: Assembled, recorder: Recorder) -> Redundant:
    """Evaluate the residuals of the redundant rows along the samples."""
    whole = Problem(problem.scene, model=problem.model)
    # combined rows are solved together, so each may be the one that opens
    named = problem.constraints.names if problem.dependent else assembled.redundant
    rows = [row for row in whole.constraints.rows if row.name in named]
    q, t = recorder.array("q"), recorder.array("time")
    values = evaluate([row.eta for row in rows], {"q": list(q.T), "t": [t], "p": []})
    residual = np.abs(np.column_stack([np.broadcast_to(value, t.shape) for value in values]))
    size = mechanism_size(problem.model)
    limits = np.array([OPEN * (size if row.kind in ("force", "m") else 1.0) for row in rows])
    broken = np.argwhere(residual > limits)
    largest = float(residual.max())
    if not len(broken):
        return Redundant(largest)
    k, i = (int(x) for x in broken[0])
    row = rows[i]
    unit = "m" if row.kind in ("force", "m") else "rad"
    error = GeometryError(
        f"the scene asks for more than the mechanism can do: {row.name}, which followed from the other constraints at "
        f"the start, is violated from t = {t[k]:.6g} s on, by up to {residual[:, i].max():.3g} {unit}",
        time=float(t[k]), row=row.name, residual=float(residual[:, i].max()),
    )  # fmt: skip
    return Redundant(largest, error)


EPS = float(np.finfo(float).eps)
BEYOND = 1e3  # times what tolerance and rounding explain: a larger error of the energy ends the run
STEADY = 1e-6  # in place of rtol where the step is fixed
MANY = 1e3  # steps from which on errors add up


@record
class Run:
    """A motion that has been integrated: from where, by whom, and what was recorded."""

    motion: Motion
    beginning: Beginning
    driver: Driver
    recorder: Recorder


@record
class Judgement:
    """Why a run failed, None if it did not, what is doubtful about it, in words, and what rows left out say."""

    failure: RobodynError | None
    warnings: tuple[str, ...]
    redundant: Redundant | None


def judge(run: Run, stopped: RobodynError | None) -> Judgement:
    """Judge a simulation by its samples; ``stopped`` is what ended it before its time."""
    redundant = redundant_rows(run) if run.motion.assembled.redundant else None
    warnings = motion_warnings(run)
    failure = (redundant and redundant.violated) or stopped or run.recorder.not_finite
    lost = energy_out_of_balance(run) if failure is None else None
    if lost is not None and is_judged_by_energy(run.motion):
        failure = lost
    elif lost is not None:
        warnings.append(lost.message)
    return Judgement(failure, tuple(warnings), redundant)


def redundant_rows(run: Run) -> Redundant | None:
    """Return what the rows that were left out say along the samples, None where there are no such rows."""
    assembled = run.motion.assembled
    if not assembled.redundant or not run.recorder.samples:
        return None

    return check_redundant(run.motion.problem, assembled, run.recorder)


def motion_warnings(run: Run) -> list[str]:
    """Return what is doubtful about a motion: told by its watchers, its formulas, its start and its steps."""
    motion = run.motion
    warnings = [*run.beginning.told, *(text for watcher in motion.watchers for text in watcher.warnings)]
    warnings += [
        f"{key}: this function of time changes so often, or on so short a scale, that not every change was found; "
        "steps may miss some: set simulate.max_step below the shortest"
        for key, structure in motion.problem.switching.time_structures
        if not structure.resolved
    ]
    control = motion.scene.control
    if control is not None and motion.scene.trajectory is not None and not control.follows:
        warnings.append(
            f"control: {control.type!r} holds its pose; it does not follow the 'trajectory', which leads nothing here"
        )
    if motion.passive:
        from robodyn_cli.motion.failure import start_warnings

        warnings += start_warnings(motion.problem, motion.assembled.q, motion.passive)
    if motion.scene.robot.limited:
        warnings += beyond_limits(run)
    return [*warnings, *shortened_steps(run)]


def beyond_limits(run: Run) -> list[str]:
    """Return warnings about limits of acceleration and jerk that samples are beyond; a watcher locates the others."""
    scene, recorder = run.motion.scene, run.recorder
    if not scene.robot.limited or not recorder.samples:
        return []
    from robodyn_cli.observe.joint_limits import limit_warnings, limited_joints

    joints = limited_joints(scene, run.motion.problem.model)
    times = recorder.array("time")
    breaks = recorder.breaks(times, run.driver.instants)
    return limit_warnings(joints, times, {"qdd": recorder.array("qdd")}, breaks=breaks)


def energy_out_of_balance(run: Run) -> NumericalError | None:
    """Return the error of a run that gains or loses more energy than its tolerances explain, with its time.

    Allowed is BEYOND times the largest of: rtol times the largest energy (summed over the steps where there are very
    many); what an error of atol in each coordinate, and what rounding has made of the rates, makes of the energy;
    rounding over the steps.
    """
    recorder, steps, options = run.recorder, run.driver.counters.steps, run.motion.options
    if not recorder.samples:
        return None
    time, kinetic = recorder.array("time"), recorder.array("energy/kinetic")
    work = recorder.array("energy/work") if "energy/work" in recorder.blocks else np.zeros(len(time))
    course = EnergyCourse(
        kinetic, recorder.array("energy/potential"), work, recorder.array("q"), recorder.array("qd")
    )
    rounding = sum(watcher.rounding for watcher in run.motion.watchers) + run.driver.rounded
    drift, allowed = course.drift, course.allowed(steps, options, rounding)
    beyond = np.flatnonzero(drift > allowed)
    if not len(beyond):
        return None
    k = int(beyond[0])
    worst = float(drift[beyond].max())
    return NumericalError(
        f"the balance of energy is lost from t = {time[k]:.6g} s on: it is off by {worst:.3g} J at most, where "
        f"tolerances and rounding explain {allowed[-1] / BEYOND:.1g} J",
        time=float(time[k]), status="energy_balance", energy_drift=worst,
    )  # fmt: skip


def allowed_drift(exchanged: Any, level: Any, steps: Any, rtol: float) -> Any:
    """Return by how much energies [J] at this ``level``, so much of them ``exchanged``, may be off; numbers or arrays.

    BEYOND times what rtol explains, summed over the steps where there are very many, or rounding over the steps.
    """
    rounding = EPS * np.maximum(steps, 1) * (exchanged + level)
    return BEYOND * np.maximum(rtol * np.maximum(1.0, steps / MANY) * exchanged, rounding)


@record
class EnergyCourse:
    """Energies and the work that was done [J] over samples (T,), coordinates and rates there (T, n); runs side by
    side have (T, N) and (T, N, n)."""

    kinetic: Array
    potential: Array
    work: Array
    q: Array
    v: Array

    @property
    def drift(self) -> Array:
        """By how much the balance is off [J]."""
        total = self.kinetic + self.potential
        off: Array = np.abs(total - self.work - (total[0] - self.work[0]))
        return off

    def allowed(self, steps: Any, options: Options, rounding: Any) -> Array:
        """Return by how much it may be off [J]; rounding : what is left in the rates beside ``atol``."""
        level, risen = np.abs(self.potential).max(axis=0), np.abs(self.potential - self.potential[0])
        # energies have no zero: what counts is how far they range so far
        exchanged = np.maximum.accumulate(
            self.kinetic + risen + np.abs(self.work - self.work[0]) + level * EPS
        )
        rtol = options.rtol if options.step is None else STEADY
        least = BEYOND * (options.atol + rounding) * self._sensitivity(exchanged)
        allowed: Array = np.maximum(allowed_drift(exchanged, level, steps, rtol), least)
        return allowed

    def _sensitivity(self, exchanged: Array) -> Array:
        """Return how much energy an error of one unit in each coordinate and rate stands for, roughly [J]."""
        fastest = np.maximum.accumulate(np.abs(self.v).max(axis=-1, initial=0.0))
        moved = np.maximum.accumulate(np.abs(self.q - self.q[0]).max(axis=-1, initial=0.0))
        small = 1e-12
        energies: Array = exchanged * (2.0 / np.maximum(fastest, small) + 1.0 / np.maximum(moved, small))
        return energies


def shortened_steps(run: Run) -> list[str]:
    """Return a warning about steps of a fixed length that could not be taken as they are."""
    step, shorter = run.motion.options.step, run.driver.counters.rejected
    if step is None or not shorter:
        return []
    return [
        f"the equations of a step of {step:.3g} s had no solution {shorter} times, and shorter steps were taken there; "
        "a shorter simulate.step avoids that"
    ]


def is_judged_by_energy(motion: Motion) -> bool:
    """Tell whether energy out of balance ends a run: where steps adapt to a tolerance and loops are kept closed."""
    kept_closed = motion.scene.simulate.stabilisation in ("projection", "independent")
    return methods[motion.choice.method].adaptive and (kept_closed or not motion.problem.constraints.rows)


def estimate_warnings(estimate: MotionErrors | None) -> list[str]:
    """Return warnings about a motion that no second run confirms, or whose estimated error is beyond all use."""
    if estimate is not None and estimate.reason is not ABSENT:
        return [f"no second run confirms this motion: {estimate.reason}"]
    if estimate is None or not isinstance(estimate.meaningful_until, float):
        return []
    return [
        f"the motion is not meaningful after t = {estimate.meaningful_until:.4g} s: its estimated error is above "
        f"{NOT_MEANINGFUL:.0%} of what its coordinates range over"
    ]


def final_state(run: Run) -> FinalState:
    """Return the state that the driver has come to."""
    model = run.motion.problem.model
    q, v, _ = run.motion.system.split(run.driver.state)
    return FinalState(
        run.driver.time, dict(zip(model.q_names, q.tolist())), dict(zip(model.v_names, v.tolist()))
    )


def motion_records(run: Run, judgement: Judgement, estimate: Estimate | None) -> list[Any]:
    """Return what samples, counters and watchers say of a run; what a controller did is a record of its own.

    Errors of figures cover what the second run says of them.
    """
    motion, driver, recorder, failure = run.motion, run.driver, run.recorder, judgement.failure
    problem, observer = motion.problem, recorder.observer
    constrained = bool(problem.constraints.rows)
    errors = None if estimate is None else estimate.errors
    independent = constrained and motion.scene.simulate.stabilisation == "independent"
    summary = MotionSummary(
        termination=Termination("duration", driver.time) if failure is None else failure.termination,
        integrator=motion.choice.method,
        integrator_reason=motion.choice.reason,
        tolerances=tolerances(motion.options),
        samples=recorder.samples,
        error_estimate=errors,
        energy_drift=recorder.drift,
        energy_drift_relative=recorder.relative_drift,
        energy_balance="kinetic + potential - work" if motion.system.work_done_by else "kinetic + potential",
        constraint_residual=residual_of(recorder, judgement.redundant) if constrained else ABSENT,
        assembly=_assembly(motion) if constrained else ABSENT,
        repartitions=driver.repartitions if independent else ABSENT,
        multipliers=describe_dependence(motion, driver.repartitions) if constrained else ABSENT,
        # those of a run that came to its end are located between its steps (``with_figures``)
        reactions=observer.reactions.described(recorder.largest_loads(driver.instants))
        if observer.reactions and failure is not None
        else ABSENT,
        counters=driver.counters,
        warnings=[*judgement.warnings, *estimate_warnings(errors)] or ABSENT,
        baumgarte=motion.gains or ABSENT,
        switches=[MethodKeys(c.time, c.to, c.decay_time) for c in driver.changes] or ABSENT,
        final=final_state(run),
    )
    for watcher in driver.watchers:
        summary = dataclasses.replace(summary, **watcher.facts(driver.time))
    if estimate is not None and estimate.facts:
        from robodyn_cli.summaries.apart import with_others

        others = [dataclasses.replace(summary, **facts) for facts in estimate.facts]
        summary = with_others(summary, others, estimate.factor)
    if problem.control is None:
        return [summary]
    return [summary, _control_keys(run, problem.control, estimate)]


def _control_keys(run: Run, control: Control, estimate: Estimate | None) -> ControlKeys:
    """Return what a controller did, with errors by the second run where there is one."""
    from robodyn_cli.observe.controllers.summary import control_keys, with_design, with_doubts
    from robodyn_cli.summaries.apart import with_others

    ends, instants = (run.beginning.time, run.driver.time), run.driver.instants
    keys = control_keys(control, run.recorder, ends, instants)
    if estimate is not None and estimate.recorder is not None:
        second = control_keys(control, estimate.recorder, ends, instants)
        keys = with_others(keys, [second], estimate.factor)
        floor = rounding_of(estimate.errors)
        keys = with_doubts(keys, control, run.recorder, estimate.recorder, estimate.factor, floor)
    return with_design(keys, control)


def rounding_of(errors: MotionErrors) -> float:
    """Return what rounding is expected to leave of positions."""
    most, floor = errors.q_max, errors.rounding_floor
    return min(most, floor) if isinstance(most, float) and isinstance(floor, float) else 0.0


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


def describe_dependence(motion: Motion, repartitions: int) -> MultiplierChoice:
    """Return what the summary says about the multipliers: unique, or which and why."""
    problem, together = motion.problem, motion.sticking_together
    choice = f"not determined while {', '.join(together)} stick together" if together else ABSENT
    if not problem.dependent:
        return MultiplierChoice(not together, choice)
    groups = [
        DependentRows(sorted({closure_of(name) for name in g.rows}), list(g.rows), g.rank)
        for g in problem.dependent
    ]
    least = "least norm" if choice is ABSENT else f"least norm; {choice}"
    return MultiplierChoice(False, least, groups, repartitions)

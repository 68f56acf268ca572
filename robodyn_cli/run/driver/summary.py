"""The summary of a motion that was integrated: the keys that ``simulate`` and ``deploy`` share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.integrators.runtime.options import Counters, Options
from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent
from robodyn_cli.run.driver.driver import Driver
from robodyn_cli.run.driver.motion import Gains, Motion
from robodyn_cli.run.driver.second_run import ErrorEstimate
from robodyn_cli.run.observation.recorder import Recorder

if TYPE_CHECKING:
    from robodyn_cli.run.driver.redundancy import Redundant


@record
class Residual:
    """Largest residuals of the constraints [m, m/s]; ``redundant`` : of rows that were left out."""

    position: float
    velocity: float
    redundant: float | Absent = ABSENT


@record
class Assembly:
    """What closing the loops at t = 0 has left [m, m/s], and rows that say nothing new, or nothing."""

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
class MotionSummary:
    """Keys of the summary of every integrated motion, in their order.

    transitions : of contact states, how many of each kind. passed : times of poses [s]. switches : of the method.
    """

    status: str
    termination: dict[str, Any]
    integrator: str
    integrator_reason: str
    tolerances: dict[str, float]
    samples: int
    error_estimate: ErrorEstimate | None = None
    energy_drift: float = 0.0
    energy_drift_relative: float = 0.0
    energy_balance: str = ""
    constraint_residual: Residual | Absent = ABSENT
    assembly: Assembly | Absent = ABSENT
    repartitions: int | Absent = ABSENT
    multipliers: Multipliers | Absent = ABSENT
    reactions: dict[str, Any] | Absent = ABSENT
    counters: Counters | Absent = ABSENT
    warnings: list[str] | Absent = ABSENT
    baumgarte: Gains | Absent = ABSENT
    transitions: dict[str, int] | Absent = ABSENT
    passed: list[float] | Absent = ABSENT
    switches: list[MethodKeys] | Absent = ABSENT


def motion_facts(
    motion: Motion, driver: Driver, recorder: Recorder, redundant: Redundant | None
) -> dict[str, Any]:
    """Return the fields of ``MotionSummary`` that the samples and counters say, all but status and termination.

    redundant : what the rows that were left out say, where there are such.
    """
    problem = motion.problem
    facts: dict[str, Any] = {
        "integrator": motion.choice.method,
        "integrator_reason": motion.choice.reason,
        "tolerances": tolerances(motion.options),
        "samples": recorder.samples,
        "energy_drift": recorder.drift,
        "energy_drift_relative": recorder.drift / recorder.energy_scale if recorder.energy_scale else 0.0,
        "energy_balance": "kinetic + potential - work" if motion.system.further else "kinetic + potential",
        "counters": driver.counters,
    }
    if problem.constraints.rows:
        facts["constraint_residual"] = Residual(
            recorder.position_residual,
            recorder.velocity_residual,
            ABSENT if redundant is None else redundant.residual,
        )
        facts["assembly"] = Assembly(
            motion.assembled.position_residual,
            motion.assembled.velocity_residual,
            list(motion.assembled.redundant),
            list(problem.constraints.dropped),
        )
        if motion.scene.simulate.stabilisation == "independent":
            facts["repartitions"] = driver.repartitions
        facts["multipliers"] = describe_dependence(problem, driver.repartitions)
    if recorder.observer.reactions is not None:
        facts["reactions"] = {**recorder.observer.reactions.note(), "largest": recorder.loads}
    for watcher in driver.watchers:
        facts |= watcher.facts(driver.time)
    if driver.changes:
        facts["switches"] = [MethodKeys(c.time, c.to, c.decay_time) for c in driver.changes]
    if warnings := [text for watcher in motion.watchers for text in watcher.warnings]:
        facts["warnings"] = warnings
    if motion.gains is not None:
        facts["baumgarte"] = motion.gains
    return facts


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
        DependentRows(sorted({n.rsplit(".", 1)[0] for n in g.rows}), list(g.rows), g.rank)
        for g in problem.dependent
    ]
    return Multipliers(False, "least norm", groups, repartitions)


def redundant_rows(motion: Motion, recorder: Recorder) -> Redundant | None:
    """Return what the rows that were left out say along the samples, None where there are no such rows."""
    if not motion.assembled.redundant or not recorder.samples:
        return None
    from robodyn_cli.run.driver.redundancy import check_redundant

    return check_redundant(motion.problem, motion.assembled, recorder)

"""Error against run time: every method that can do a scene, over a range of tolerances."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Sequence

import numpy as np

from robodyn_cli.errors import CapabilityError, NumericalError, of_option, unknown_name
from robodyn_cli.integration_methods import EXTREMES
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.motion.baumgarte import GainStudy
from robodyn_cli.motion.build import build_motion, follow_changes, with_stabilisation
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.references import SAMPLES, TrialReference, agreed
from robodyn_cli.over.work_precision.entries import (
    fields_of,
    in_formulation,
    positions_and_rates,
    run_entry,
    supported,
    tight_runs,
    values_of,
)
from robodyn_cli.over.work_precision.error_growth import Sensitivity, motion_at, sensitivity
from robodyn_cli.over.work_precision.lock_precision import judge_lock, lock_reference, locks
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.record import record
from robodyn_cli.results.catalogue import TIMED
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Baumgarte, Ready, Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Absent, Termination
from robodyn_cli.summaries.motion import Gains
from robodyn_cli.summaries.stability import BestRun, GivenGains, TimedRun, WorkPrecisionSummary
from robodyn_cli.tools.progress import Progress, Stopwatch, counted, no_progress

TOLERANCES = tuple(10.0**-k for k in range(2, 14))
SHORT_OF = 0.9  # of the time of a lock: up to there a small change of the start is followed
LEVELS = tuple(10.0**-k for k in range(1, 14))  # of the error; none below what the references are apart
STEPS = 10  # step sizes tried for a method without step control, each half the one before
AGREED = 1e-9  # agreement of the references, relative to the range, up to which chaotic motions are compared
LEAST_AGREED = 1e-6  # the same for all others, whose errors do not run away


def two_references(motion: Motion, grid: Grid) -> list[tuple[str, Array]]:
    """Return the motions q, v (T, nq + nv) by the first two methods that get through at tight tolerance.

    Raises
    ------
    NumericalError : fewer than two do.
    """
    runs = tight_runs(motion, lambda method, options: motion_at(motion, method, motion.start, grid, options))
    pair = list(itertools.islice(runs, 2))
    if len(pair) < 2:
        raise NumericalError(
            "no two methods get through this scene at tight tolerance, so there is no reference"
        )
    return pair


def reference(motion: Motion, duration: float) -> tuple[TrialReference, Sensitivity]:
    """Return the reference solution over the part of the duration on which two methods agree, and how a small change of
    the start grows over that part.

    Where errors grow exponentially, nothing is compared once digits are lost; else fewer digits do for the rest.

    Raises
    ------
    NumericalError : fewer than two methods get through at tight tolerance, or they never agree.
    """
    grid = Grid.over(duration, SAMPLES)
    (first, x), (second, y) = two_references(motion, grid)
    count = min(len(x), len(y))
    x, y, times = x[:count], y[:count], grid.times(0, count)
    scale = np.maximum(np.ptp(x, axis=0), 1e-12)
    ref = agreed(times, x, y, scale, AGREED, (first, second))
    looser = agreed(times, x, y, scale, LEAST_AGREED, (first, second))
    if looser is None:
        apart = np.max(np.abs(x - y) / scale, axis=1)
        raise NumericalError(
            f"{first} and {second} at tight tolerance agree to no more than {apart[1:].min():.1e} of the motion's "
            "range, so there is no reference"
        )
    if ref is None or ref.until < looser.until:
        growth = sensitivity(motion, looser.until, first, SAMPLES)
        if ref is None or growth.kind == "polynomial":
            return looser, growth
    return ref, sensitivity(motion, ref.until, first, SAMPLES)


def formulations(
    motion: Motion, asked: str | Baumgarte
) -> tuple[dict[str, Motion], Gains | GivenGains | None]:
    """Return the formulations to compare: the tree itself, or the loops kept closed in different ways.

    ``motion`` is projected. Baumgarte's gains are those ``asked`` for, or those that ``stabilisation: baumgarte`` would
    choose; they come second, None where there are none.
    """
    problem = motion.problem
    if not problem.constraints.rows:
        return {"tree": motion}, None
    gains: Gains | GivenGains | None = None
    if isinstance(asked, Baumgarte):
        gains = GivenGains(asked.alpha, asked.beta)
    if gains is None and not problem.dependent and not problem.contact_joints:
        # a motion that the choice cannot follow (through a singular pose) is compared without that curve
        with contextlib.suppress(NumericalError):
            gains = GainStudy(motion).choose()
    motions = {"projection": motion}
    if not problem.dependent and not problem.contact_joints:
        motions["independent"] = in_formulation(motion, "independent")
    if gains is not None:
        motions["baumgarte"] = in_formulation(motion, Baumgarte(alpha=gains.alpha, beta=gains.beta))
    return {**motions, "none": in_formulation(motion, "none")}, gains


def judge_motion(driver: Driver, entry: TimedRun, motion: Motion, ref: TrialReference) -> None:
    """Run over the comparable time; fill in the largest error."""
    grid = Grid.over(ref.until, len(ref.times))
    states = driver.samples(ref.until, grid, watch=bool(motion.watchers))
    difference = np.abs(positions_and_rates(motion.system, states) - ref.states)
    entry.error = float(difference.max())
    if np.max(difference / ref.scale) > 0.1:
        entry.status = "inaccurate"


def best_at(entries: Sequence[TimedRun], levels: Sequence[float]) -> list[BestRun]:
    """Return, for each error level, the run that reaches it in the least time."""
    table = []
    for level in levels:
        able = [
            e
            for e in entries
            if e.status == "ok" and e.error is not None and e.error <= level and e.run_time_s
        ]
        if able:
            best = min(able, key=lambda e: e.run_time_s or np.inf)
            table.append(BestRun(**fields_of(best), level=level))
    return table


@np.errstate(all="ignore")  # errors that are not finite are verdicts
def work_precision(
    scene: Scene,
    methods: Sequence[str] | None = None,
    tolerances: Sequence[float] | None = None,
    repeats: int = 7,
    progress: Progress = no_progress,
) -> Result:
    """Run a scene with every method over a range of tolerances and measure error and time.

    Returns
    -------
    A Result whose summary holds ``reference_digits`` and ``runs``; run times are medians of ``repeats`` runs
    without output, in this process, compilation apart.

    Raises
    ------
    CapabilityError : an unknown method. NumericalError : no reference.
    """
    chosen = list(methods or EXTREMES)
    for name in chosen:
        if name not in registry:
            raise of_option("--methods", unknown_name("method", name, registry), CapabilityError)
    watch = Stopwatch()
    motion, measure = prepared(with_stabilisation(integrable(scene, watch), "projection"), watch)
    with watch.stage("gains"):
        motions, gains = formulations(motion, scene.simulate.stabilisation)
    runs = [run for name, one in motions.items() for run in planned(name, one, chosen, tolerances, measure)]
    with watch.stage("runs"):
        entries = run_all(runs, measure, repeats, progress)
    summary = WorkPrecisionSummary(
        termination=Termination("all runs made", measure.until),
        reference_digits=round(measure.digits, 2),
        reference_methods=list(measure.methods),
        compared_until=measure.until,
        compared_whole_duration=measure.whole,
        perturbation_growth=measure.growth.growth,
        perturbation_grows=measure.growth.kind,
        e_folding_time=measure.growth.e_folding or ABSENT,
        repeats=repeats,
        runs=entries,
        best=best_at(entries, [level for level in LEVELS if level >= measure.apart]),
        baumgarte=ABSENT if gains is None else gains,
        lock_time=measure.lock_time,
        error_norm=measure.norm,
    )
    result = Result.of("work-precision", scene)
    result.summarise(summary, seconds=watch.report())
    add_runs(result, entries, measure)
    return result


# -- what is compared ---------------------------------------------------------------------------------------
@record
class Measure:
    """What is compared, the motion or the time of a lock, against what.

    judge : makes a run and fills in its error. until : time of what is compared [s]; whole : whether all of it could
    be. end : of the runs [s]. digits, apart, methods : of the reference. growth : of a small change of the start.
    """

    judge: Callable[[Driver, TimedRun, Motion], None]
    norm: str
    until: float
    whole: bool
    end: float
    digits: float
    apart: float
    methods: tuple[str, str]
    growth: Sensitivity
    lock_time: float | Absent = ABSENT


def prepared(scene: Ready, watch: Stopwatch) -> tuple[Motion, Measure]:
    """Build the motion and find the reference: for a scene of ``deploy`` the time of its lock, else the motion.

    Raises
    ------
    NumericalError : no reference.
    """
    if locks(scene):
        from robodyn_cli.works.deploy.scan import follow_deployment

        motion = build_motion(scene, watch, follow_deployment, work=False)
        with watch.stage("reference"):
            measure = lock_measure(motion)
        if measure is not None:
            return motion, measure
    motion = build_motion(scene, watch, follow_changes, work=False)
    with watch.stage("reference"):
        return motion, motion_measure(motion)


def lock_measure(motion: Motion) -> Measure | None:
    """Return how the times of a lock are compared; None where the mechanism does not lock."""
    ref = lock_reference(motion)
    if ref is None:
        return None
    return Measure(
        lambda driver, entry, own: judge_lock(driver, entry, own, ref),
        "absolute error of the time of the lock [s]",
        ref.time,
        True,
        motion.scene.simulate.duration,
        ref.digits,
        ref.apart,
        ref.methods,
        sensitivity(motion, SHORT_OF * ref.time, ref.methods[0], SAMPLES),
        ref.time,
    )


def motion_measure(motion: Motion) -> Measure:
    """Return how motions are compared."""
    duration = motion.scene.simulate.duration
    ref, growth = reference(motion, duration)
    return Measure(
        lambda driver, entry, own: judge_motion(driver, entry, own, ref),
        f"largest absolute error of any q or qd at {SAMPLES} instants",
        ref.until,
        ref.until >= duration * (1 - 1e-12),
        ref.until,
        ref.digits,
        ref.apart,
        ref.methods,
        growth,
    )


# -- the runs and the report --------------------------------------------------------------------------------
def planned(
    formulation: str,
    motion: Motion,
    methods: Sequence[str],
    tolerances: Sequence[float] | None,
    measure: Measure,
) -> list[tuple[Motion, TimedRun]]:
    """Return the runs of one formulation: each method over the tolerances, or over steps, each half the one before."""
    runs = []
    for method in methods:
        if not supported(method, motion.system):
            runs.append(TimedRun(method, formulation, None, None, status="unsupported"))
        elif registry[method].adaptive:
            runs += [TimedRun(method, formulation, tolerance, None) for tolerance in tolerances or TOLERANCES]
        else:
            runs += [TimedRun(method, formulation, None, measure.until / 100.0 / 2**k) for k in range(STEPS)]
    return [(motion, entry) for entry in runs]


def run_all(
    runs: Sequence[tuple[Motion, TimedRun]], measure: Measure, repeats: int, progress: Progress
) -> list[TimedRun]:
    """Make the runs; a method that cannot do a formulation is told once."""
    entries: list[TimedRun] = []
    unable: set[tuple[str, str]] = set()
    for motion, entry in counted(runs, progress, "runs"):
        pair = (entry.formulation, entry.method)
        if pair in unable:
            continue
        if entry.status != "unsupported":
            run_entry(motion, entry, measure.judge, measure.end, repeats)
        if entry.status == "unsupported":
            unable.add(pair)
            entry.tolerance = entry.step = None
        entries.append(entry)
    return entries


def add_runs(result: Result, entries: Sequence[TimedRun], measure: Measure) -> None:
    """Store the figures of the runs."""
    names = ["tolerance", "step", "error", "run_time_s", "compile_time_s", "evaluations", "steps"]
    lock = measure.lock_time is not ABSENT
    names += ["lock_time"] if lock else []
    table = np.array([values_of(entry, names) for entry in entries])
    result.add(
        "work_precision/runs", table.reshape(len(entries), len(names)), names=tuple(names),
        column_units=tuple("s" if lock and name == "error" else TIMED[name] for name in names),
    )  # fmt: skip

"""Error against run time: every method that can do a scene, over a range of tolerances."""

from __future__ import annotations

import contextlib
import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import CapabilityError, NumericalError
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.integrators.runtime.grid import Grid
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.kernels.report import REPORT
from robodyn_cli.record import mutable_record, record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import ABSENT, Absent, as_keys
from robodyn_cli.run.driver.baumgarte import GainStudy
from robodyn_cli.run.driver.build import build_motion, follow_nothing, with_stabilisation
from robodyn_cli.run.driver.driver import Driver
from robodyn_cli.run.driver.method import LARGEST
from robodyn_cli.run.driver.motion import Gains, Motion
from robodyn_cli.run.numerics.trial import SAMPLES, Reference, agreed
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Baumgarte, Scene

Array = NDArray[Any]
# one of each kind; the others by name
DEFAULT_METHODS = (
    "gauss", "dop853", "dopri5", "rk4", "radau13", "radau", "rodas5p", "rosenbrock23", "bdf", "gauss6",
    "implicit_midpoint", "symplectic8", "generalized_alpha",
)  # fmt: skip
TOLERANCES = tuple(10.0**-k for k in range(2, 14))
STEPS = 10  # step sizes tried for a method without step control, each half the one before
LONGEST = 400_000  # steps after which a run counts as too slow
SECONDS = 20.0  # as the last resort, the time after which it does; three times that for a reference
REFERENCES = (("gauss", 3e-14), ("dop853", 3e-14), ("rodas5p", 1e-12), ("radau13", 1e-13), ("radau", 1e-11))
AGREED = (
    1e-9  # relative agreement that the references must keep; beyond the time they lose it nothing is compared
)


@mutable_record
class Entry:
    """One run of one method: what it was asked, what it reached, what it cost."""

    method: str
    formulation: str
    tolerance: float | None
    step: float | None
    error: float | None = None
    run_time_s: float | None = None
    compile_time_s: float = 0.0
    evaluations: int = 0
    steps: int = 0
    status: str = "ok"


def _solve(system: System, method: str, start: Array, grid: Grid, options: Options) -> Array:
    """Return the states (T, nx) on a grid."""
    driver = Driver(system, method, options)
    driver.tick = deadline(3.0 * SECONDS)
    driver.start(0.0, start)
    return driver.samples(grid.start + (grid.count - 1) * grid.step, grid, watch=False)


def deadline(seconds: float) -> Callable[[float], None]:
    """Return a callback that ends an integration when its time is up."""
    end = time.perf_counter() + seconds

    def tick(t: float) -> None:
        if time.perf_counter() > end:
            raise NumericalError(f"not done after {seconds:g} s, stopped at t = {t:.6g} s", status="too_slow")

    return tick


def _motion(system: System, states: Array) -> Array:
    """Return q and v (..., nq + nv) of states (..., nx)."""
    q, v, _ = system.split(states)
    return np.concatenate([q, v], axis=-1)


def reference(system: System, start: Array, duration: float) -> Reference:
    """Return the reference solution over the part of the duration on which two methods agree.

    Raises
    ------
    NumericalError : fewer than two methods get through at tight tolerance, or they never agree.
    """
    grid = Grid.over(duration, SAMPLES)
    found: list[tuple[str, Array]] = []
    for method, tolerance in REFERENCES:
        if not supported(method, system):
            continue
        options = Options(tolerance, tolerance, max_steps=5 * LONGEST)
        try:
            states = _solve(system, method, start, grid, options)
        except NumericalError:
            continue
        found.append((method, _motion(system, states)))
        if len(found) == 2:
            break
    if len(found) < 2:
        raise NumericalError(
            "no two methods get through this scene at tight tolerance, so there is no reference"
        )
    (first, x), (second, y) = found
    scale = np.maximum(np.ptp(x, axis=0), 1e-12)
    ref = agreed(grid.times(0, SAMPLES), x, y, scale, AGREED, (first, second))
    if ref is None:
        apart = np.max(np.abs(x - y) / scale, axis=1)
        raise NumericalError(
            f"{first} and {second} at tight tolerance agree to no more than {apart[1:].min():.1e} of the motion's "
            "range, so there is no reference"
        )
    return ref


def perturbation_growth(system: System, start: Array, until: float, method: str) -> float:
    """Return by how much a small change of the start has grown at ``until``."""
    grid = Grid.over(until, 2)
    places = list(system.q_places)
    change = 1e-7 * (1.0 + np.abs(start[places]))
    moved = start.copy()
    moved[places] += change
    tolerance = max(dict(REFERENCES)[method], 1e-13)
    options = Options(tolerance, tolerance, max_steps=5 * LONGEST)
    try:
        a = _solve(system, method, start, grid, options)
        b = _solve(system, method, moved, grid, options)
    except NumericalError:
        return float("nan")
    return float(np.abs(_motion(system, a[-1]) - _motion(system, b[-1])).max() / change.max())


def formulations(
    motion: Motion, asked: str | Baumgarte
) -> tuple[dict[str, System], Gains | Baumgarte | None]:
    """Return the formulations to compare: the tree itself, or the loops kept closed in different ways.

    ``motion`` is projected. Baumgarte's gains are those ``asked`` for, or those that ``stabilisation: baumgarte`` would
    choose; they come second, None where there are none.
    """
    problem = motion.problem
    if not problem.constraints.rows:
        return {"tree": motion.system}, None
    gains: Gains | Baumgarte | None = asked if isinstance(asked, Baumgarte) else None
    if gains is None and not problem.dependent:
        # a motion that the choice cannot follow (through a singular pose) is compared without that curve
        with contextlib.suppress(NumericalError):
            gains = GainStudy(motion).choose()
    found = {"projection": motion.system}
    if not problem.dependent and not problem.contact_joints:
        found["independent"] = build_system(problem, "independent", work=False)
    if gains is not None:
        fed_back = Baumgarte(alpha=gains.alpha, beta=gains.beta)
        found["baumgarte"] = build_system(problem, fed_back, work=False)
    return {**found, "none": build_system(problem, "none", work=False)}, gains


def run_entry(system: System, entry: Entry, start: Array, ref: Reference, repeats: int) -> Entry:
    """Fill in an entry: error over the comparable time, median run time without output, counters."""
    tolerance = entry.tolerance or 1e-10
    options = Options(tolerance, tolerance, entry.step, max_steps=LONGEST)
    compiling = REPORT.seconds
    grid = Grid.over(ref.until, len(ref.times))
    try:
        driver = Driver(system, entry.method, options)
        entry.compile_time_s = REPORT.seconds - compiling
        driver.tick = deadline(SECONDS)
        driver.start(0.0, start)
        began = time.perf_counter()
        states = driver.samples(ref.until, grid, watch=False)
        took = time.perf_counter() - began
        entry.steps = driver.counters.steps
        difference = np.abs(_motion(system, states) - ref.states)
        entry.error = float(difference.max())
        if np.max(difference / ref.scale) > 0.1:
            entry.status = "inaccurate"
        entry.run_time_s = statistics.median(
            _time_without_output(driver, start, ref.until) for _ in range(repeats if took < 1.0 else 1)
        )
        # without output there are fewer evaluations: those belong to the time
        entry.evaluations = driver.counters.evaluations
    except CapabilityError:
        entry.status = "unsupported"
    except NumericalError as error:
        slow = error.details.get("status") in ("max_steps", "too_slow")
        entry.status = "too_slow" if slow else "diverged"
    return entry


def _time_without_output(driver: Driver, start: Array, end: float) -> float:
    """Return how long a run without samples takes [s]."""
    driver.start(0.0, start)
    began = time.perf_counter()
    driver.advance(end)
    return time.perf_counter() - began


def supported(method: str, system: System) -> bool:
    """Tell whether a method can do a system."""
    if registry[method].needs_jacobian and system.nv > LARGEST:
        return False
    return not registry[method].obstacle(system)


def best_at(entries: Sequence[Entry], levels: Sequence[float]) -> list[Best]:
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
            table.append(Best(level, **dataclasses.asdict(best)))
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
    chosen = list(methods or DEFAULT_METHODS)
    for name in chosen:
        if name not in registry:
            raise CapabilityError(f"unknown method {name!r}; allowed: {', '.join(registry)}")
    watch = Stopwatch()
    motion = build_motion(with_stabilisation(scene, "projection"), watch, follow_nothing, work=False)
    with watch.stage("gains"):
        systems, gains = formulations(motion, scene.simulate.stabilisation)
    with watch.stage("reference"):
        ref = reference(motion.system, motion.start, scene.simulate.duration)
        growth = perturbation_growth(motion.system, motion.start, ref.until, ref.methods[0])
    runs = [run for name, system in systems.items() for run in planned(name, system, chosen, tolerances, ref)]
    with watch.stage("runs"):
        entries = run_all(runs, motion.start, ref, repeats, progress)
    summary = WorkPrecisionSummary(
        termination={"reason": "all runs made", "time": ref.until},
        reference_digits=round(ref.digits, 2),
        reference_methods=list(ref.methods),
        compared_until=ref.until,
        compared_whole_duration=ref.until >= scene.simulate.duration * (1 - 1e-12),
        perturbation_growth=growth,
        repeats=repeats,
        runs=entries,
        best=best_at(entries, [10.0**-k for k in range(1, 14)]),
        baumgarte=ABSENT if gains is None else gains,
        wall_time_s=watch.report(),
    )
    result = Result("work-precision", scene.title or "work-precision", "ok", scene.text)
    result.summary = as_keys(summary)
    add_runs(result, entries)
    return result


@record
class Best:
    """The run that reaches a level of error in the least time; see ``Entry``."""

    level: float
    method: str
    formulation: str
    tolerance: float | None
    step: float | None
    error: float | None
    run_time_s: float | None
    compile_time_s: float
    evaluations: int
    steps: int
    status: str


@record
class WorkPrecisionSummary:
    """Keys of the summary of ``work-precision``."""

    termination: dict[str, Any]
    reference_digits: float
    reference_methods: list[str]
    compared_until: float
    compared_whole_duration: bool
    perturbation_growth: float
    repeats: int
    runs: list[Entry]
    best: list[Best]
    baumgarte: Gains | Baumgarte | Absent
    wall_time_s: dict[str, float]
    status: str = "ok"
    error_norm: str = f"largest absolute error of any q or qd at {SAMPLES} instants"


def planned(
    formulation: str,
    system: System,
    methods: Sequence[str],
    tolerances: Sequence[float] | None,
    ref: Reference,
) -> list[tuple[System, Entry]]:
    """Return the runs of one formulation: each method over the tolerances, or over steps, each half the one before."""
    runs = []
    for method in methods:
        if not supported(method, system):
            runs.append(Entry(method, formulation, None, None, status="unsupported"))
        elif registry[method].adaptive:
            runs += [Entry(method, formulation, tolerance, None) for tolerance in tolerances or TOLERANCES]
        else:
            runs += [Entry(method, formulation, None, ref.until / 100.0 / 2**k) for k in range(STEPS)]
    return [(system, entry) for entry in runs]


def run_all(
    runs: Sequence[tuple[System, Entry]], start: Array, ref: Reference, repeats: int, progress: Progress
) -> list[Entry]:
    """Make the runs; a method that cannot do a formulation is told once."""
    entries: list[Entry] = []
    unable: set[tuple[str, str]] = set()
    for k, (system, entry) in enumerate(runs):
        progress(k + 1, len(runs))
        pair = (entry.formulation, entry.method)
        if pair in unable:
            continue
        if entry.status != "unsupported":
            run_entry(system, entry, start, ref, repeats)
        if entry.status == "unsupported":
            unable.add(pair)
            entry.tolerance = entry.step = None
        entries.append(entry)
    return entries


def add_runs(result: Result, entries: Sequence[Entry]) -> None:
    """Store the figures of the runs."""
    names = ["tolerance", "step", "error", "run_time_s", "compile_time_s", "evaluations", "steps"]
    table = np.array(
        [[np.nan if getattr(e, n) is None else float(getattr(e, n)) for n in names] for e in entries]
    )
    result.add(
        "work_precision/runs", table.reshape(len(entries), len(names)), units="1, s, rad or m, s, s, 1, 1",
        long_name="runs in the order of summary.runs", dims=("run", "quantity"), names=tuple(names),
    )  # fmt: skip

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
from robodyn_cli.formulations.index1 import index1
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.integrators.runtime.integrator import Grid, Integrator, Options
from robodyn_cli.kernels.report import REPORT
from robodyn_cli.record import mutable_record
from robodyn_cli.results.result import Result
from robodyn_cli.run.driver.gains import study
from robodyn_cli.run.driver.method import LARGEST
from robodyn_cli.run.driver.prepare import Setup, prepare
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
VOUCHED = (
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

    def as_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


def _solve(
    system: System, method: str, start: Array, grid: Grid, options: Options
) -> tuple[Array, Integrator]:
    integrator = Integrator(system, method)
    integrator.tick = deadline(3.0 * SECONDS)
    integrator.reset(0.0, start, options)
    rows: list[Array] = []
    integrator.run(grid.start + (grid.count - 1) * grid.step, grid, lambda t, x: rows.append(x), watch=False)
    return np.concatenate(rows), integrator


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
    """Return the reference solution over the part of the duration for which it can vouch.

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
            states, _ = _solve(system, method, start, grid, options)
        except NumericalError:
            continue
        found.append((method, _motion(system, states)))
        if len(found) == 2:
            break
    if len(found) < 2:
        raise NumericalError(
            "no two methods get through this scene at tight tolerance, so nothing can vouch for a reference"
        )
    (first, x), (second, y) = found
    scale = np.maximum(np.ptp(x, axis=0), 1e-12)
    ref = agreed(grid.times(0, SAMPLES), x, y, scale, VOUCHED, (first, second))
    if ref is None:
        apart = np.max(np.abs(x - y) / scale, axis=1)
        raise NumericalError(
            f"{first} and {second} at tight tolerance agree to no more than {apart[1:].min():.1e} of the motion's "
            "range, so nothing can vouch for a reference"
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
        a, _ = _solve(system, method, start, grid, options)
        b, _ = _solve(system, method, moved, grid, options)
    except NumericalError:
        return float("nan")
    return float(np.abs(_motion(system, a[-1]) - _motion(system, b[-1])).max() / change.max())


def formulations(scene: Scene, setup: Setup) -> tuple[dict[str, System], dict[str, Any] | None]:
    """Return the formulations to compare: the tree itself, or the loops kept closed in different ways.

    Baumgarte's gains are the scene's, or those that ``stabilisation: baumgarte`` would choose; they come second,
    None where there are none.
    """
    problem = setup.problem
    if not problem.constraints.rows:
        return {"tree": index1(problem, work=False)}, None
    asked = scene.simulate.stabilisation
    gains: dict[str, Any] | None = None
    if isinstance(asked, Baumgarte):
        gains = dataclasses.asdict(asked)
    elif not problem.dependent:
        # a motion that the choice cannot follow (through a singular pose) is compared without that curve
        with contextlib.suppress(NumericalError):
            gains = study(scene, setup).choose().as_dict()
            asked = Baumgarte(alpha=gains["alpha"], beta=gains["beta"])
    separable = not problem.dependent and not problem.gates
    return {
        "projection": index1(problem, "projection", work=False),
        **({"independent": index1(problem, "independent", work=False)} if separable else {}),
        **({"baumgarte": index1(problem, asked, work=False)} if gains is not None else {}),
        "none": index1(problem, "none", work=False),
    }, gains


def run_entry(system: System, entry: Entry, start: Array, ref: Reference, repeats: int) -> Entry:
    """Fill in an entry: error over the comparable time, median run time without output, counters."""
    tolerance = entry.tolerance or 1e-10
    options = Options(tolerance, tolerance, entry.step, max_steps=LONGEST)
    compiling = REPORT.seconds
    grid = Grid.over(ref.until, len(ref.times))
    try:
        integrator = Integrator(system, entry.method)
        entry.compile_time_s = REPORT.seconds - compiling
        integrator.tick = deadline(SECONDS)
        rows: list[Array] = []
        integrator.reset(0.0, start, options)
        began = time.perf_counter()
        integrator.run(ref.until, grid, lambda t, x: rows.append(x), watch=system.chart is not None)
        took = time.perf_counter() - began
        entry.steps, entry.evaluations = integrator.counters.steps, integrator.counters.evaluations
        difference = np.abs(_motion(system, np.concatenate(rows)) - ref.states)
        entry.error = float(difference.max())
        if np.max(difference / ref.scale) > 0.1:
            entry.status = "inaccurate"
        times = []
        for _ in range(repeats if took < 1.0 else 1):
            integrator.reset(0.0, start, options)
            began = time.perf_counter()
            integrator.advance(ref.until)
            times.append(time.perf_counter() - began)
        entry.run_time_s = statistics.median(times)
        # without output there are fewer evaluations: those belong to the time
        entry.evaluations = integrator.counters.evaluations
    except CapabilityError:
        entry.status = "unsupported"
    except NumericalError as error:
        slow = error.details.get("status") in ("max_steps", "too_slow")
        entry.status = "too_slow" if slow else "diverged"
    return entry


def supported(method: str, system: System) -> bool:
    """Tell whether a method can do a system."""
    if registry[method].needs_jacobian and system.nv > LARGEST:
        return False
    return not registry[method].obstacle(system)


def best_at(entries: Sequence[Entry], levels: Sequence[float]) -> list[dict[str, Any]]:
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
            table.append({"level": level, **best.as_dict()})
    return table


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
    setup = prepare(scene, watch)
    duration = scene.simulate.duration
    with watch.stage("gains"):
        systems, gains = formulations(scene, setup)
    main = next(iter(systems.values()))
    start = main.join(setup.assembled.q, setup.assembled.v)
    with watch.stage("reference"):
        ref = reference(main, start, duration)
        growth = perturbation_growth(main, start, ref.until, ref.methods[0])
    entries: list[Entry] = []
    plan: list[tuple[System, Entry]] = []
    for formulation, system in systems.items():
        for method in chosen:
            if not supported(method, system):
                plan.append((system, Entry(method, formulation, None, None, status="unsupported")))
            elif registry[method].adaptive:
                for tolerance in tolerances or TOLERANCES:
                    plan.append((system, Entry(method, formulation, tolerance, None)))
            else:
                for k in range(STEPS):
                    plan.append((system, Entry(method, formulation, None, ref.until / 100.0 / 2**k)))
    with watch.stage("runs"):
        unable: set[tuple[str, str]] = set()
        for k, (system, entry) in enumerate(plan):
            progress(k + 1, len(plan))
            pair = (entry.formulation, entry.method)
            if pair in unable:
                continue
            if entry.status != "unsupported":
                run_entry(system, entry, start, ref, repeats)
            if entry.status == "unsupported":
                # once is enough
                unable.add(pair)
                entry.tolerance = entry.step = None
            entries.append(entry)
    result = _result(scene, ref, growth, entries, watch, repeats)
    if gains is not None:
        result.summary["baumgarte"] = gains
    return result


def _result(
    scene: Scene, ref: Reference, growth: float, entries: list[Entry], watch: Stopwatch, repeats: int
) -> Result:
    result = Result("work-precision", scene.title or "work-precision", "ok", scene.text)
    levels = [10.0**-k for k in range(1, 14)]
    whole = ref.until >= scene.simulate.duration * (1 - 1e-12)
    result.summary = {
        "status": "ok",
        "termination": {"reason": "all runs made", "time": ref.until},
        "reference_digits": round(ref.digits, 2),
        "reference_methods": list(ref.methods),
        "compared_until": ref.until,
        "compared_whole_duration": whole,
        "perturbation_growth": growth,
        "error_norm": "largest absolute error of any q or qd at 257 instants",
        "repeats": repeats,
        "runs": [e.as_dict() for e in entries],
        "best": best_at(entries, levels),
        "wall_time_s": watch.report(),
    }
    names = ["tolerance", "step", "error", "run_time_s", "compile_time_s", "evaluations", "steps"]
    table = np.array(
        [[np.nan if getattr(e, n) is None else float(getattr(e, n)) for n in names] for e in entries]
    )
    result.add(
        "work_precision/runs", table.reshape(len(entries), len(names)), units="1, s, rad or m, s, s, 1, 1",
        long_name="runs in the order of summary.runs", dims=("run", "quantity"), names=tuple(names),
    )  # fmt: skip
    return result

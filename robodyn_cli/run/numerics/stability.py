"""Numerical stability of a scene: its spectrum, what limits the step, what every method makes of it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import RobodynError
from robodyn_cli.formulations.build import build_system
from robodyn_cli.integrators.methods.stability_region import limits
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import as_keys
from robodyn_cli.run.driver.baumgarte import GainStudy
from robodyn_cli.run.driver.build import projected_motion
from robodyn_cli.run.driver.prepare import Setup, prepare
from robodyn_cli.run.numerics.energy_growth import PERIODS, Growth, Period, growths, period
from robodyn_cli.run.numerics.spectrum import Spectrum, spectrum
from robodyn_cli.run.numerics.trial import FAMILIES, Budget, Reference, Trial, attempts, reference
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene

Array = NDArray[Any]
INSTANTS = 65  # at which eigenvalues are taken
FEW_INSTANTS = 3  # in long chains
STIFF = (
    1e4  # decays of the fastest mode within the run from which on implicit methods make the better reference
)
FIXED = "rk4"  # the textbook's setting for Baumgarte's gains: a fixed step


@record
class Effort:
    """How much a report may take: budgets of one run, and the size of the plane of gains."""

    trial: Budget
    reference: Budget
    long: Budget
    gains: int
    gain_seconds: float


FULL = Effort(Budget(2_000_000, 20.0), Budget(4_000_000, 40.0), Budget(5_000_000, 15.0), 17, 20.0)
QUICK = Effort(Budget(200_000, 1.5), Budget(500_000, 3.0), Budget(500_000, 1.5), 7, 2.0)


def stability(
    scene: Scene, progress: Progress = no_progress, watch: Stopwatch | None = None, quick: bool = False
) -> Result:
    """Report on the numerical stability of a scene.

    Parameters
    ----------
    quick : whether to take smaller budgets and one method of each family.

    Returns
    -------
    A Result whose summary holds ``spectrum``, ``step_limits``, ``methods``, ``energy_growth`` and, with loops,
    ``baumgarte``.

    Raises
    ------
    RobodynError : the scene cannot be started (as ``simulate`` would say); what methods do later is the report.
    """
    effort = QUICK if quick else FULL
    watch = watch or Stopwatch()
    setup = prepare(scene, watch)
    stages = 4
    with watch.stage("reference"):
        first = at_start(setup)
        stiff = first is not None and first.fastest_decay * scene.simulate.duration > STIFF
        ref = reference(scene, effort.reference, stiff)
        progress(1, stages)
    with watch.stage("spectrum"):
        found = along(setup, ref) or first
    with watch.stage("methods"):
        chosen = None if not quick else ["auto", *(name for name in registry if name in FAMILIES)]
        trials = attempts(scene, ref, effort.trial, chosen)
        progress(2, stages)
    with watch.stage("energy"):
        long = period(ref, found, scene.simulate.duration)
        own = {*FAMILIES, scene.simulate.integrator, *(t.chosen for t in trials if t.method == "auto")}
        usable = [
            t.method for t in trials if t.status in ("stable", "inaccurate") and t.method in own - {"auto"}
        ]
        energies = growths(scene, usable, PERIODS * long.seconds, effort.long)
        progress(3, stages)
    result = Result("stability", scene.title or "stability", "ok", scene.text)
    result.summary = {
        "status": "ok",
        "termination": {"reason": "report made", "time": ref.until if ref else 0.0},
        "reference": describe_reference(ref),
        "spectrum": describe_spectrum(found),
        "step_limits": step_limits(found),
        "methods": [t.as_dict() for t in trials],
        "energy_growth": {
            "period": dataclasses.asdict(long),
            "periods": PERIODS,
            "methods": [g.as_dict() for g in energies],
        },
    }
    if setup.problem.constraints.rows and scene.loops and not setup.problem.dependent:
        with watch.stage("baumgarte"):
            result.summary["baumgarte"] = gains(result, scene, effort)
    progress(stages, stages)
    add_spectrum(result, found)
    add_trials(result, trials)
    add_energy(result, energies, long)
    result.summary["wall_time_s"] = watch.report()
    return result


def at_start(setup: Setup) -> Spectrum | None:
    """Return the spectrum at the start."""
    return eigenvalues(setup, np.zeros(1), setup.assembled.q[None, :], setup.assembled.v[None, :])


def eigenvalues(setup: Setup, times: Array, q: Array, v: Array) -> Spectrum | None:
    """Return the spectrum at states q (T, nq), v (T, nv), None where the equations cannot be linearised."""
    problem: Problem = setup.problem
    system = build_system(problem, "none", work=False)
    states = np.stack([system.join(*x) for x in zip(q, v)])
    try:
        found = spectrum(problem, system, times, states, problem.scene.simulate.duration)
    except (RobodynError, np.linalg.LinAlgError):
        return None
    return found if len(found.times) else None


def along(setup: Setup, ref: Reference | None) -> Spectrum | None:
    """Return the spectrum along the reference solution."""
    if ref is None:
        return None
    count = INSTANTS if setup.problem.model.nv <= 30 else FEW_INSTANTS
    places = np.unique(np.linspace(0, len(ref.times) - 1, count).round().astype(int))
    q, v = np.split(ref.states[places], [setup.problem.model.nq], axis=1)
    return eigenvalues(setup, ref.times[places], q, v)


def describe_reference(ref: Reference | None) -> dict[str, Any] | None:
    if ref is None:
        return None
    return {
        "methods": list(ref.methods),
        "digits": round(ref.digits, 2),
        "until": ref.until,
        "ends_early": ref.ends_early,
    }


def describe_spectrum(found: Spectrum | None) -> dict[str, Any] | None:
    """Return what the summary says about the spectrum."""
    if found is None:
        return None
    return {
        "stiffness_ratio": found.stiffness_ratio,
        "fastest_decay": found.fastest_decay,
        "fastest_oscillation": found.fastest_oscillation,
        "fastest_growth": found.fastest_growth,
        "slowest_rate": found.slowest,
        "instants": len(found.times),
        "complete": found.complete,
    }


def step_limits(found: Spectrum | None) -> list[dict[str, Any]]:
    """Return, for each method whose step stability limits, the extents of its region and its largest step [s]."""
    table = []
    for limit in limits():
        steps = [limit.largest_step(row) for row in found.eigenvalues] if found is not None else []
        finite = [h for h in steps if np.isfinite(h)]
        table.append(
            {
                "method": limit.method,
                "kind": limit.kind,
                "real_axis": limit.real,
                "imaginary_axis": limit.imaginary,
                "largest_step": min(finite, default=None),
            }
        )
    return table


def add_spectrum(result: Result, found: Spectrum | None) -> None:
    """Store eigenvalues, stiffness ratios and step limits along the run."""
    if found is None:
        return
    result.add(
        "stability/time", found.times, units="s", long_name="instants of the spectrum", dims=("instant",)
    )
    for name, part in (("real", found.eigenvalues.real), ("imaginary", found.eigenvalues.imag)):
        result.add(
            f"stability/eigenvalues_{name}",
            part,
            units="1/s",
            dims=("instant", "eigenvalue"),
            long_name=f"{name} parts of the eigenvalues of the linearised equations of motion",
        )
    result.add(
        "stability/stiffness_ratio",
        found.ratios(),
        units="1",
        dims=("instant",),
        long_name="fastest decay over the slowest rate of the run",
    )
    table = limits()
    steps = np.array([[limit.largest_step(row) for limit in table] for row in found.eigenvalues])
    result.add(
        "stability/step_limit",
        steps.reshape(len(found.times), len(table)),
        units="s",
        long_name="largest stable step",
        dims=("instant", "method"),
        names=tuple(limit.method for limit in table),
    )


def add_trials(result: Result, trials: list[Trial]) -> None:
    """Store the figures of the table of methods; their words are in the summary."""
    names = ("error", "relative", "estimate", "steps", "evaluations", "seconds", "until")
    rows = [[np.nan if getattr(t, n) is None else float(getattr(t, n)) for n in names] for t in trials]
    result.add(
        "stability/methods",
        np.array(rows).reshape(len(trials), len(names)),
        units="rad or m, 1, 1, s",
        long_name="what each method did, in the order of summary.methods",
        dims=("trial", "quantity"),
        names=names,
    )


def add_energy(result: Result, energies: list[Growth], long: Period) -> None:
    """Store the error of the energy balance over many periods."""
    for g in energies:
        if not len(g.times):
            continue
        dims = (f"{g.method}_sample",)
        result.add(
            f"energy_growth/{g.method}/periods",
            g.times / long.seconds,
            units="1",
            long_name="time in periods",
            dims=dims,
        )
        result.add(
            f"energy_growth/{g.method}/error",
            g.error,
            units="1",
            dims=dims,
            long_name="error of the energy balance over the energy exchanged",
        )


def gains(result: Result, scene: Scene, effort: Effort) -> dict[str, Any]:
    """Run over the plane of Baumgarte's gains, for the method of the scene and for fixed steps; store both."""
    report: dict[str, Any] = {}
    fixed = dataclasses.replace(
        scene.simulate, integrator=FIXED, step=scene.simulate.step or 1e-3 * scene.simulate.duration
    )
    factors = np.logspace(-3, 1, effort.gains)
    asked = scene.simulate.integrator
    runs = {"own": scene, "fixed": dataclasses.replace(scene, simulate=fixed)}
    for name, one in runs.items():
        if name == "fixed" and asked in registry and not registry[asked].adaptive:
            continue
        try:
            found = GainStudy(projected_motion(one))
            chosen = found.choose()
            drift, error, steps, done = found.plane(factors, effort.gain_seconds)
        except RobodynError as failure:
            report[name] = {"method": one.simulate.integrator, "message": failure.message}
            continue
        report[name] = {
            "method": found.method,
            "chosen": as_keys(chosen),
            "reference_step": found.step,
            "over": found.over,
            "runs": done,
        }
        dims = ("alpha", "beta")
        for path, data, units, meaning in (
            ("drift", drift, "rad or m", "largest distance of the positions from the constraints"),
            ("error", error, "rad or m", "largest error of any q"),
            ("steps", steps, "1", "steps taken"),
        ):
            result.add(f"baumgarte/{name}/{path}", data, units=units, long_name=meaning, dims=dims)
        result.add(
            f"baumgarte/{name}/gain",
            factors / found.step,
            units="1/s",
            long_name="values of alpha and of beta",
            dims=("alpha",),
        )
    return report

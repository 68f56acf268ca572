"""Numerical stability of a scene: its spectrum, stability limits of the step, errors of every method."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import RobodynError, unknown_data
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.integration_methods import FIXED_STEP, REPRESENTATIVES
from robodyn_cli.integrators.methods.stability_region import limits
from robodyn_cli.model.model import unknown_among
from robodyn_cli.motion.baumgarte import GainStudy
from robodyn_cli.motion.build import projected_motion
from robodyn_cli.over.references import TrialReference
from robodyn_cli.over.stability import store
from robodyn_cli.over.stability.energy_growth import PERIODS, EnergyGrowth, growths, period
from robodyn_cli.over.stability.spectrum import Spectrum, instants, spectrum
from robodyn_cli.over.stability.trial import Budget, attempts, methods_tried, reference, step_of
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.ready.prepare import Setup, prepare, refuse_changes
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Ready, Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Termination
from robodyn_cli.summaries.stability import GainKeys, MethodTrial, StabilitySummary, StepLimit
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress

STIFF = 1e4  # decays of the fastest mode within a run from which on implicit methods give the reference
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
    ready, setup = started(scene, watch)
    with watch.stage("reference"):
        ref, first = find_reference(ready, setup, effort)
    with watch.stage("spectrum"):
        modes = along(setup, ref) or first
    with watch.stage("methods"):
        trials = attempts(ready, ref, effort.trial, methods_tried(quick), progress)
    with watch.stage("energy"):
        energy = follow_energy(ready, ref, modes, trials, effort, progress)
    planes: dict[str, store.GainPlane] = {}
    has_gains = bool(setup.problem.constraints.rows) and bool(scene.loops) and not setup.problem.dependent
    if has_gains:
        with watch.stage("baumgarte"):
            planes = gain_planes(ready, effort, progress)
    result = Result.of("stability", scene)
    summary = StabilitySummary(
        termination=Termination("report made", ref.until if ref else 0.0),
        reference=ref.keys if ref else None,
        spectrum=modes.keys if modes else None,
        step_limits=step_limits(modes),
        methods=trials,
        energy_growth=energy.keys,
        baumgarte={name: plane.keys for name, plane in planes.items()} if has_gains else ABSENT,
    )
    result.summarise(summary, seconds=watch.report())
    store.add_gains(result, planes)
    store.add_spectrum(result, modes)
    store.add_trials(result, trials)
    store.add_energy(result, energy)
    return result


def started(scene: Scene, watch: Stopwatch) -> tuple[Ready, Setup]:
    """Return the scene made ready, with its equations and start.

    Raises
    ------
    RobodynError : it cannot be started.
    """
    refuse_changes(scene, "stability")
    ready = integrable(scene, watch)
    return ready, prepare(ready, watch)


def find_reference(
    scene: Scene, setup: Setup, effort: Effort
) -> tuple[TrialReference | None, Spectrum | None]:
    """Return the reference solution, and the spectrum at the start, which decides by which methods."""
    first = at_start(setup)
    stiff = first is not None and first.fastest_decay * scene.simulate.duration > STIFF
    return reference(scene, effort.reference, stiff), first


def follow_energy(
    scene: Scene,
    ref: TrialReference | None,
    modes: Spectrum | None,
    trials: Sequence[MethodTrial],
    effort: Effort,
    progress: Progress,
) -> EnergyGrowth:
    """Follow the energy over many periods: one method of each family, the scene's, and what ``auto`` chose."""
    long = period(ref, modes, scene.simulate.duration)
    own = {*REPRESENTATIVES, scene.simulate.integrator, *(t.chosen for t in trials if t.method == "auto")}
    usable = [t.method for t in trials if t.status in ("stable", "inaccurate") and t.method in own - {"auto"}]
    return EnergyGrowth(long, PERIODS, growths(scene, usable, PERIODS * long.seconds, effort.long, progress))


def at_start(setup: Setup) -> Spectrum | None:
    """Return the spectrum at the start."""
    return eigenvalues(setup, np.zeros(1), setup.assembled.q[None, :], setup.assembled.v[None, :])


def eigenvalues(setup: Setup, times: Array, q: Array, v: Array) -> Spectrum | None:
    """Return the spectrum at states q (T, nq), v (T, nv), None where the equations cannot be linearised.

    Raises
    ------
    SceneError : the accelerations depend on data that the scene does not give.
    """
    problem: Problem = setup.problem
    system = build_system(problem, "none", work=False)
    if not isinstance(system.dynamics, Rolled) and (missing := unknown_among(system.rates)):
        raise unknown_data(missing)
    states = np.stack([system.join(*x) for x in zip(q, v)])
    try:
        modes = spectrum(problem, system, times, states, problem.scene.simulate.duration)
    except (RobodynError, np.linalg.LinAlgError):
        return None
    return modes if len(modes.times) else None


def along(setup: Setup, ref: TrialReference | None) -> Spectrum | None:
    """Return the spectrum along the reference solution."""
    if ref is None:
        return None
    model = setup.problem.model
    return eigenvalues(setup, *instants(setup.problem.scene, ref, model.nq, model.nv))


def step_limits(modes: Spectrum | None) -> list[StepLimit]:
    """Return, for each method whose step stability limits, the extents of its region and its largest step [s]."""
    table = limits()
    steps = modes.step_limits.T if modes is not None else [np.zeros(0)] * len(table)
    return [
        StepLimit(
            limit.method,
            limit.kind,
            limit.real,
            limit.imaginary,
            min(h[np.isfinite(h)].tolist(), default=None),
        )
        for limit, h in zip(table, steps)
    ]


def gain_planes(scene: Ready, effort: Effort, progress: Progress) -> dict[str, store.GainPlane]:
    """Run over the plane of Baumgarte's gains, by the method of the scene (``own``) and by fixed steps (``fixed``)."""
    s = scene.simulate
    fixed = dataclasses.replace(s, integrator=FIXED, step=step_of(s, FIXED))
    runs = {"own": scene}
    if s.integrator not in FIXED_STEP:
        runs["fixed"] = dataclasses.replace(scene, simulate=fixed)
    return {name: gain_plane(one, effort, progress) for name, one in runs.items()}


def gain_plane(scene: Ready, effort: Effort, progress: Progress) -> store.GainPlane:
    """Run one method over the plane of gains; what keeps it from that is in the keys."""
    factors = np.logspace(-3, 1, effort.gains)
    try:
        study = GainStudy(projected_motion(scene))
        chosen = study.choose()
        drift, error, steps, done = study.plane(factors, effort.gain_seconds, progress)
    except RobodynError as failure:
        return store.GainPlane(GainKeys(scene.simulate.integrator, message=failure.message))
    keys = GainKeys(study.method, chosen, study.step, study.over, done)
    return store.GainPlane(keys, factors / study.step, drift, error, steps)

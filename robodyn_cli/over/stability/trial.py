"""The error of each method of integration on a scene, against a reference that two methods agree on."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError, RobodynError, SingularConfigurationError
from robodyn_cli.integration_methods import METHODS, REFERENCES, REPRESENTATIVES, STIFF_REFERENCES
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.over.references import SAMPLES, Deadline, TrialReference, agreed, ran_out, tight
from robodyn_cli.record import mutable_record, record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene, SimulateOptions
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.stability import MethodTrial
from robodyn_cli.tools.progress import Progress, counted, no_progress
from robodyn_cli.works.simulate import simulate

INACCURATE = 1e-3  # an error above this part of the range of its quantity is a wrong answer
AGREED = 1e-5  # agreement of the references, relative to the range, beyond which nothing is judged
LOOSER = 100.0  # times the tolerance of a second run by the same method, where no other gets through
SMALL = 1e-3  # a quantity that ranges over less than this part of the largest of its kind is judged by that
HONEST = 0.1  # part of the true error that an estimate must reach


@record
class Budget:
    """What a run may take before it counts as too slow; seconds are the last resort."""

    steps: int = 2_000_000
    seconds: float = 20.0


@mutable_record
class TrialSolution:
    """Samples (T, n) of q and qd that a run came to, and the error that ended it before its time."""

    result: Result | None
    error: RobodynError | None
    seconds: float

    @property
    def times(self) -> Array:
        return self.result.time if self.result is not None else np.zeros(0)

    @property
    def positions(self) -> int:
        return self.result["q"].shape[1] if self.result is not None else 0

    @property
    def states(self) -> Array:
        if self.result is None:
            return np.zeros((0, 0))
        return np.concatenate([self.result["q"], self.result["qd"]], axis=1)


def step_of(s: SimulateOptions, method: str) -> float | None:
    """Return the step of a method without step control [s]: the scene's own, else a part of its duration."""
    fixed = method in METHODS and METHODS[method].fixed_step
    return 1e-3 * s.duration if fixed and s.step is None else s.step


def solve(scene: Scene, budget: Budget, **options: Any) -> TrialSolution:
    """Simulate a scene with other options of ``simulate``; what stops it comes back instead of being raised."""
    steps = min(budget.steps, int(options.pop("max_steps", budget.steps)))
    changed = dataclasses.replace(scene.simulate, samples=SAMPLES, max_steps=steps, **options)
    changed = dataclasses.replace(changed, step=step_of(changed, changed.integrator))
    began = time.perf_counter()
    try:
        result = simulate(dataclasses.replace(scene, simulate=changed), progress=Deadline(budget.seconds))
        return TrialSolution(result, None, time.perf_counter() - began)
    except RobodynError as error:
        return TrialSolution(
            error.result if isinstance(error.result, Result) else None, error, time.perf_counter() - began
        )


def _proper_end(solution: TrialSolution) -> bool:
    """Tell whether a run came to its end, or to that of its motion."""
    return solution.error is None or isinstance(solution.error, SingularConfigurationError)


def reference(scene: Scene, budget: Budget, stiff: bool = False) -> TrialReference | None:
    """Return the reference, or None where no two runs get through at tight tolerance.

    Two methods, explicit ones last where the scene is ``stiff``; where only one gets through, itself at two
    tolerances a hundred apart, which the names tell.
    """
    pair = _two_runs(scene, budget, STIFF_REFERENCES if stiff else REFERENCES)
    if len(pair) < 2:
        return None
    (first, a), (second, b) = pair
    count = min(len(a.times), len(b.times))
    if a.error is not None or b.error is not None:
        count = min(count, len(a.times) - 1, len(b.times) - 1)  # the last sample is where each one stopped
    x, y = a.states[:count], b.states[:count]
    ends_early = a.error.message if a.error is not None else ""
    common = agreed(a.times[:count], x, y, ranges(x, a.positions), AGREED, (first, second))
    return None if common is None else dataclasses.replace(common, ends_early=ends_early)


def _two_runs(scene: Scene, budget: Budget, order: Sequence[str]) -> list[tuple[str, TrialSolution]]:
    """Return the first two of the methods that get through at tight tolerance, or one at two tolerances."""

    def run(name: str, looser: float) -> TrialSolution | None:
        tolerance = looser * tight(name)
        one = solve(
            scene, budget, integrator=name, rtol=tolerance, atol=tolerance, step=None, error_estimate=False
        )
        through = one.result is not None and len(one.times) > 1 and _proper_end(one)
        return one if through else None

    solutions: list[tuple[str, TrialSolution]] = []
    for name in order:
        if (one := run(name, 1.0)) is not None:
            solutions.append((name, one))
        if len(solutions) == 2:
            return solutions
    if len(solutions) == 1 and (one := run(solutions[0][0], LOOSER)) is not None:
        name = solutions[0][0]
        solutions.append((f"{name} at {LOOSER * tight(name):.0e}", one))
    return solutions


def ranges(states: Array, positions: int) -> Array:
    """Return the range of each quantity over a run (n,), but no less than what matters beside the others."""
    spread = np.ptp(states, axis=0)
    # a joint that hardly moves is not judged by its own tiny range, but by a part of what the others do
    for part in (slice(0, positions), slice(positions, None)):
        spread[part] = np.maximum(spread[part], SMALL * spread[part].max(initial=0.0))
    return np.maximum(spread, 1e-12)


def attempt(scene: Scene, method: str, ref: TrialReference | None, budget: Budget) -> MethodTrial:
    """Run one method at the settings of the scene and judge it."""
    done = solve(scene, budget, integrator=method)
    trial = MethodTrial(method, seconds=done.seconds)
    if done.result is not None:
        summary = done.result.summary
        trial.chosen = summary["integrator"] + "".join(f", {s['to']}" for s in summary.get("switches", ()))
        trial.steps = summary["counters"]["steps"]
        trial.evaluations = summary["counters"]["evaluations"]
        trial.energy = summary["energy_drift_relative"]
        trial.until = float(done.times[-1]) if len(done.times) else 0.0
        estimate = summary.get("error_estimate")
        trial.estimate = estimate.get("state_max") if isinstance(estimate, dict) else None
    if done.error is not None:
        trial.message = done.error.message
        trial.failure = type(done.error).__name__
        trial.joint = done.error.details.get("joint")
        trial.quantity = done.error.details.get("quantity")
        trial.status = _status(done.error)
        if trial.status != "stable":
            return trial
    return judge(trial, done, ref)


def _status(error: RobodynError) -> str:
    if isinstance(error, SingularConfigurationError):
        return "stable"  # the motion ends there; whether it really does is for the reference to say
    if isinstance(error, CapabilityError):
        return "unsupported"
    return "too_slow" if ran_out(error) else "diverged"


def judge(trial: MethodTrial, done: TrialSolution, ref: TrialReference | None) -> MethodTrial:
    """Fill in error and status of a run that got through, as far as the reference goes."""
    if ref is None:
        trial.message = trial.message or "no reference to compare this result with"
        return trial
    states = done.states[: len(ref.times)]
    if len(states) < len(ref.times) - 2:
        trial.status = "inaccurate"
        trial.message = trial.message or f"ends at t = {trial.until:.6g} s, before the reference does"
        return trial
    apart = np.abs(states - ref.states[: len(states)])
    if not np.all(np.isfinite(apart)):
        trial.status, trial.message = "diverged", "a result that is not finite"
        return trial
    trial.error = float(apart.max(initial=0.0))
    trial.relative = float((apart / ref.scale).max(initial=0.0))
    if trial.relative > INACCURATE:
        trial.status = "inaccurate"
    elif ref.ends_early and done.error is None:
        trial.status, trial.message = "inaccurate", f"does not notice: {ref.ends_early}"
    if trial.estimate is not None and trial.relative > 100 * 10.0**-ref.digits:
        trial.honest = bool(trial.estimate >= HONEST * trial.error)
    return trial


def methods_tried(quick: bool) -> list[str]:
    """Return the methods that a report tries: ``auto`` and all, or with ``quick`` one of each family."""
    return ["auto", *(name for name in registry if not quick or name in REPRESENTATIVES)]


def attempts(
    scene: Scene,
    ref: TrialReference | None,
    budget: Budget,
    names: Sequence[str],
    progress: Progress = no_progress,
) -> list[MethodTrial]:
    """Run these methods."""
    # what auto does is judged, so a busy machine must not make it slow
    patient = dataclasses.replace(budget, steps=20 * budget.steps, seconds=max(budget.seconds, 60.0))
    return [
        attempt(scene, name, ref, patient if name == "auto" else budget)
        for name in counted(names, progress, "methods")
    ]

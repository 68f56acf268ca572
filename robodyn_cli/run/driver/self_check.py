"""A run checks itself: a balance of energy that no tolerance explains, an accuracy that was asked for and missed."""

from __future__ import annotations

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.integrators.registry import methods
from robodyn_cli.run.driver.driver import Driver
from robodyn_cli.run.driver.motion import Motion
from robodyn_cli.run.driver.second_run import NOT_MEANINGFUL, ErrorEstimate
from robodyn_cli.run.observation.recorder import Recorder
from robodyn_cli.spatial.algebra import Array

EPS = float(np.finfo(float).eps)
BEYOND = 1e3  # times what tolerance and rounding explain
STEADY = 1e-6  # stands in the place of rtol where a step is fixed
MANY = 1e3  # steps


def energy_out_of_balance(motion: Motion, driver: Driver, recorder: Recorder) -> NumericalError | None:
    """Return the error of a run that gains or loses more energy than its tolerances explain, with its time.

    Allowed is BEYOND times the largest of: rtol times the largest energy (summed over the steps where there are very
    many); what an error of atol in each coordinate, and of what watchers have integrated, makes of the energy; rounding
    over the steps.
    """
    if not recorder.samples:
        return None
    time = recorder.array("time")
    total = recorder.array("energy/total")
    kinetic, potential = recorder.array("energy/kinetic"), recorder.array("energy/potential")
    work = recorder.array("energy/work") if "energy/work" in recorder.blocks else np.zeros(len(time))
    drift = np.abs(total - work - (total[0] - work[0]))
    # energies have no zero: what counts is how far they range so far
    exchanged = np.maximum.accumulate(
        kinetic + np.abs(potential - potential[0]) + np.abs(work - work[0]) + np.abs(potential).max() * EPS
    )
    steps = driver.counters.steps
    options = motion.options
    rounding = EPS * max(steps, 1) * (exchanged + np.abs(potential).max())
    rtol = options.rtol if options.step is None else STEADY
    allowed = np.maximum(rtol * max(1.0, steps / MANY) * exchanged, rounding)
    least = options.atol + sum(watcher.error for watcher in motion.watchers)
    allowed = BEYOND * np.maximum(allowed, least * _sensitivity(recorder, exchanged))
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


def _sensitivity(recorder: Recorder, exchanged: Array) -> Array:
    """Return how much energy an error of one unit in each coordinate and rate stands for, roughly [J] (T,)."""
    q, v = recorder.array("q"), recorder.array("qd")
    fastest = np.maximum.accumulate(np.abs(v).max(axis=1, initial=0.0))
    moved = np.maximum.accumulate(np.abs(q - q[0]).max(axis=1, initial=0.0))
    small = 1e-12
    found: Array = exchanged * (2.0 / np.maximum(fastest, small) + 1.0 / np.maximum(moved, small))
    return found


def shortened_steps(motion: Motion, driver: Driver) -> list[str]:
    """Return a warning about steps of a fixed length that could not be taken as they are."""
    step, shorter = motion.options.step, driver.counters.rejected
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


def accuracy_warnings(estimate: ErrorEstimate | None) -> list[str]:
    """Return warnings about a motion whose estimated error is beyond all use."""
    if estimate is None or not isinstance(estimate.meaningful_until, float):
        return []
    return [
        f"the motion is not meaningful after t = {estimate.meaningful_until:.4g} s: its estimated error is above "
        f"{NOT_MEANINGFUL:.0%} of what its coordinates range over"
    ]

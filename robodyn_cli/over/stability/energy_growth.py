"""Energy over a long run: does a method gain or lose what the motion keeps."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.over.references import TrialReference, ran_out
from robodyn_cli.over.stability.spectrum import Spectrum
from robodyn_cli.over.stability.trial import Budget, TrialSolution, solve, step_of
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.stability import EnergyKeys, GrowthKeys, Period
from robodyn_cli.tools.progress import Progress, counted, no_progress

PERIODS = 1000
PATIENCE = 5.0  # times the fastest method's time: what a slower one may take for its long run
LEAST_SECONDS = 2.0
LONGEST = 100.0  # times the duration that a period of the linearised equations may last
CROSSINGS = 4  # passes through the middle that make a motion an oscillation


def period(ref: TrialReference | None, spectrum: Spectrum | None, duration: float) -> Period:
    """Return the period of a motion: the longest that its quantities show, else that of its slowest mode."""
    if ref is not None and len(ref.times) > 8:
        periods = []
        for column in (ref.states - ref.states.mean(axis=0)).T:
            side = np.sign(column[np.abs(column) > 1e-9 * np.abs(column).max(initial=0.0)])
            turns = int((side[1:] != side[:-1]).sum())
            if turns >= CROSSINGS:
                periods.append(2.0 * ref.until / turns)
        if periods:
            words = "twice the mean time between passes of the slowest coordinate through its mean"
            return Period(max(periods), words)
    if spectrum is not None and len(spectrum.eigenvalues):
        rates = np.abs(spectrum.eigenvalues[0].imag)
        rates = rates[rates > 1e-6 * max(float(rates.max(initial=0.0)), 1.0 / duration)]
        if rates.size and 2 * math.pi / rates.min() < duration:
            return Period(
                float(2 * math.pi / rates.min()), "the slowest oscillation of the linearised equations"
            )
        # the fastest one alone may be told from rounding where all take longer than the run
        fastest = float(np.abs(spectrum.eigenvalues.imag).max(initial=0.0))
        if fastest * LONGEST * duration > 2 * math.pi:
            long = 2 * math.pi / fastest
            words = "an oscillation" if long < duration else "an oscillation, longer than the scene,"
            return Period(long, f"{words} of the linearised equations on the way")
    return Period(duration, "the duration of the scene: nothing in it oscillates")


@record
class Growth:
    """The error of the energy balance of one method over many periods.

    times (T,) [s]; error (T,) : |E - E_0 - work| over ``scale``, the largest energy exchanged [J]. exponent : p of the
    fit error ~ t^p to its running maximum over the last nine tenths: 0 bounded, 0.5 rounding, 1 a steady drift.
    """

    method: str
    status: str
    times: Array
    error: Array
    scale: float
    steps: int
    seconds: float
    message: str = ""

    @property
    def largest(self) -> float:
        return float(self.error.max(initial=0.0))

    @property
    def exponent(self) -> float | None:
        running = np.maximum.accumulate(self.error)
        late = (self.times > 0.1 * self.times[-1]) & (running > 0.0) if len(self.times) else np.zeros(0, bool)
        if late.sum() < 8:
            return None
        return float(np.polyfit(np.log(self.times[late]), np.log(running[late]), 1)[0])

    @property
    def keys(self) -> GrowthKeys:
        """What the summary says of it."""
        until = float(self.times[-1]) if len(self.times) else 0.0
        return GrowthKeys(
            self.method, self.status, until, self.largest, self.scale, self.exponent, self.steps, self.seconds,
            self.message,
        )  # fmt: skip


@record
class EnergyGrowth:
    """The energy over many periods, by method."""

    period: Period
    periods: int
    growths: list[Growth]

    @property
    def keys(self) -> EnergyKeys:
        """What the summary says of it."""
        return EnergyKeys(self.period, self.periods, [g.keys for g in self.growths])


def growth(scene: Scene, method: str, duration: float, budget: Budget) -> Growth:
    """Run a method over a long duration and follow the energy balance.

    The step of a method without step control stays what it is over the duration of the scene.
    """
    step = step_of(scene.simulate, method)
    return _growth(
        method, solve(scene, budget, integrator=method, step=step, duration=duration, error_estimate=False)
    )


def growths(
    scene: Scene,
    methods: Sequence[str],
    duration: float,
    budget: Budget,
    progress: Progress = no_progress,
) -> list[Growth]:
    """Follow the energy with each method, for ``PATIENCE`` times the time of the fastest before it at most.

    A method that is cut off there still tells how its error grows, up to the time that it has reached.
    """
    followed: list[Growth] = []
    for method in counted(methods, progress, "methods"):
        followed.append(growth(scene, method, duration, budget))
        if followed[-1].status == "ok":
            allowed = max(LEAST_SECONDS, PATIENCE * followed[-1].seconds)
            budget = dataclasses.replace(budget, seconds=min(budget.seconds, allowed))
    return followed


def _growth(method: str, done: TrialSolution) -> Growth:
    status = "ok"
    if done.error is not None:
        status = "too_slow" if ran_out(done.error) else "stopped"
    message = done.error.message if done.error is not None else ""
    if done.result is None:
        return Growth(method, status, np.zeros(0), np.zeros(0), 0.0, 0, done.seconds, message)
    result = done.result
    balance = result["energy/total"].copy()
    if "energy/work" in result:
        balance -= result["energy/work"]
    kinetic, potential = result["energy/kinetic"], result["energy/potential"]
    with np.errstate(all="ignore"):
        scale = max(float(np.ptp(potential)), float(kinetic.max(initial=0.0)), 1e-300)
        error = np.abs(balance - balance[0]) / scale
    kept = np.isfinite(error)
    steps = result.summary["counters"]["steps"]
    return Growth(method, status, result.time[kept], error[kept], scale, steps, done.seconds, message)

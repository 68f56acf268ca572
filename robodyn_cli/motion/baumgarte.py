"""The choice of Baumgarte's gains, and a scan of the plane (alpha, beta).

The gains are parameters of the compiled code, so any number of pairs runs on one compilation.
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.index1 import projection
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.motion import Motion
from robodyn_cli.record import record
from robodyn_cli.scene.types import Baumgarte
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.motion import Gains
from robodyn_cli.tools.progress import Progress, no_progress

SAMPLES = 129  # at which trial runs are compared
FACTORS = tuple(2.0**k for k in range(-12, 3))  # c in alpha = beta = c / h that are tried, the smallest first
LONGEST = 5_000  # steps of the trial runs: the gains of a long run are chosen on its first part
TIGHTER = 1e-3  # tolerance of the run that the errors are measured against, over that of the trial
TIGHTEST = 3e-14  # tolerance


@record
class GainOutcome:
    """The result of a run with a pair of gains.

    drift : largest distance of the positions from the constraints, as the step that projection would take [rad, m].
    residual : largest residual of the loops [m]. error : largest error of any q. steps : it took. Infinite where
    the run fails.
    """

    alpha: float
    beta: float
    drift: float
    residual: float
    error: float
    steps: int


class GainStudy:
    """Runs of one mechanism with any gains, against its projected motion.

    step : mean step of the projected run [s]. over : length of the trial runs [s]. method : of integration.

    Raises
    ------
    CapabilityError : rows of the loops depend on each other: which of them are fed back changes on the way, and gains
        studied for some say nothing of the others. Or joints stick and meet stops, which no watcher follows here.
    """

    def __init__(self, projected: Motion) -> None:
        problem = projected.problem
        refuse_study(problem)
        self.motion, self.options = projected, projected.options
        alpha, beta = problem.graph.symbols(["alpha", "beta"], "p")
        self.system = build_system(problem, Baumgarte(alpha=alpha, beta=beta), work=False)  # type: ignore[arg-type]
        q, _ = projection(problem)
        self._observe = SampleKernel({"q": q, "eta": problem.constraints.eta}, STATE_GROUPS)
        self.over = projected.scene.simulate.duration
        states, steps, reached = self._run(projected.system, (), self.options, LONGEST)
        if reached < self.over:
            self.over = reached
            states, steps, _ = self._run(projected.system, (), self.options, LONGEST + 1)
        self.reference, _, _ = self._run(projected.system, (), self._precise(), 100 * LONGEST)
        self.step = self.over / max(steps, 1)
        # below what rounding leaves there is no error to stay under
        rounding = 1e-13 * float(np.abs(self.system.split(self.reference)[0]).max(initial=0.0))
        self.integration_error = max(self._error(states), rounding)

    @property
    def method(self) -> str:
        """The method of integration."""
        return self.motion.choice.method

    def _precise(self) -> Options:
        """Return the options of the run that the others are measured against."""
        options = self.options
        tight = max(options.rtol * TIGHTER, TIGHTEST)
        step = None if options.step is None else options.step / 4
        return dataclasses.replace(options, rtol=tight, atol=options.atol * tight / options.rtol, step=step)

    def _run(
        self, system: System, gains: tuple[float, ...], options: Options, most: int
    ) -> tuple[Array, int, float]:
        """Return samples (T, nx), the number of steps and how far the run came; it may come less far than asked."""
        driver = Driver(system, self.method, dataclasses.replace(options, max_steps=most), parameters=gains)
        driver.start(0.0, self.motion.start)
        rows: list[Array] = []
        try:
            driver.run(self.over, Grid.over(self.over, SAMPLES), lambda t, x: rows.append(x), watch=False)
        except NumericalError as error:
            if error.details.get("status") != "max_steps" or driver.time <= 0.0:
                raise
        return np.concatenate(rows), driver.counters.steps, driver.time

    def _error(self, states: Array) -> float:
        q, reference = (self.system.split(x)[0] for x in (states, self.reference[: len(states)]))
        return float(np.abs(q - reference).max(initial=0.0))

    def outcome(self, alpha: float, beta: float) -> GainOutcome:
        """Run with a pair of gains."""
        try:
            x, steps, reached = self._run(self.system, (alpha, beta), self.options, 20 * LONGEST)
        except NumericalError:
            return GainOutcome(alpha, beta, np.inf, np.inf, np.inf, 0)
        if reached < self.over:
            return GainOutcome(alpha, beta, np.inf, np.inf, np.inf, steps)
        times = Grid.over(self.over, SAMPLES).times(0, SAMPLES)
        groups = self.system.groups(times, x, np.array([alpha, beta]))
        values = self._observe.evaluate(SAMPLES, groups)
        drift = float(np.abs(values["q"] - groups["q"]).max(initial=0.0))
        return GainOutcome(
            alpha, beta, drift, float(np.abs(values["eta"]).max(initial=0.0)), self._error(x), steps
        )

    def choose(self) -> Gains:
        """Return the smallest gains alpha = beta = c / h whose drift stays below the integration error."""
        best: tuple[float, GainOutcome] | None = None
        for factor in FACTORS:
            outcome = self.outcome(factor / self.step, factor / self.step)
            if best is None or outcome.drift < best[1].drift:
                best = (factor, outcome)
            if outcome.drift <= self.integration_error:
                best = (factor, outcome)
                break
        assert best is not None
        factor, outcome = best
        return Gains(
            outcome.alpha,
            outcome.beta,
            factor,
            self.step,
            outcome.drift,
            outcome.error,
            self.integration_error,
            self.over,
            outcome.drift <= self.integration_error,
        )

    def plane(
        self, factors: Array, seconds: float, progress: Progress = no_progress
    ) -> tuple[Array, Array, Array, int]:
        """Return drift, error and steps over (alpha, beta) = factors / h, rows by alpha; NaN where time ran out."""
        n = len(factors)
        drift, error, steps = (np.full((n, n), np.nan) for _ in range(3))
        end, done = time.perf_counter() + seconds, 0
        for i, a in enumerate(factors):
            for k, b in enumerate(factors):
                if time.perf_counter() > end:
                    return drift, error, steps, done
                progress(done, n * n, "gains")
                outcome = self.outcome(float(a) / self.step, float(b) / self.step)
                drift[i, k], error[i, k], steps[i, k] = outcome.drift, outcome.error, outcome.steps or np.nan
                done += 1
        return drift, error, steps, done


def refuse_study(problem: Problem) -> None:
    """Raise where no gains can be chosen.

    Raises
    ------
    CapabilityError : see ``GainStudy``.
    """
    if problem.dependent:
        raise CapabilityError(
            "Baumgarte's gains are not chosen where rows of the loops depend on each other; "
            "allowed: projection, none, Baumgarte's {alpha, beta}",
            ("simulate.stabilisation",),
            key="simulate.stabilisation",
        )
    if problem.is_held:
        raise CapabilityError(
            "the runs that choose Baumgarte's gains do not follow joints that stick, "
            "meet rigid stops or latch; allowed: projection, none, Baumgarte's {alpha, beta}",
            ("simulate.stabilisation",),
            key="simulate.stabilisation",
        )

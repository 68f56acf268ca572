"""The choice of the integrator, and the change to another on the way, when a motion turns stiff and when it calms.

Looked at is, every so many steps, whether the fastest decay is of the size of the pace; if so, both methods go the same
short way from the present state, and the cheaper one goes on. Looks cost a small part of what the run has cost itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError
from robodyn_cli.expr.graph import Expr, Scalar, free_symbols
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import DEFAULT, STIFF
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.record import record
from robodyn_cli.run.driver.driver import Driver, MethodChange, Supervisor
from robodyn_cli.run.driver.motion import Choice
from robodyn_cli.scene.types import Scene

Array = NDArray[Any]
LARGEST = 12  # velocities up to which an exact Jacobian is worth its code
FAST_DECAYS = 2e3  # decays of the fastest mode within the run from which on stiffness is looked into
TRIAL = 0.02  # part of the run over which two methods are compared
# what an evaluation costs: eight lanes at once, and those with their share of the linear algebra
COST = {DEFAULT: 1.4, STIFF: 3.0}
FIRST_LOOK = 300  # steps of the run before it is looked at, and between looks at least
LONGEST = 10_000  # steps between looks at most; in between they are half as long apart as the run so far
WORTH = 2_000  # steps that the rest of the run takes at this pace, below which it is not worth a look
MOST = 20_000  # steps of a trial at the start
TRIAL_STEPS = 20  # of the other method
PART = 0.05  # of the cost of the run so far, and of the rest of it at this pace, that a trial may take
BETTER = 1.5  # times cheaper over the same way is what the other method has to be
# The default method is held to steps of a few times the fastest decay time. Where that is what it does while nothing
# else asks for such steps, the motion is stiff.
STIFF_PACE = 0.1  # part of the rate of its steps above which the fastest decay may be what asks for them
LEAST = 2.0  # what a decay asks of the default method, in units of cost


def can_be_stiff(problem: Problem) -> bool:
    """Tell whether anything in the scene can damp: without that no mode decays and nothing is stiff."""
    if problem.model.nv > LARGEST:
        return False
    if problem.dissipated or isinstance(problem.elements.power, Expr):
        return True
    rates = {v.index for v in problem.v}
    return any(e.index in rates for tau in problem.actuator_torques for e in free_symbols([tau]))


def choose(scene: Scene, problem: Problem, system: System, start: Array, options: Options) -> Choice:
    """Return the method that a scene asks for, or for ``auto`` the one that suits the motion.

    Stiff is what the default method finds stiff: where some mode decays thousands of times within the run, both
    methods go a short way, and the one that needs less work there goes on.
    """
    asked = scene.simulate.integrator
    if asked != "auto":
        return Choice(asked, "asked for in simulate.integrator")
    usual = "collocation of order 16: the fastest at every accuracy where the motion is not stiff"
    if system.dynamics.any_size or not can_be_stiff(problem):
        return Choice(DEFAULT, usual)
    decay = fastest_decay(system, 0.0, start)
    duration = scene.simulate.duration
    if decay * duration < FAST_DECAYS:
        return Choice(DEFAULT, usual, may_change=True)
    trial = max(TRIAL * duration, min(duration, 20.0 / decay))
    slow, fast = (cost_of(system, m, start, trial, options) for m in (DEFAULT, STIFF))
    if fast < slow:
        return Choice(
            STIFF,
            f"stiff: the fastest mode decays in {1 / decay:.1e} s; an implicit method with the exact "
            f"Jacobian needs {'far less work' if not np.isfinite(slow) else f'{fast / slow:.0%} of the work'} "
            f"of {DEFAULT} over the first {trial:.3g} s",
            may_change=True,
        )
    reason = f"{usual}; stiffness was looked into (fastest decay {1 / decay:.1e} s)"
    return Choice(DEFAULT, reason, may_change=True)


def supervisor_for(choice: Choice) -> Supervisor | None:
    """Return who may change the method on the way; None where it was asked for, or nothing can damp."""
    return StiffnessWatch() if choice.may_change else None


class StiffnessWatch:
    """Asks, every so many steps, whether the other method would do better.

    steps : of the run, rejected ones too, after which it is to ask next.
    """

    def __init__(self) -> None:
        self.steps = FIRST_LOOK
        self.cost = 0.0  # of the run up to the last look
        self.spent = 0.0  # on trials
        self._entries: list[Scalar] | None = None
        self._seen = (0.0, 0, 0)  # time, steps and evaluations there

    def reconsider(self, driver: Driver) -> MethodChange | None:
        """Return the change to make, None to go on as it is."""
        time, steps, evaluations = self._seen
        self._seen = driver.time, driver.attempts, driver.counters.evaluations
        went, taken = driver.time - time, driver.attempts - steps
        paid = COST[driver.method] * (driver.counters.evaluations - evaluations)
        self.cost += paid
        self.steps = driver.attempts + min(max(FIRST_LOOK, driver.attempts // 2), LONGEST)
        rest = (
            (driver.end - driver.time) / went if went > 0.0 else 0.0
        )  # in units of the way since the last look
        each = paid / taken
        if rest * taken < WORTH or not self._affordable(2.0 * BETTER * TRIAL_STEPS * each, rest * paid):
            return None
        decay = self._fastest_decay(driver)
        stiff = driver.method == STIFF
        may = LEAST * decay < paid / went if stiff else decay > STIFF_PACE * taken / went
        if not may or not self._other_is_better(driver, each):
            return None
        return MethodChange(
            driver.time, driver.attempts, other_than(driver.method), 1.0 / decay if decay > 0.0 else None
        )

    def _affordable(self, trial: float, rest: float) -> bool:
        """Tell whether one more trial is small beside the cost of the run so far, and beside the rest of it."""
        return self.spent + trial <= PART * self.cost or self.spent + trial <= PART * rest

    def _fastest_decay(self, driver: Driver) -> float:
        if self._entries is None:
            self._entries = jacobian_entries(driver.system)
        return decay_at(driver.system, self._entries, driver.time, driver.state, driver.parameters)

    def _other_is_better(self, driver: Driver, each: float) -> bool:
        """Tell whether the other method goes a short way from the present state for clearly less.

        each : cost of a step of the present method.
        """
        here = driver.time
        other = trial(driver, other_than(driver.method), driver.end, TRIAL_STEPS)
        self.spent += other.cost
        if other.failed or not other.time > here:
            return False
        most = int(BETTER * other.cost / each) + 1
        own = trial(driver, driver.method, other.time, most)
        self.spent += own.cost
        return own.failed or own.time < other.time or own.cost > BETTER * other.cost


def other_than(method: str) -> str:
    """Return the other one of the two methods that ``auto`` knows."""
    return STIFF if method == DEFAULT else DEFAULT


@record
class Trial:
    """A short run: how far it came [s], what it cost, and whether something else than its steps ended it."""

    time: float
    cost: float
    failed: bool


def trial(driver: Driver, method: str, end: float, steps: int) -> Trial:
    """Go on for a few steps from where a driver is, apart from it and without events."""
    options = dataclasses.replace(driver.options, max_steps=steps)
    scout = Driver(driver.system, method, options, parameters=driver.parameters)
    scout.start(driver.time, driver.state)
    failed = False
    try:
        scout.advance(end)
    except NumericalError as error:
        failed = error.details.get("status") != "max_steps"
    return Trial(scout.time, COST[method] * scout.counters.evaluations, failed)


def cost_of(system: System, method: str, start: Array, end: float, options: Options) -> float:
    """Return the cost of a run from ``start`` at t = 0 up to ``end``, infinite where it fails or takes many steps."""
    driver = Driver(system, method, dataclasses.replace(options, max_steps=MOST))
    driver.start(0.0, start)
    try:
        driver.advance(end)
    except NumericalError:
        return np.inf
    return COST[method] * driver.counters.evaluations


# -- the fastest decay --------------------------------------------------------------------------------------
def jacobian_entries(system: System) -> list[Scalar]:
    """Return the Jacobian of (q, v, z)-dot as expressions, row by row."""
    from robodyn_cli.formulations.linearisation import differentiate

    entries: list[Scalar] = differentiate(system.rates, system.nq, system.nv).J.ravel().tolist()
    return entries


def decay_at(system: System, entries: Sequence[Scalar], t: float, x: Array, p: Array) -> float:
    """Return the largest -Re of the eigenvalues of the Jacobian at a state x (nx,) [1/s], 0 where it is not finite."""
    groups = system.own_groups(np.array([t]), x, p)
    numbers = evaluate(list(entries), {group: values.tolist() for group, values in groups.items()})
    J = np.array(numbers, dtype=float).reshape(system.size, system.size)
    if not np.all(np.isfinite(J)):
        return 0.0
    return float(max(0.0, -np.linalg.eigvals(J).real.min()))


def fastest_decay(system: System, t: float, x: Array, p: Sequence[float] = ()) -> float:
    """Return the largest -Re of the eigenvalues of the Jacobian of (q, v, z)-dot at a state x (nx,) [1/s]."""
    return decay_at(system, jacobian_entries(system), t, x, parameters_at(system, t, x, p))


def parameters_at(system: System, t: float, x: Array, given: Sequence[float] = ()) -> Array:
    """Return the parameters p at a state: those ``given`` (by default the system's), or what its partition chooses."""
    if system.partition is None:
        return np.array(given if len(given) else system.parameters or [0.0])
    chosen = system.partition.choose(t, system.split(x)[0], None)
    return np.concatenate([np.zeros(system.partition.first), chosen])

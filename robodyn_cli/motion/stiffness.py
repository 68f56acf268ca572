"""Stiffness on the way: a run changes to an implicit method when its motion turns stiff, and back when it no longer is.

Every so many steps the fastest decay of the linearised equations is compared with the length of the steps. Where it may
be what limits them, both methods go the same short way from the present state, and the cheaper one goes on. Such
trials take a small part of the cost of the run.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from robodyn_cli.errors import NumericalError, unknown_data
from robodyn_cli.expr.calculus import jacobian_at
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.expr.rebuild import numbers
from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import DEFAULT, STIFF
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.driver import Driver, MethodChange
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

# relative cost of an evaluation: of eight states at once, and with its share of the linear algebra
COST = {DEFAULT: 1.4, STIFF: 3.0}
FIRST_LOOK = 300  # steps of the run before the first check, and between checks at least
LONGEST = 10_000  # steps between checks at most; else a check comes when the run has grown by half
WORTH = 2_000  # steps that the rest of the run takes at this rate, below which no check is worth its cost
MOST = 20_000  # steps of a trial at the start, at most
TRIAL_STEPS = 20  # of the other method
PART = 0.05  # of the cost of the run so far, or of the rest of it at this rate, that trials may take
BETTER = 1.5  # times cheaper over the same way is what the other method has to be
# A fast decay limits the default method to steps of a few times its time constant. Where nothing else limits the steps
# as much, the motion is stiff.
STIFF_PACE = 0.1  # steps per second times this: a faster decay [1/s] may be what limits the steps
LEAST = 2.0  # cost of following one decay time by the default method, at least


class StiffnessWatch:
    """Checks, every so many steps, whether the other method would do better.

    steps : of the run, rejected ones too, after which the next check is due.
    """

    def __init__(self) -> None:
        self.steps = FIRST_LOOK
        self.cost = 0.0  # of the run up to the last check
        self.spent = 0.0  # on trials
        self._seen = (0.0, 0, 0)  # time, steps and evaluations at the last check

    def reconsider(self, driver: Driver) -> MethodChange | None:
        """Return the change to make, None to go on as it is."""
        time, steps, evaluations = self._seen
        self._seen = driver.time, driver.attempts, driver.counters.evaluations
        went, taken = driver.time - time, driver.attempts - steps
        paid = COST[driver.method] * (driver.counters.evaluations - evaluations)
        self.cost += paid
        self.steps = driver.attempts + min(max(FIRST_LOOK, driver.attempts // 2), LONGEST)
        # the rest of the run, in units of the way since the last check
        rest = (driver.end - driver.time) / went if went > 0.0 else 0.0
        each = paid / taken
        if rest * taken < WORTH or not self._affordable(2.0 * BETTER * TRIAL_STEPS * each, rest * paid):
            return None
        decay = fastest_decay(driver.system, driver.time, driver.state, driver.parameters)
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
    partition, p = driver.system.partition, driver.parameters
    scout = Driver(
        driver.system, method, options, parameters=p if partition is None else p[: partition.first]
    )
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
def fastest_decay(system: System, t: float, x: Array, p: Array) -> float:
    """Return the largest -Re of the eigenvalues of the Jacobian of (q, v, z)-dot [1/s], 0 where it is not finite.

    Parameters
    ----------
    x : state (nx,). p : parameters.

    Raises
    ------
    SceneError : the accelerations depend on data that the scene does not give.
    """
    groups = {group: values.tolist() for group, values in system.own_groups(np.array([t]), x, p).items()}
    symbols = free_symbols(system.rates)
    missing = [e.value[0] for e in symbols if e.value[1] not in groups]
    if missing:
        raise unknown_data(missing)
    first = {"q": 0, "v": system.nq, "z": system.nq + system.nv}
    states = [e for e in symbols if e.value[1] in first]
    J = np.eye(len(x), k=system.nq)
    try:
        rows = jacobian_at(system.rates, states, groups)
    except (ArithmeticError, ValueError):
        J = numbers(system.jacobian.J, groups)
    else:
        J[system.nq :] = 0.0
        J[system.nq :, [first[e.value[1]] + e.value[2] for e in states]] = rows
    return float(largest_decays(J))


def largest_decays(J: Array) -> Any:
    """Return the largest -Re of the eigenvalues of Jacobians (..., n, n) [1/s], 0 where one is not finite."""
    finite = np.isfinite(J).all(axis=(-2, -1), keepdims=True)
    return np.maximum(0.0, -np.linalg.eigvals(np.where(finite, J, 0.0)).real.min(axis=-1, initial=np.inf))

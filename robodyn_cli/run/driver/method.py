"""The choice of the integrator, and the change to another when a motion turns stiff."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError
from robodyn_cli.expr.graph import Expr, free_symbols
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.record import record
from robodyn_cli.run.driver.driver import Driver
from robodyn_cli.run.driver.motion import Choice
from robodyn_cli.scene.types import Scene

Array = NDArray[Any]
DEFAULT = "gauss"
STIFF = "radau13"
LARGEST = 12  # velocities up to which an exact Jacobian is worth its code
FAST_DECAYS = 2e3  # decays of the fastest mode within the run from which on stiffness is looked into
TRIAL = 0.02  # part of the run over which two methods are compared
BUDGET = 20_000  # steps of the default method before it is asked again whether the motion is stiff
STIFF_PACE = (
    0.1  # part of the rate of steps; a motion whose fastest decay is above it is what asks for the steps
)
# what an evaluation costs: eight lanes at once, and those with their share of the linear algebra
COST = {DEFAULT: 1.4, STIFF: 3.0}


def can_be_stiff(problem: Problem) -> bool:
    """Tell whether anything in the scene can damp: without that no mode decays and nothing is stiff."""
    if problem.model.nv > LARGEST:
        return False
    if problem.dissipated or isinstance(problem.elements.power, Expr):
        return True
    rates = {v.index for v in problem.v}
    return any(e.index in rates for tau in problem.actuator_torques for e in free_symbols([tau]))


def fastest_decay(system: System, t: float, x: Array, p: Sequence[float] = ()) -> float:
    """Return the largest -Re of the eigenvalues of the Jacobian of (q, v, z)-dot at a state x (nx,) [1/s].

    Raises
    ------
    SceneError : the accelerations depend on data that the scene does not give.
    """
    from robodyn_cli.formulations.linearisation import differentiate
    from robodyn_cli.kernels.program import unknown_data

    entries = differentiate(system.rates, system.nq, system.nv).J.ravel().tolist()
    groups = system.own_groups(np.array([t]), x, parameters_at(system, t, x, p))
    missing = [symbol.value[0] for symbol in free_symbols(entries) if symbol.value[1] not in groups]
    if missing:
        raise unknown_data(missing)
    numbers = evaluate(entries, {group: values.tolist() for group, values in groups.items()})
    J = np.array(numbers, dtype=float).reshape(system.size, system.size)
    if not np.all(np.isfinite(J)):
        return 0.0
    return float(max(0.0, -np.linalg.eigvals(J).real.min()))


def parameters_at(system: System, t: float, x: Array, given: Sequence[float] = ()) -> Array:
    """Return the parameters p at a state: those ``given`` (by default the system's), or what its partition chooses."""
    if system.partition is None:
        return np.array(given if len(given) else system.parameters or [0.0])
    chosen = system.partition.choose(t, system.split(x)[0], None)
    return np.concatenate([np.zeros(system.partition.first), chosen])


def cost_of(system: System, method: str, start: Array, end: float, options: Options) -> float:
    """Return the cost of a trial run up to ``end``, infinite where it fails or needs too many steps."""
    driver = Driver(system, method, dataclasses.replace(options, max_steps=BUDGET))
    driver.start(0.0, start)
    try:
        driver.advance(end)
    except NumericalError:
        return np.inf
    return COST[method] * driver.counters.evaluations


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
        )
    reason = f"{usual}; stiffness was looked into (fastest decay {1 / decay:.1e} s)"
    return Choice(DEFAULT, reason, may_change=True)


@record
class Change:
    """A change of method on the way. time [s], to : the new method, fastest_decay : time constant [s]."""

    time: float
    to: str
    fastest_decay: float


class StiffnessWatch:
    """Asks after many steps of the default method whether the motion has turned stiff; ``changes`` says when it had."""

    def __init__(self) -> None:
        self.steps: int | None = BUDGET
        self.changes: list[Change] = []

    @staticmethod
    def for_choice(choice: Choice) -> StiffnessWatch | None:
        """Return the supervisor of a run with this choice, None where the method was asked for or nothing can damp."""
        return StiffnessWatch() if choice.may_change else None

    def reconsider(self, driver: Driver) -> str | None:
        """Return the method for stiff motions, or None to go on and ask again."""
        pace = max(driver.counters.steps, 1) / max(driver.time, 1e-300)
        decay = fastest_decay(driver.system, driver.time, driver.state, driver.parameters.tolist())
        # the default method is held to steps of a few times the fastest decay time; where that is what it does
        # while nothing else asks for such steps, the motion is stiff
        if decay <= STIFF_PACE * pace:
            return None
        self.changes.append(Change(driver.time, STIFF, 1.0 / decay))
        self.steps = None
        return STIFF

"""The choice of the method of integration, at the start and on the way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Expr, free_symbols
from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import DEFAULT, STIFF
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.driver import Supervisor
from robodyn_cli.motion.motion import MethodChoice
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

LARGEST = 12  # velocities up to which an exact Jacobian is worth compiling
FAST_DECAYS = 2e3  # decays of the fastest mode within the run from which on stiffness is looked into
TRIAL = 0.02  # part of the run over which two methods are compared
# operations of the equations up to which Taylor series in lanes are quicker than the default method
SERIES = 80
# operations of a step of the series up to which they are so where rates may change abruptly: there the default method
# trusts its steps less
STEEP_SERIES = 8500
LOOSE = 3e-7  # relative tolerance down to which order 12 takes no longer than order 16
# operations of the equations up to which ``dop853`` in lanes is quicker than the default method
EXPLICIT = 1100
TIGHT = 1e-9  # relative tolerance down to which it is so
SHARE = 1.0 / 30.0  # of the tolerances, at which it errs about as much as that method

Rows = NDArray[np.int64]
Cost = Callable[[str, Rows, Array], Array]  # of a method in runs (n,) over times (n,) [s]


def can_be_stiff(problem: Problem) -> bool:
    """Tell whether anything in the scene can damp: without that no mode decays and nothing is stiff."""
    if problem.model.nv > LARGEST:
        return False
    if problem.dissipated or (problem.model.forces and isinstance(problem.elements.power, Expr)):
        return True
    rates = {v.index for v in problem.v}
    return any(e.index in rates for tau in problem.actuator_torques for e in free_symbols([tau]))


def compare(decays: Any, durations: Any, cost: Cost) -> tuple[Rows, Array, Array, Array]:
    """Return which runs may be stiff, for how long [s] both methods were tried there, and what they cost: the default
    one and the stiff one.

    These are runs (N,) whose fastest modes decay thousands of times; tried is a part of them, and until modes decay.
    """
    rows = np.flatnonzero(decays * durations >= FAST_DECAYS)
    decays, durations = decays[rows], durations[rows]
    trials = np.maximum(TRIAL * durations, np.minimum(durations, 20.0 / decays))
    slow, fast = (cost(m, rows, trials) if len(rows) else trials for m in (DEFAULT, STIFF))
    return rows, trials, slow, fast


def choose(scene: Scene, problem: Problem, system: System, start: Array, options: Options) -> MethodChoice:
    """Return the method that a scene asks for, or for ``auto`` the one that suits the motion.

    Stiff is what the default method finds stiff: where some mode decays thousands of times within the run, both
    methods go a short way, and the one that needs less work there goes on.
    """
    wanted = scene.simulate.integrator
    if wanted != "auto":
        return MethodChoice(wanted, "asked for in simulate.integrator")
    usual = "collocation of order 16: the fastest at every accuracy where the motion is not stiff"
    if system.dynamics.any_size or not can_be_stiff(problem):
        return MethodChoice(DEFAULT, usual)
    from robodyn_cli.motion.stiffness import cost_of, fastest_decay

    decay = fastest_decay(system, 0.0, start, system.parameters_at(0.0, system.split(start)[0]))

    def cost(method: str, rows: Any, trials: Array) -> Array:
        return np.array([cost_of(system, method, start, float(trials[0]), options)])

    rows, *costs = compare(np.array([decay]), np.array([scene.simulate.duration]), cost)
    if not len(rows):
        return MethodChoice(DEFAULT, usual, may_change=True)
    trial, slow, fast = (float(x[0]) for x in costs)
    if fast < slow:
        return MethodChoice(
            STIFF,
            f"stiff: the fastest mode decays in {1 / decay:.1e} s; an implicit method with the exact "
            f"Jacobian needs {'far less work' if not np.isfinite(slow) else f'{fast / slow:.0%} of the work'} "
            f"of {DEFAULT} over the first {trial:.3g} s",
            may_change=True,
        )
    reason = f"{usual}; stiffness was looked into (fastest decay {1 / decay:.1e} s)"
    return MethodChoice(DEFAULT, reason, may_change=True)


def side_by_side(scene: Scene, system: System) -> tuple[str, float] | None:
    """Return the method that for ``auto`` makes many runs of a scene side by side in the lanes of vectors, quicker than
    the default method, and the share of the tolerances at which it is as accurate; None where none does.

    One run alone takes half as long by the default method, which evaluates the stages of a step side by side.
    """
    from robodyn_cli.integrators.registry import methods
    from robodyn_cli.integrators.stepping.lanes import suits
    from robodyn_cli.kernels.compiler import machine

    rtol = scene.simulate.rtol
    if scene.simulate.integrator != "auto" or machine().lanes == 1:
        return None
    series = methods["taylor12" if rtol > LOOSE else "taylor16"]
    if not series.obstacle(system) and suits(system, series) and _is_small(system, series.order):
        return series.name, 1.0
    if rtol < TIGHT or system.dynamics.any_size or system.dynamics.program.operations > EXPLICIT:
        return None
    explicit = methods["dop853"]
    suited = not explicit.obstacle(system) and suits(system, explicit)
    return (explicit.name, SHARE) if suited else None


def _is_small(system: System, order: int) -> bool:
    """Tell whether the equations are so small that a Taylor series of an order in lanes is the quickest."""
    from robodyn_cli.integrators.methods.gauss import Gauss
    from robodyn_cli.kernels.series.rules import Series

    program = system.dynamics.program
    if program.operations <= SERIES:
        return True
    return Gauss.is_steep(system) and Series.of(program).work(order) <= STEEP_SERIES


def supervisor_for(choice: MethodChoice) -> Supervisor | None:
    """Return what may change the method on the way; None where the scene names a method, or nothing can damp."""
    if not choice.may_change:
        return None
    from robodyn_cli.motion.stiffness import StiffnessWatch

    return StiffnessWatch()

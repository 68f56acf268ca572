"""Index 1: accelerations from equation (36), loops kept closed by projection, by Baumgarte, or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.constraints import correction, solve_with_multipliers
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.formulations.dynamics import Expanded, Rolled
from robodyn_cli.formulations.system import EventFunction, System
from robodyn_cli.kernels.rolled import prefer_rolled
from robodyn_cli.scene.types import Baumgarte


def index1(
    problem: Problem,
    stabilisation: str | Baumgarte = "projection",
    events: Sequence[EventFunction] = (),
    work: bool = True,
    expanded: bool = False,
) -> System:
    """Return the system that an explicit or collocation method steps.

    Long open trees get rolled dynamics (see ``prefer_rolled``), all others expressions.

    Parameters
    ----------
    stabilisation : ``projection`` (position and velocity put back after each step), ``none``, or Baumgarte's
        gains, which add -2 alpha (Psi v + eta_t) - beta^2 eta to the acceleration constraint.
    work : carry the work of actuators and damping as a further state, where there is any.
    expanded : give expressions in any case, for those who look into them.
    """
    constraints = problem.constraints
    power = problem.power if work else 0.0
    z_rate = (power,) if isinstance(power, Expr) or power != 0.0 else ()
    position: Sequence[Scalar] = ()
    velocity: Sequence[Scalar] = ()
    if constraints.rows and isinstance(stabilisation, Baumgarte):
        alpha, beta = stabilisation.alpha, stabilisation.beta
        rate = _velocity_residual(problem)
        gamma = [
            g + 2.0 * alpha * r + beta * beta * e for g, r, e in zip(constraints.gamma, rate, constraints.eta)
        ]
        factor = LdlFactor.of(problem.mass_matrix, problem.elimination_order)
        qdd = solve_with_multipliers(factor, problem.applied - problem.bias, problem.psi, gamma).qdd
    elif not expanded and is_rolled(problem):
        rolled = Rolled(problem.model, list(problem.applied), z_rate)
        return _system(problem, rolled, events)
    else:
        qdd = problem.forward.qdd
    if constraints.rows and stabilisation == "projection":
        position, velocity = projection(problem)
    return _system(
        problem, Expanded(tuple(qdd), z_rate), events,
        position_correction=tuple(position), velocity_correction=tuple(velocity),
    )  # fmt: skip


def _system(
    problem: Problem, dynamics: Rolled | Expanded, events: Sequence[EventFunction], **corrections: Any
) -> System:
    return System(
        nq=problem.model.nq,
        nv=problem.model.nv,
        dynamics=dynamics,
        nz=len(dynamics.z_rate),
        events=(*events, *kinks(problem)),
        breakpoints=problem.breakpoints,
        **corrections,
    )


def is_rolled(problem: Problem) -> bool:
    """Tell whether a simulation goes by loops over the bodies instead of one graph of expressions."""
    return not problem.scene.prescribed and prefer_rolled(problem.model)


def kinks(problem: Problem) -> tuple[EventFunction, ...]:
    """Return the events of formulas that switch with the state (times are breakpoints)."""
    return tuple(
        EventFunction(key, switch, terminal=False, kink=True) for key, switch in problem.state_switches
    )


def _velocity_residual(problem: Problem) -> list[Scalar]:
    """Return Psi v + eta_t."""
    out = []
    for row in problem.constraints.rows:
        total: Scalar = row.eta_t
        for x, v in zip(row.psi, problem.v):
            total = total + x * v
        out.append(total)
    return out


def projection(problem: Problem) -> tuple[list[Scalar], list[Scalar]]:
    """Return one Newton step onto eta = 0 and the step onto Psi v + eta_t = 0, both of least norm."""
    psi = problem.psi
    dq = correction(psi, problem.constraints.eta)
    dv = correction(psi, _velocity_residual(problem))
    q: list[Scalar] = [x - d for x, d in zip(problem.q, dq)]
    v: list[Scalar] = [x - d for x, d in zip(problem.v, dv)]
    return q, v


def residuals(problem: Problem) -> dict[str, list[Scalar]]:
    """Return eta and Psi v + eta_t, for reports."""
    return {"position": problem.constraints.eta, "velocity": _velocity_residual(problem)}


def multiplier_norm(lam: np.ndarray) -> np.ndarray:
    """Return the Euclidean norm over the rows (T,)."""
    return np.asarray(np.sqrt((lam**2).sum(axis=1)))

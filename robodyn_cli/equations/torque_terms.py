"""The parts of the torques that a motion needs, as expressions.

Power of the forces that have no potential, by what exerts them.
"""

from __future__ import annotations

from collections.abc import Iterable

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar, is_nonzero

Outputs = dict[str, list[Scalar]]


def torque_terms(problem: Problem) -> Outputs:
    """Return the parts of tau = M qdd + C qd + G - tau_passive - tau_friction - tau_external, by name.

    Inertia is always included; any other part that vanishes identically is left out. Friction has the exact sign of
    the rate.
    """
    terms: Outputs = {name: list(term) for name, term in problem.rigid_terms().items()}
    for name, term in problem.passive_forces(smooth=False).items():
        terms[name] = [-x for x in term]
    return {
        name: term for name, term in terms.items() if name == "inertia" or any(is_nonzero(x) for x in term)
    }


def powers(problem: Problem) -> dict[str, Scalar]:
    """Return the power of all forces without a potential [W]."""
    rows = problem.constraints
    # Psi^T lambda does work at the rate -lambda eta_t on a row that depends on time
    driven = total(problem.forward.lam[i] * rows.rows[i].eta_t for i in rows.rheonomic)
    return {**applied_powers(problem), "prescribed motion": -driven}


def applied_powers(problem: Problem) -> dict[str, Scalar]:
    """Return the power of actuators, of losses, and of forces between bodies that have no potential [W]."""
    v = problem.v
    return {
        "actuators": total(tau * rate for tau, rate in zip(problem.actuator_torques, v)),
        "friction, dampers or stops": total(torque * v[place] for place, torque in problem.dissipated),
        "forces on points and between bodies": problem.elements.power if problem.model.forces else 0.0,
    }


def total(terms: Iterable[Scalar]) -> Scalar:
    """Return the sum."""
    return sum(terms, 0.0)

"""The parts of the torques that a motion needs, as expressions."""

from __future__ import annotations

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

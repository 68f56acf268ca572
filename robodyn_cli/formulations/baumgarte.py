"""Index 1 with Baumgarte's terms: the drift of the loops is fed back into the acceleration constraint.

Psi v-dot + gamma + 2 alpha (Psi v + eta_t) + beta^2 eta = 0
"""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import Expanded
from robodyn_cli.formulations.formulated import Formulated
from robodyn_cli.scene.types import Baumgarte


def baumgarte(problem: Problem, z_rate: Sequence[Scalar], gains: Baumgarte) -> Formulated:
    """Return the equations of index 1 with the feedback of ``gains`` [1/s]."""
    constraints, alpha, beta = problem.independent_rows, gains.alpha, gains.beta
    rate = constraints.velocity_residual(problem.v)
    gamma = [
        g + 2.0 * alpha * r + beta * beta * e for g, r, e in zip(constraints.gamma, rate, constraints.eta)
    ]
    return Formulated(Expanded(tuple(problem.solution(gamma)[0].qdd), tuple(z_rate)))

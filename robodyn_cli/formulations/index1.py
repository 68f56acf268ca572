"""The result of a formulation: equations to integrate, in the mechanism's own symbols t, q, v, p.

Index 1 as it stands: accelerations and multipliers from equation (36); loops drift apart by rounding and error.

Index 1 with Baumgarte's terms: the drift of the loops is fed back into the acceleration constraint.

Psi v-dot + gamma + 2 alpha (Psi v + eta_t) + beta^2 eta = 0

Index 1 with projection: after each step q is put back onto eta = 0, and v onto Psi v + eta_t = 0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from robodyn_cli.algorithms.constraints import correction
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import Dynamics, Expanded
from robodyn_cli.formulations.system import NO_CORRECTIONS, Corrections, Partition
from robodyn_cli.record import record
from robodyn_cli.scene.types import Baumgarte

if TYPE_CHECKING:
    from robodyn_cli.formulations.index3 import Index3
    from robodyn_cli.formulations.residual import Residual


@record
class Formulated:
    """Rates with their corrections and partition; see ``System`` for the meaning of the fields."""

    dynamics: Dynamics
    corrections: Corrections = NO_CORRECTIONS
    partition: Partition | None = None
    forms: OtherForms | None = None


class OtherForms:
    """Other forms of one mechanism's equations, each built when a method asks for it."""

    def __init__(self, problem: Problem, z_rate: Sequence[Scalar]) -> None:
        self.problem = problem
        self.z_rate = tuple(z_rate)

    @cached_property
    def index3(self) -> Index3:
        """Positions and multipliers as unknowns."""
        from robodyn_cli.formulations.index3 import Index3

        return Index3(self.problem)

    @cached_property
    def residual(self) -> Residual | None:
        """Accelerations as corrections of a guess, None where the equations cannot be written so."""
        from robodyn_cli.formulations.residual import Residual

        return Residual(self.problem, self.z_rate) if Residual.fits(self.problem) else None


# (problem, rates of the further states z, what ``simulate.stabilisation`` says)
Formulation = Callable[[Problem, Sequence[Scalar], Any], Formulated]


def plain(problem: Problem, z_rate: Sequence[Scalar], asked: object = None) -> Formulated:
    """Return the equations of index 1 with nothing added."""
    dynamics = Expanded(tuple(problem.forward.qdd), tuple(z_rate))
    return Formulated(dynamics, forms=OtherForms(problem, z_rate))


def baumgarte(problem: Problem, z_rate: Sequence[Scalar], gains: Baumgarte) -> Formulated:
    """Return the equations of index 1 with the feedback of ``gains`` [1/s]."""
    constraints, alpha, beta = problem.independent_rows, gains.alpha, gains.beta
    rate = constraints.velocity_residual(problem.v)
    gamma = [
        g + 2.0 * alpha * r + beta * beta * e for g, r, e in zip(constraints.gamma, rate, constraints.eta)
    ]
    return Formulated(Expanded(tuple(problem.solution(gamma)[0].qdd), tuple(z_rate)))


def projected(problem: Problem, z_rate: Sequence[Scalar], asked: object = None) -> Formulated:
    """Return the equations of index 1 with both corrections."""
    formulated = plain(problem, z_rate)
    q, v = projection(problem)
    return dataclasses.replace(formulated, corrections=Corrections(position=tuple(q), velocity=tuple(v)))


def projection(problem: Problem) -> tuple[list[Scalar], list[Scalar]]:
    """Return one Newton step onto eta = 0, along the joints' manifolds, and the step onto Psi v + eta_t = 0.

        dq = -Psi^T (Psi Psi^T)^-1 eta,   dv = -Psi^T (Psi Psi^T)^-1 (Psi v + eta_t)

    Both are of least norm in the velocity coordinates, on which Psi acts.
    """
    constraints = problem.independent_rows
    corrected = correction(constraints.psi(problem.model.nv))
    dq = corrected(constraints.eta)
    dv = corrected(constraints.velocity_residual(problem.v))
    q = problem.moved(dq)
    v: list[Scalar] = [x - d for x, d in zip(problem.v, dv)]
    return q, v

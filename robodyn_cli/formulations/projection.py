"""Index 1 with projection: after each step q is put back onto eta = 0, and v onto Psi v + eta_t = 0."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from robodyn_cli.algorithms.constraints import correction
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.formulated import Formulated
from robodyn_cli.formulations.plain import plain
from robodyn_cli.formulations.system import Corrections


def projected(problem: Problem, z_rate: Sequence[Scalar], asked: object = None) -> Formulated:
    """Return the equations of index 1 with both corrections."""
    found = plain(problem, z_rate)
    q, v = projection(problem)
    return dataclasses.replace(found, corrections=Corrections(position=tuple(q), velocity=tuple(v)))


def projection(problem: Problem) -> tuple[list[Scalar], list[Scalar]]:
    """Return one Newton step onto eta = 0, along the joints' manifolds, and the step onto Psi v + eta_t = 0.

        dq = -Psi^T (Psi Psi^T)^-1 eta,   dv = -Psi^T (Psi Psi^T)^-1 (Psi v + eta_t)

    Both are of least norm in the velocity coordinates, on which Psi acts.
    """
    constraints = problem.independent_rows
    psi = constraints.psi(problem.model.nv)
    dq = correction(psi, constraints.eta)
    dv = correction(psi, constraints.velocity_residual(problem.v))
    q = problem.moved(dq)
    v: list[Scalar] = [x - d for x, d in zip(problem.v, dv)]
    return q, v

"""Exact derivatives of inverse and forward dynamics."""

from __future__ import annotations

import numpy as np

from robodyn_cli.algorithms.coriolis import coriolis
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.derivatives import by_steps, by_symbols
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.calculus import substitute
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array, Matrix, Vector, identity, vector, zeros
from robodyn_cli.torques.build import open_problem
from robodyn_cli.torques.dynamics import forward_problem, timeless


@record
class TorqueDerivatives:
    """Derivatives of tau(q, qd, qdd), each (T, nv, nv) or (nv, nv): row i of the torque, column k of the variable.

    dq : by steps along the joints' manifolds, which are q itself where q-dot = v. dqd, dqdd : by rates and
    accelerations; dqdd is M.
    """

    dq: Array
    dqd: Array
    dqdd: Array


@record
class AccelerationDerivatives:
    """Derivatives of qdd(q, qd, tau), each (T, nv, nv) or (nv, nv), as ``TorqueDerivatives``; dtau is M^-1."""

    dq: Array
    dqd: Array
    dtau: Array


@record
class Changes:
    """tau of inverse dynamics (nv,), with d tau / dq by steps and d tau / dv (nv, nv)."""

    tau: Vector
    by_q: Matrix
    by_v: Matrix

    @staticmethod
    def of(problem: Problem) -> Changes:
        """Return the derivatives with as few operations as may be: a quarter fewer than those of tau as it stands.

        The tree has base parameters. Where q-dot = v, d(C v) / dv = 2 C, for Christoffel's symbols are symmetric in
        the two indices that C v sums over.
        """
        tree, v = problem.lumped, problem.v
        rigid = rnea(tree, problem.q, v, problem.a, problem.gravity, problem.X)
        other = sum(timeless(problem), zeros(problem.model.nv))
        quasi = any(body.joint.quasi for body in tree.bodies)
        by_v = by_symbols(rigid, v) if quasi else 2.0 * coriolis(tree, problem.q, v, problem.X)
        tau = rigid - other
        return Changes(tau, by_steps(problem, tau), by_v - by_symbols(other, v))


def torque_derivatives(problem: Problem) -> dict[str, Matrix]:
    """Return d tau / dq, d tau / dv and d tau / da of inverse dynamics, by the names of ``TorqueDerivatives``."""
    found = Changes.of(open_problem(problem, "inverse dynamics"))
    inertia = by_symbols(found.tau, problem.a) if geared(problem.model) else problem.mass_matrix
    return {"dq": found.by_q, "dqd": found.by_v, "dqdd": inertia}


def acceleration_derivatives(problem: Problem) -> dict[str, Matrix]:
    """Return d a / dq, d a / dv and d a / d tau of forward dynamics, by the names of ``AccelerationDerivatives``.

    d a / dx = -M^-1 d ID / dx at a = FD(q, v, tau) for x = q, v, and d a / d tau = M^-1, with one factor of M
    (Carpentier and Mansard 2018, "Analytical derivatives of rigid body dynamics algorithms", section IV).
    """
    model = forward_problem(problem).model
    nv, tau = model.nv, vector(problem.graph.symbols(model.v_names, "tau"))
    found = Changes.of(problem)
    factor = LdlFactor.of(problem.mass_matrix, problem.elimination_order)
    a = factor.solve(sum(timeless(problem), tau - problem.bias))
    here = substitute(
        [*found.by_q.flat, *found.by_v.flat], {symbol.index: x for symbol, x in zip(problem.a, a)}
    )
    of_q, of_v = np.array([-x for x in here], dtype=object).reshape(2, nv, nv)
    solved = [solve_columns(factor, right) for right in (of_q, of_v, identity(nv))]
    return dict(zip(("dq", "dqd", "dtau"), solved))


def solve_columns(factor: LdlFactor, right: Matrix) -> Matrix:
    """Return A^-1 B (n, k)."""
    return np.stack([factor.solve(column) for column in right.T], axis=1)

"""Exact derivatives of inverse and forward dynamics, with loops at independent states; the regressor of the inertial
parameters, and places of frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.composite import coriolis
from robodyn_cli.algorithms.kinematics import world_jacobian
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.residuals import by_steps, by_symbols
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import unknown_data
from robodyn_cli.expr.calculus import substitute
from robodyn_cli.expr.graph import is_nonzero, is_number
from robodyn_cli.model.model import Body, FixedFrame
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array, Matrix, Vector, identity, matrix, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia
from robodyn_cli.torques.dynamics import forward_problem, open_problem, timeless


def frame_jacobian(problem: Problem, frame: FixedFrame) -> Matrix:
    """Return J (6, nv) of a frame in world axes: rows of the angular velocity, then of its origin's velocity.

    J v is the frame's twist (w, v) as ``frames/NAME/twist`` of a result has it.
    """
    linear, angular = world_jacobian(problem.model, problem.q, problem.pose, frame)
    return np.concatenate([angular, linear])


def centre_of_mass(problem: Problem) -> Vector:
    """Return the centre of mass of all moving bodies (3,), world coordinates: sum h / sum m."""
    mass, moment = 0.0, zeros(3)
    for k, body in enumerate(problem.model.bodies):
        pose, inertia = problem.pose[k], body.inertia
        mass = mass + inertia.m
        moment = moment + inertia.m * pose.p + pose.R @ inertia.h
    return problem.model.base.point(moment / mass)


OF_BODY = (
    ("mass", "kg"), ("mx", "kg m"), ("my", "kg m"), ("mz", "kg m"), ("Ixx", "kg m^2"), ("Iyy", "kg m^2"),
    ("Izz", "kg m^2"), ("Ixy", "kg m^2"), ("Ixz", "kg m^2"), ("Iyz", "kg m^2"),
)  # fmt: skip
GROUP = "inertial"


@record
class InertialParameters:
    """What the torques of rigid bodies depend on linearly, in the order of the regressor's columns.

    names : ``LINK.mass``, ``LINK.mx`` to ``LINK.mz``, the first moments, and ``LINK.Ixx`` to ``LINK.Iyz``, the inertia
    about the origin of the joint that carries the link, all in that joint's axes, turning with the link, and with what
    is fixed to it; ``COLUMN.rotor``, N^2 J of a joint's rotor. values : (P,), those of the scene. units : SI.
    """

    names: tuple[str, ...]
    values: Array
    units: tuple[str, ...]


@record
class Regressor:
    """Y (nv, P) as expressions, with M a + C v + G = Y p, and the parameters p (P,)."""

    Y: Matrix
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[Any, ...]

    @staticmethod
    def of(problem: Problem) -> Regressor:
        """Return the regressor: the torques of a tree with symbols for parameters, differentiated by them."""
        columns = [c for body in problem.model.bodies for c in _of_body(problem, body)]
        symbols = problem.graph.symbols([name for name, _, _ in columns], GROUP)
        rest = iter(symbols)
        bodies = tuple(_with_symbols(body, rest) for body in problem.model.bodies)
        tree = dataclasses.replace(problem.model, bodies=bodies)
        tau = rnea(tree, problem.q, problem.v, problem.a, problem.gravity, problem.X)
        Y = by_symbols(tau, symbols)
        return Regressor(Y, *zip(*columns))

    def parameters(self) -> InertialParameters:
        """Return the scene's parameters; what it does not give is 0 where no torque depends on it.

        Raises
        ------
        SceneError : it does not give what torques depend on.
        """
        used = [any(is_nonzero(x) for x in column) for column in self.Y.T]
        missing = [n for n, x, needed in zip(self.names, self.values, used) if needed and not is_number(x)]
        if missing:
            raise unknown_data(missing)
        values = np.array([float(x) if is_number(x) else 0.0 for x in self.values])
        return InertialParameters(self.names, values, self.units)


def _of_body(problem: Problem, body: Body) -> Iterator[tuple[str, str, Any]]:
    """Give name, unit and value of a body's parameters."""
    I = body.inertia
    values = (I.m, *I.h, *(I.I[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))))
    for (name, unit), value in zip(OF_BODY, values):
        yield f"{body.name}.{name}", unit, value
    for k, rotor in enumerate(body.rotors, start=body.v):
        if is_nonzero(rotor):
            unit = "kg m^2" if problem.model.v_units[k] == "rad" else "kg"
            yield f"{problem.model.v_names[k]}.rotor", unit, rotor


def _with_symbols(body: Body, symbols: Iterator[Any]) -> Body:
    """Return a body whose parameters are the next symbols."""
    m, hx, hy, hz, xx, yy, zz, xy, xz, yz = (next(symbols) for _ in OF_BODY)
    I = matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    armature: Sequence[Any] = [next(symbols) if is_nonzero(x) else 0.0 for x in body.rotors]
    return dataclasses.replace(
        body, inertia=RigidInertia(m, vector([hx, hy, hz]), I), parts=(), armature=tuple(armature)
    )


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
    changes = Changes.of(open_problem(problem, "inverse dynamics"))
    inertia = by_symbols(changes.tau, problem.a) if geared(problem.model) else problem.mass_matrix
    return {"dq": changes.by_q, "dqd": changes.by_v, "dqdd": inertia}


def acceleration_derivatives(problem: Problem) -> dict[str, Matrix]:
    """Return d a / dq, d a / dv and d a / d tau of forward dynamics, by the names of ``AccelerationDerivatives``.

    d a / dx = -M^-1 d ID / dx at a = FD(q, v, tau) for x = q, v, and d a / d tau = M^-1, with one factor of M
    (Carpentier and Mansard 2018, "Analytical derivatives of rigid body dynamics algorithms", section IV).
    """
    model = forward_problem(problem).model
    nv, tau = model.nv, vector(problem.graph.symbols(model.v_names, "tau"))
    changes = Changes.of(problem)
    factor = LdlFactor.of(problem.mass_matrix, problem.elimination_order)
    a = factor.solve(sum(timeless(problem), tau - problem.bias))
    here = substitute(
        [*changes.by_q.flat, *changes.by_v.flat], {symbol.index: x for symbol, x in zip(problem.a, a)}
    )
    of_q, of_v = np.array([-x for x in here], dtype=object).reshape(2, nv, nv)
    solved = [solve_columns(factor, right) for right in (of_q, of_v, identity(nv))]
    return dict(zip(("dq", "dqd", "dtau"), solved))


def solve_columns(factor: LdlFactor, right: Matrix) -> Matrix:
    """Return A^-1 B (n, k)."""
    return np.stack([factor.solve(column) for column in right.T], axis=1)

"""Torques as a linear function of the bodies' inertial parameters, for identification."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.linear.derivatives import by_symbols
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import unknown_data
from robodyn_cli.expr.graph import is_nonzero, is_number
from robodyn_cli.model.model import Body
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array, Matrix, matrix, vector
from robodyn_cli.spatial.inertia import RigidInertia

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

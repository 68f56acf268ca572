"""Bushing: stiffness and damping against all six relative motions of two frames."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from robodyn_cli.expr.functions import atan2, maximum, sqrt, where
from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.forces.element import (
    Between,
    Effect,
    End,
    HalfTurn,
    Setting,
    between_key,
    opposite,
)
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, ListOf, Name, Vector, key, role_key
from robodyn_cli.spatial.algebra import Matrix, Wrench, cross, dot, identity, matrix, skew, vector, zeros
from robodyn_cli.spatial.algebra import Vector as Components

SMALL = 1e-2  # sin^2 of the angle below which series replace quotients
# arcsin(x) / x and (1 - (theta/2) cot(theta/2)) / theta^2 in even powers
ARCSINE = (1.0, 1 / 6, 3 / 40, 5 / 112, 35 / 1152, 63 / 2816, 231 / 13312, 143 / 10240)
HALF_COTANGENT = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000)


def _series(coefficients: tuple[float, ...], x: Any) -> Any:
    total: Any = 0.0
    for a in reversed(coefficients):
        total = total * x + a
    return total


def rotation_vector(R: Matrix) -> tuple[Components, Matrix]:
    """Return the rotation vector phi of R, and the inverse left Jacobian B with dphi/dt = B w.

    w is the angular velocity of the turned frame in the coordinates of the other. phi = theta a for a rotation by theta
    in [0, pi) about the unit vector a;  B = E - phi~ / 2 + (1 - (theta / 2) cot(theta / 2)) / theta^2 phi~ phi~
    (Chirikjian 2012, section 10.6). Near theta = pi phi is not unique.
    """
    s, c = _sine_and_cosine(R)
    turning = [k for k in range(3) if is_nonzero(s[k])]
    if len(turning) <= 1:
        phi = zeros(3)
        for k in turning:
            phi[k] = atan2(s[k], c)
        return phi, identity()
    square = dot(s, s)
    large = maximum(square - SMALL, -c)
    sine = sqrt(where(large, square, SMALL))  # never zero where it is not used
    theta = atan2(sine, c)
    phi = s * where(large, theta / sine, _series(ARCSINE, square))
    theta2 = dot(phi, phi)
    kappa = where(
        large,
        (1.0 - 0.5 * theta * (1.0 + c) / sine) / maximum(theta2, SMALL),
        _series(HALF_COTANGENT, theta2),
    )
    P = skew(phi)
    return phi, identity() - 0.5 * P + kappa * (P @ P)


def _sine_and_cosine(R: Matrix) -> tuple[Components, Any]:
    """Return sin(theta) a and cos(theta) of the rotation by theta about the unit vector a."""
    s = 0.5 * vector([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return s, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)


def _matrix(diagonal: tuple[float, ...] | None, rows: tuple[tuple[float, ...], ...] | None) -> Matrix:
    if rows is not None:
        return matrix(rows)
    out = zeros(6, 6)
    for k, x in enumerate(diagonal or ()):
        out[k, k] = x
    return out


def _diagonal(unit: str, doc: str) -> Any:
    return key(Vector(6), default=None, unit=unit, doc=doc)


def _rows(unit: str, doc: str) -> Any:
    return key(ListOf(Vector(6), minimum=6, maximum=6), default=None, unit=unit, doc=doc)


@record
class Bushing(Between):
    """Wrench of ``-(K xi + C dxi/dt)`` between two frames; potential energy ``xi^T K xi / 2``.

    xi = (x, phi): the second frame's origin in the axes of the first, and the rotation vector of its axes. K and C
    are given by their diagonals or as symmetric matrices. Full turns are counted where all joints between the bodies
    turn about parallels of an axis that the frames share; elsewhere phi is at most half a turn, and jumps there.
    """

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("bushing",)), doc="Kind of force.")
    between: tuple[str, ...] = between_key()
    stiffness: tuple[float, ...] | None = _diagonal(
        "N/m, N m/rad", "Diagonal of K: along x, y, z, about x, y, z."
    )
    damping: tuple[float, ...] | None = _diagonal("N s/m, N m s/rad", "Diagonal of C, in the same order.")
    stiffness_matrix: tuple[tuple[float, ...], ...] | None = _rows(
        "N/m, N, N m/rad", "Or the whole of K: six rows, symmetric."
    )
    damping_matrix: tuple[tuple[float, ...], ...] | None = _rows(
        "N s/m, N s, N m s/rad", "Or the whole of C: six rows, symmetric."
    )
    role: str = role_key("spring")

    def problems(self) -> Iterable[tuple[tuple[str, ...], str]]:
        given = [
            n for n in ("stiffness", "stiffness_matrix", "damping", "damping_matrix") if getattr(self, n)
        ]
        if not given:
            yield (), "needs a 'stiffness' or a 'damping' (or 'stiffness_matrix', 'damping_matrix')"
        for name in ("stiffness", "damping"):
            if getattr(self, name) is not None and getattr(self, f"{name}_matrix") is not None:
                yield (f"{name}_matrix",), f"stands beside {name!r}; give one or the other"
        for name in given:
            value = np.array(getattr(self, name), dtype=float)
            A = np.diag(value) if value.ndim == 1 else value
            size = float(np.abs(A).max())
            if np.abs(A - A.T).max() > 1e-12 * size:
                yield (name,), "must be symmetric"
            elif np.linalg.eigvalsh(A).min() < -1e-12 * size:
                yield (name,), "must not be negative in any direction (an eigenvalue is below zero)"

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return wrenches, energy and power."""
        first, second = ends
        K = _matrix(self.stiffness, self.stiffness_matrix)
        C = _matrix(self.damping, self.damping_matrix)
        R = first.R.T @ second.R
        d = second.p - first.p
        phi, B, half_turns = _turned(R, setting)
        xi = np.concatenate([first.R.T @ d, phi])
        x_rate = first.R.T @ (second.v - first.v - cross(first.w, d))
        xi_rate = np.concatenate([x_rate, B @ (first.R.T @ (second.w - first.w))])
        elastic, loss = K @ xi, C @ xi_rate
        load = elastic + loss
        actions = opposite(ends, Wrench(-(B.T @ load[3:]), -load[:3]).rotated(first.R))
        stiff = any(is_nonzero(x) for x in K[3:].flat)
        return Effect(actions, 0.5 * dot(xi, elastic), -dot(xi_rate, loss), half_turns if stiff else ())


def _turned(R: Matrix, setting: Setting) -> tuple[Components, Matrix, tuple[HalfTurn, ...]]:
    """Return the rotation vector phi of R, B with dphi/dt = B w, and where phi jumps."""
    axis = setting.hinge()
    if axis is not None:
        return vector(axis) * setting.turn(axis), identity(), ()
    phi, B = rotation_vector(R)
    s, c = _sine_and_cosine(R)
    half_turns = []
    for k in range(3):
        if is_nonzero(s[k]):
            # s changes its sign at half a turn. R_kk = 2 a_k^2 - 1 there: of the three components only those with
            # a_k^2 > 1/4 are watched, since the others may touch zero
            aside = maximum(0.25 - 0.5 * (1.0 + R[k, k]), 0.0)
            half_turns.append(HalfTurn.of(phi[k], s[k] + aside, c, 1.0))
    return phi, B, tuple(half_turns)

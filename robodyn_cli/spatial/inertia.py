"""Inertia of rigid bodies and of articulated bodies."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.expr.graph import is_number
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    Vector,
    congruence,
    cross,
    dot,
    identity,
    skew,
    zeros,
)


@record
class RigidInertia:
    """Mass m [kg], first moment h = m c [kg m] and rotational inertia I [kg m^2] about the frame's origin.

    Spatial inertia of Featherstone (2008), equation 2.63, kept in its ten numbers.
    """

    m: Any
    h: Vector
    I: Matrix

    @staticmethod
    def zero() -> RigidInertia:
        return RigidInertia(0.0, zeros(3), zeros(3, 3))

    @staticmethod
    def from_com(m: Any, c: Vector, I_com: Matrix) -> RigidInertia:
        """Build from mass, centre of mass c [m] and inertia about the centre of mass (parallel axes)."""
        h = m * c
        return RigidInertia(m, h, I_com + parallel_axis(h, c))

    def __add__(self, other: RigidInertia) -> RigidInertia:
        return RigidInertia(self.m + other.m, self.h + other.h, self.I + other.I)

    def __sub__(self, other: RigidInertia) -> RigidInertia:
        return RigidInertia(self.m - other.m, self.h - other.h, self.I - other.I)

    def to_parent(self, X: Transform) -> RigidInertia:
        """Express in the parent frame A the inertia given in B (X from A to B): X^T I X."""
        h = X.E.T @ self.h
        I = congruence(X.E, self.I)
        shift = _shift_matrix(X.r, h, self.m)
        return RigidInertia(self.m, h + self.m * X.r, I + shift)


def parallel_axis(h: Vector, c: Vector) -> Matrix:
    """Return -skew(h) skew(c) for parallel h and c: what the shift to the origin adds to I."""
    hc = [h[k] * c[k] for k in range(3)]
    out = zeros(3, 3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = hc[j] + hc[k]
        out[i, j] = out[j, i] = -(h[i] * c[j])
    return out


def _shift_matrix(r: Vector, h: Vector, m: Any) -> Matrix:
    """Return what moving the reference by r adds to I: 2 (r.h) E - r h^T - h r^T + m (r.r E - r r^T)."""
    u = [2.0 * h[k] + m * r[k] for k in range(3)]
    s = [h[k] + m * r[k] for k in range(3)]
    out = zeros(3, 3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = r[j] * u[j] + r[k] * u[k]
        out[i, j] = out[j, i] = -(r[i] * s[j] + h[i] * r[j])
    return out


@record
class ArticulatedInertia:
    """Symmetric spatial inertia in 3x3 blocks: n = A w + H v, f = H^T w + M v."""

    A: Matrix
    H: Matrix
    M: Matrix

    @staticmethod
    def from_rigid(body: RigidInertia) -> ArticulatedInertia:
        return ArticulatedInertia(body.I, skew(body.h), body.m * identity())

    def __add__(self, other: ArticulatedInertia) -> ArticulatedInertia:
        return ArticulatedInertia(self.A + other.A, self.H + other.H, self.M + other.M)

    def column(self, s: Vector) -> Vector:
        """Return the 6-vector I s for a motion s = (angular, linear)."""
        w, v = s[:3], s[3:]
        return np.concatenate([self.A @ w + self.H @ v, self.H.T @ w + self.M @ v])

    def downdate(self, U: Vector, V: Vector) -> ArticulatedInertia:
        """Return I - (U V^T + V U^T) / 2 for parallel U and V (I^a of Featherstone 2008, equation 7.23)."""

        def block(a: Vector, b: Vector, symmetric: bool) -> Matrix:
            out = zeros(3, 3)
            for i in range(3):
                for j in range(i if symmetric else 0, 3):
                    out[i, j] = a[i] * b[j]
                    if symmetric:
                        out[j, i] = out[i, j]
            return out

        n, f, p, g = U[:3], U[3:], V[:3], V[3:]
        A, H, M = block(n, p, True), block(n, g, False), block(f, g, True)
        return ArticulatedInertia(self.A - A, self.H - H, self.M - M)

    def to_parent(self, X: Transform) -> ArticulatedInertia:
        """Return X^T I X (Featherstone 2008, table 2.1), in the parent frame."""
        A, M = congruence(X.E, self.A), congruence(X.E, self.M)
        H = X.E.T @ self.H @ X.E
        P = skew(X.r)
        H_shifted = H + P @ M
        # A' = A + P H^T - H' P, symmetric: computed once above the diagonal
        left = P @ H.T
        shifted = zeros(3, 3)
        for i in range(3):
            for j in range(i, 3):
                shifted[i, j] = shifted[j, i] = A[i, j] + left[i, j] - dot(H_shifted[i], P[:, j])
        return ArticulatedInertia(shifted, H_shifted, M)


def consistency(m: float, I_com: np.ndarray) -> list[tuple[str, float]]:
    """List what is physically wrong with a mass and an inertia about the centre of mass.

    Returns
    -------
    Pairs (what, deficit): a negative principal moment, a violated triangle inequality (Traversaro et al.
    2016), inertia without mass.
    """
    problems: list[tuple[str, float]] = []
    moments = np.linalg.eigvalsh(np.asarray(I_com, dtype=float))
    scale = max(float(np.abs(moments).max()), 1e-300)
    if moments[0] < -1e-12 * scale:
        problems.append(("the inertia is not positive semi-definite", float(-moments[0])))
    deficit = float(moments[2] - moments[0] - moments[1])
    if deficit > 1e-12 * scale:
        problems.append(("the principal moments violate the triangle inequality", deficit))
    if m == 0.0 and scale > 1e-300 and is_number(m) and moments[2] > 0.0:
        problems.append(("inertia without mass", float(moments[2])))
    return problems


def momentum(body: RigidInertia, w: Vector, v: Vector) -> tuple[Vector, Vector]:
    """Return angular momentum about the origin and linear momentum of a body moving with (w, v)."""
    return body.I @ w + cross(body.h, v), body.m * v - cross(body.h, w)

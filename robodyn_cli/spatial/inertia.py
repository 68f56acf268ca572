"""Inertia of rigid bodies and of articulated bodies."""

from __future__ import annotations

from typing import Any

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    Twist,
    Vector,
    Wrench,
    congruence,
    cross,
    dot,
    identity,
    skew,
    zeros,
)


@record
class RigidInertia:
    """Spatial inertia of a rigid body (Featherstone 2008, equation 2.63) in its ten numbers.

    m : mass [kg]. h : (3,) first moment m c [kg m], c the centre of mass. I : (3, 3) rotational inertia about the
    frame's origin [kg m^2].
    """

    m: Any
    h: Vector
    I: Matrix

    @staticmethod
    def zero() -> RigidInertia:
        """Return the inertia of a body without mass."""
        return RigidInertia(0.0, zeros(3), zeros(3, 3))

    @staticmethod
    def from_com(m: Any, c: Vector, I_com: Matrix) -> RigidInertia:
        """Return the inertia about the origin from mass, centre of mass c [m] and inertia about c."""
        h = m * c
        return RigidInertia(m, h, I_com + parallel_axis(h, c))

    def __add__(self, other: RigidInertia) -> RigidInertia:
        return RigidInertia(self.m + other.m, self.h + other.h, self.I + other.I)

    def __sub__(self, other: RigidInertia) -> RigidInertia:
        return RigidInertia(self.m - other.m, self.h - other.h, self.I - other.I)

    def __matmul__(self, m: Twist) -> Wrench:
        """Return I m: the momentum of the body for its velocity (I w + h x v, m v - h x w)."""
        return Wrench(self.I @ m.w + cross(self.h, m.v), self.m * m.v - cross(self.h, m.w))

    def to_parent(self, X: Transform) -> RigidInertia:
        """Return the inertia in the parent frame A, given in B (X from A to B): X^T I X (table 2.1)."""
        h = X.E.T @ self.h
        I = congruence(X.E, self.I)
        shift = _shift_matrix(X.r, h, self.m)
        return RigidInertia(self.m, h + self.m * X.r, I + shift)


def parallel_axis(h: Vector, c: Vector) -> Matrix:
    """Return -skew(h) skew(c) for parallel h and c: the part that the shift to the origin adds to I."""
    hc = [h[k] * c[k] for k in range(3)]
    out = zeros(3, 3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = hc[j] + hc[k]
        out[i, j] = out[j, i] = -(h[i] * c[j])
    return out


def _shift_matrix(r: Vector, h: Vector, m: Any) -> Matrix:
    """Return the part that moving the reference by r adds to I: 2 (r.h) E - r h^T - h r^T + m (r.r E - r r^T)."""
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
    """Articulated-body inertia, symmetric, in 3x3 blocks: n = A w + H v, f = H^T w + M v (Featherstone 2008, 7.1)."""

    A: Matrix
    H: Matrix
    M: Matrix

    @staticmethod
    def from_rigid(body: RigidInertia) -> ArticulatedInertia:
        """Return the inertia of a body that carries nothing."""
        return ArticulatedInertia(body.I, skew(body.h), body.m * identity())

    def __add__(self, other: ArticulatedInertia) -> ArticulatedInertia:
        return ArticulatedInertia(self.A + other.A, self.H + other.H, self.M + other.M)

    def __matmul__(self, m: Twist) -> Wrench:
        """Return I m, the force that gives the handle the acceleration m: (A w + H v, H^T w + M v)."""
        return Wrench(self.A @ m.w + self.H @ m.v, self.H.T @ m.w + self.M @ m.v)

    def downdate(self, U: Vector, V: Vector) -> ArticulatedInertia:
        """Return I - U V^T for parallel U and V (6,), which keeps I symmetric."""

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

"""Coriolis matrix by composite bodies."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.algorithms.kinematics import Velocity, slice_q, slice_v, transforms, velocities
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Transform, Values, Vector, cross, dot, skew, zeros
from robodyn_cli.spatial.inertia import RigidInertia, momentum


@record
class VelocityInertia:
    """What a moving body bears for a velocity s of its frame: n = Z s_w, f = -p x s_w.

    Sums over the body's points, position r from the frame's origin, velocity r-dot, both in frame axes:
    Z = -sum dm r~ r-dot~ (3, 3) [kg m^2/s], not symmetric; p = sum dm r-dot (3,) [kg m/s], the momentum.
    This is the 6x6 matrix B(I, v) of Echeandia and Wensing (2021) in the twelve numbers that are not zero;
    its symmetric part is half the rate of the spatial inertia seen from the base.
    """

    Z: Matrix
    p: Vector

    @staticmethod
    def of_body(body: RigidInertia, velocity: Velocity) -> VelocityInertia:
        """Return Z and p of a rigid body, from r-dot = v + w x r.

        Z = -h~ v~ - I w~ + (tr(I) w / 2 - I w)~;  p = m v + w x h.
        """
        w, v, I, h = velocity.w, velocity.v, body.I, body.h
        half_trace = 0.5 * (I[0, 0] + I[1, 1] + I[2, 2])
        Z = skew(half_trace * w - I @ w) - I @ skew(w)
        return VelocityInertia(_add_product(Z, h, v), body.m * v + cross(w, h))

    def __add__(self, other: VelocityInertia) -> VelocityInertia:
        return VelocityInertia(self.Z + other.Z, self.p + other.p)

    def to_parent(self, X: Transform) -> VelocityInertia:
        """Express in the parent frame A what is given in B (X from A to B): E^T Z E - r~ (E^T p)~, E^T p."""
        p = X.E.T @ self.p
        return VelocityInertia(_add_product(X.E.T @ self.Z @ X.E, X.r, p), p)

    def wrench(self, s: Vector) -> tuple[Vector, Vector]:
        """Return B s (moment, force) for a velocity s = (angular, linear)."""
        return self.Z @ s[:3], cross(s[:3], self.p)

    def transposed_couple(self, s: Vector) -> Vector:
        """Return the moment of B^T s, which has no force."""
        return self.Z.T @ s[:3] + cross(self.p, s[3:])


def _add_product(Z: Matrix, a: Vector, b: Vector) -> Matrix:
    """Return Z - a~ b~, that is Z + (a.b) E - b a^T."""
    out = zeros(3, 3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = Z[i, i] + (a[j] * b[j] + a[k] * b[k])
        out[i, j], out[i, k] = Z[i, j] - b[i] * a[j], Z[i, k] - b[i] * a[k]
    return out


def subspace_rate(body: Body, q: Vector, qd: Vector, S: Matrix, velocity: Velocity) -> Matrix:
    """Return the rate (6, nv) of a joint's motion subspace seen from the base, in body coordinates.

    v x S + S_rate, with the spatial cross product (Featherstone 2008, section 2.10).
    """
    out = body.joint.S_rate(q, qd).copy()
    for j in range(body.joint.nv):
        out[:3, j] = out[:3, j] + cross(velocity.w, S[:3, j])
        out[3:, j] = out[3:, j] + cross(velocity.w, S[3:, j]) + cross(velocity.v, S[:3, j])
    return out


def coriolis(model: Model, q: Values, qd: Values, X: Sequence[Transform] | None = None) -> Matrix:
    """Return the Coriolis matrix C (nv, nv); C qd are the velocity terms of the joint torques [N m or N].

    Over all material points with Jacobian J, C = sum dm J^T J-dot. So C + C^T = M-dot, which makes
    M-dot - 2 C skew-symmetric, and where qd is the rate of q the entries are C_ij = sum_k Gamma_ijk qd_k with
    Christoffel's symbols of the first kind. Rotors, constant on the diagonal of M, add nothing.

    Parameters
    ----------
    q, qd : (nq,), (nv,).
    X : transforms from parent to body, where they are known already.

    Source: Echeandia and Wensing (2021), "Numerical methods to compute the Coriolis matrix and Christoffel
    symbols for rigid-body systems", algorithm 1; O(N depth).
    """
    X = transforms(model, q) if X is None else X
    bodies = model.bodies
    velocity = velocities(model, X, q, qd)
    I = [b.inertia for b in bodies]
    B = [VelocityInertia.of_body(b.inertia, velocity[k]) for k, b in enumerate(bodies)]
    S = [b.joint.S(slice_q(b, q)) for b in bodies]
    S_dot = [subspace_rate(b, slice_q(b, q), slice_v(b, qd), S[k], velocity[k]) for k, b in enumerate(bodies)]
    C = zeros(model.nv, model.nv)
    for k in reversed(range(len(bodies))):
        body = bodies[k]
        for j in range(body.joint.nv):
            # of composite body k: I S-dot + B S, for C's column; I S and B^T S, for its row
            n, f = _add(momentum(I[k], S_dot[k][:3, j], S_dot[k][3:, j]), B[k].wrench(S[k][:, j]))
            n_row, f_row = momentum(I[k], S[k][:3, j], S[k][3:, j])
            couple = B[k].transposed_couple(S[k][:, j])
            i = k
            while i != BASE:
                for m in range(bodies[i].joint.nv):
                    s, s_dot = S[i][:, m], S_dot[i][:, m]
                    C[bodies[i].v + m, body.v + j] = dot(s[:3], n) + dot(s[3:], f)
                    if i != k:
                        C[body.v + j, bodies[i].v + m] = (
                            dot(s_dot[:3], n_row) + dot(s_dot[3:], f_row) + dot(s[:3], couple)
                        )
                n, f = X[i].force_to_parent(n, f)
                n_row, f_row = X[i].force_to_parent(n_row, f_row)
                couple = X[i].E.T @ couple
                i = bodies[i].parent
        if body.parent != BASE:
            I[body.parent] = I[body.parent] + I[k].to_parent(X[k])
            B[body.parent] = B[body.parent] + B[k].to_parent(X[k])
    return C


def _add(a: tuple[Vector, Vector], b: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
    return a[0] + b[0], a[1] + b[1]

"""Mass matrix and Coriolis matrix by composite bodies."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.algorithms.kinematics import slice_q, slice_v, transforms, velocities
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    Twist,
    Values,
    Vector,
    Wrench,
    columns,
    cross,
    skew,
    zeros,
)
from robodyn_cli.spatial.inertia import RigidInertia


def crba(model: Model, q: Values, X: Sequence[Transform] | None = None) -> Matrix:
    """Return the joint-space mass matrix M (nv, nv), rotors included.

    M_ji = S_j^T F with F = X_j^T ... X_i^T (Ic_i S_i) for each ancestor j of i; Ic_i is the inertia of the composite
    body i: body i and all bodies that it carries. Both halves of M hold the same expressions.

    Parameters
    ----------
    q : (nq,).
    X : transforms from parent to body, where they are known already.

    Source: Featherstone (2008), table 6.2; rotors as N^2 J on the joint's diagonal.
    """
    X = transforms(model, q) if X is None else X
    bodies = model.bodies
    S = [b.joint.S(slice_q(b, q)) for b in bodies]
    Ic = [b.inertia for b in bodies]
    for i in reversed(range(len(bodies))):
        parent = bodies[i].parent
        if parent != BASE:
            Ic[parent] = Ic[parent] + Ic[i].to_parent(X[i])
    M = zeros(model.nv, model.nv)
    for i, body in enumerate(bodies):
        F = [Ic[i] @ s for s in columns(S[i])]
        for k, f in enumerate(F):
            own = f.project(S[i][:, : k + 1])
            own[k] = own[k] + body.rotors[k]
            _place(M, body.v + k, body.v, own)
        j = i
        while bodies[j].parent != BASE:
            F = [f.to_parent(X[j]) for f in F]
            j = bodies[j].parent
            for k, f in enumerate(F):
                _place(M, body.v + k, bodies[j].v, f.project(S[j]))
    return M


def _place(M: Matrix, column: int, first: int, entries: Vector) -> None:
    """Put entries into a column of a symmetric matrix, from row ``first`` on, and into the row of its mirror image."""
    for row, x in enumerate(entries, start=first):
        M[row, column] = M[column, row] = x


@record
class VelocityInertia:
    """The 6x6 matrix B(I, v) of Echeandia and Wensing (2021) of a moving body: B s = (Z s_w, s_w x p).

    Z = -sum dm r~ r-dot~ (3, 3) [kg m^2/s], not symmetric; p = sum dm r-dot (3,) [kg m/s], the momentum: sums over the
    body's points with position r from the frame's origin and velocity r-dot, both in frame axes. Its symmetric part
    is half the rate of the spatial inertia seen from the base.
    """

    Z: Matrix
    p: Vector

    @staticmethod
    def of_body(body: RigidInertia, velocity: Twist) -> VelocityInertia:
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
        """Return the matrix in the parent frame A, given in B (X from A to B): E^T Z E - r~ (E^T p)~, E^T p."""
        p = X.E.T @ self.p
        return VelocityInertia(_add_product(X.E.T @ self.Z @ X.E, X.r, p), p)

    def __matmul__(self, s: Twist) -> Wrench:
        """Return B s."""
        return Wrench(self.Z @ s.w, cross(s.w, self.p))

    def transposed(self, s: Twist) -> Wrench:
        """Return B^T s, which is a pure moment."""
        return Wrench(self.Z.T @ s.w + cross(self.p, s.v), zeros(3))


def _add_product(Z: Matrix, a: Vector, b: Vector) -> Matrix:
    """Return Z - a~ b~, that is Z + (a.b) E - b a^T."""
    out = zeros(3, 3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = Z[i, i] + (a[j] * b[j] + a[k] * b[k])
        out[i, j], out[i, k] = Z[i, j] - b[i] * a[j], Z[i, k] - b[i] * a[k]
    return out


def subspace_rate(body: Body, q: Vector, qd: Vector, S: Sequence[Twist], velocity: Twist) -> list[Twist]:
    """Return the rates of a joint's motion subspace S seen from the base, in body coordinates, column by column.

    S_rate + v x S (Featherstone 2008, section 2.10).
    """
    own = columns(body.joint.S_rate(q, qd))
    return [rate + velocity.cross(s) for rate, s in zip(own, S)]


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
    symbols for rigid-body systems", algorithm 1, with its F1, F2 and F3; O(N depth).
    """
    X = transforms(model, q) if X is None else X
    bodies = model.bodies
    velocity = velocities(model, X, q, qd)
    I = [b.inertia for b in bodies]
    B = [VelocityInertia.of_body(b.inertia, velocity[k]) for k, b in enumerate(bodies)]
    S = [columns(b.joint.S(slice_q(b, q))) for b in bodies]
    S_dot = [subspace_rate(b, slice_q(b, q), slice_v(b, qd), S[k], velocity[k]) for k, b in enumerate(bodies)]
    C = zeros(model.nv, model.nv)
    for k in reversed(range(len(bodies))):
        body = bodies[k]
        for j, (s, s_dot) in enumerate(zip(S[k], S_dot[k]), start=body.v):
            F1, F2, F3 = I[k] @ s_dot + B[k] @ s, I[k] @ s, B[k].transposed(s)
            i = k
            while i != BASE:
                for m, (s_i, s_dot_i) in enumerate(zip(S[i], S_dot[i]), start=bodies[i].v):
                    C[m, j] = F1.dot(s_i)
                    if i != k:
                        C[j, m] = F2.dot(s_dot_i) + F3.dot(s_i)
                F1, F2, F3 = (F.to_parent(X[i]) for F in (F1, F2, F3))
                i = bodies[i].parent
        if body.parent != BASE:
            I[body.parent] = I[body.parent] + I[k].to_parent(X[k])
            B[body.parent] = B[body.parent] + B[k].to_parent(X[k])
    return C

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
    Ic = [b.inertia for b in bodies]
    carried = [Carried() for _ in bodies]
    M = zeros(model.nv, model.nv)
    for i in reversed(range(len(bodies))):
        body, S = bodies[i], bodies[i].joint.S(slice_q(bodies[i], q))
        at, (F,) = carried.pop().with_own(body, Ic[i] @ Twist.of(S))
        across = F.project(S)
        for k in reversed(range(body.joint.nv)):
            M[body.v + k, at] = M[at, body.v + k] = across[k]
            M[body.v + k, body.v + k] += body.rotors[k]
        if body.parent != BASE:
            Ic[body.parent] = Ic[body.parent] + Ic[i].to_parent(X[i])
            carried[body.parent].add(at, F.to_parent(X[i]))
    return M


class Carried:
    """Wrenches of one or several kinds that belong to the joints which a body carries, in its coordinates.

    at : their velocity coordinates. groups : the wrenches of each kind, in that order.
    """

    def __init__(self) -> None:
        self.at: list[int] = []
        self.groups: list[tuple[Wrench, ...]] = []

    def add(self, at: Sequence[int], *wrenches: Wrench) -> None:
        """Add a group of each kind."""
        self.at += at
        self.groups.append(wrenches)

    def with_own(self, body: Body, *wrenches: Wrench) -> tuple[list[int], list[Wrench]]:
        """Return the coordinates and wrenches of each kind, those of the body's own joint the last."""
        self.add(range(body.v, body.v + body.joint.nv), *wrenches)
        return self.at, [Wrench.beside(kind) for kind in zip(*self.groups)]


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
        return Wrench(self.Z.T @ s.w + cross(self.p, s.v), zeros(*s.w.shape))


def _add_product(Z: Matrix, a: Vector, b: Vector) -> Matrix:
    """Return Z - a~ b~, that is Z + (a.b) E - b a^T."""
    out = zeros(3, 3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = Z[i, i] + (a[j] * b[j] + a[k] * b[k])
        out[i, j], out[i, k] = Z[i, j] - b[i] * a[j], Z[i, k] - b[i] * a[k]
    return out


def subspace_rate(body: Body, q: Vector, qd: Vector, S: Matrix, velocity: Twist) -> Twist:
    """Return the rate of a joint's motion subspace S (6, nv) seen from the base, in body coordinates, by columns.

    S_rate + v x S (Featherstone 2008, section 2.10).
    """
    return Twist.of(body.joint.S_rate(q, qd)) + velocity.cross(Twist.of(S))


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
    carried = [Carried() for _ in bodies]
    C = zeros(model.nv, model.nv)
    for i in reversed(range(len(bodies))):
        body = bodies[i]
        S = body.joint.S(slice_q(body, q))
        s, s_dot = Twist.of(S), subspace_rate(body, slice_q(body, q), slice_v(body, qd), S, velocity[i])
        own = I[i] @ s_dot + B[i] @ s, I[i] @ s, B[i].transposed(s)
        at, (F1, F2, F3) = carried.pop().with_own(body, *own)
        rows, others = slice(body.v, body.v + body.joint.nv), len(at) - body.joint.nv
        C[rows, at] = F1.project(S)
        C[at[:others], rows] = (F2.project(s_dot.components) + F3.project(S)).T[:others]
        if body.parent != BASE:
            I[body.parent] = I[body.parent] + I[i].to_parent(X[i])
            B[body.parent] = B[body.parent] + B[i].to_parent(X[i])
            carried[body.parent].add(at, *(F.to_parent(X[i]) for F in (F1, F2, F3)))
    return C

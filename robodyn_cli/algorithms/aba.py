"""Forward dynamics by the articulated-body algorithm, O(N).

The names are those of Featherstone (2008), table 7.1: S motion subspace, IA and pA articulated-body inertia and bias
force, U, D and u (equations 7.43 to 7.45), Ia and pa the inertia and bias force passed to the parent, a' acceleration
without the joint's own part.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.algorithms.kinematics import slice_q, slice_v, transforms
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Transform, Twist, Values, Vector, Wrench, columns, zeros
from robodyn_cli.spatial.inertia import ArticulatedInertia


@record
class JointFactor:
    """One joint's part of the factorisation of M.

    S : (6, nv) motion subspace. U : (6, nv), IA S. D_inverse : (nv, nv), D = S^T U + armature. U_D : U D^-1.
    """

    S: Matrix
    U: Matrix
    U_D: Matrix
    D_inverse: Matrix

    def inward(self, tau: Vector, pA: Wrench) -> tuple[Vector, Wrench]:
        """Return D^-1 u (nv,) and the bias force pa passed to the parent.

        u = tau - S^T pA;  pa = pA + U D^-1 u, without velocity terms (c = 0).
        """
        D_u = self.D_inverse @ (tau - pA.project(self.S))
        return D_u, pA + Wrench.along(self.U, D_u)

    def outward(self, X: Transform, D_u: Vector, a_parent: Twist) -> tuple[Vector, Twist]:
        """Return the joint's acceleration (nv,) and the body's.

        a' = X a_parent;  qdd = D^-1 (u - U^T a');  a = a' + S qdd.
        """
        a = a_parent.to_child(X)
        qdd = D_u - self.U_D.T @ a.components
        return qdd, a + Twist.along(self.S, qdd)


def factor_joint(body: Body, q: Vector, IA: ArticulatedInertia) -> tuple[JointFactor, ArticulatedInertia]:
    """Return a joint's factor and the inertia passed to the parent, Ia = IA - U D^-1 U^T.

    Source: Featherstone (2008), table 7.1; the rotor's inertia is added to the diagonal of D.
    """
    S = body.joint.S(q)
    U = np.stack([(IA @ s).components for s in columns(S)], axis=1)
    D = S.T @ U
    for j in range(body.joint.nv):
        D[j, j] = D[j, j] + body.rotors[j]
    D_inverse = invert_symmetric(D)
    U_D = U @ D_inverse
    Ia = IA
    for j in range(body.joint.nv):
        Ia = Ia.downdate(U[:, j], U_D[:, j])
    if not any(is_nonzero(rotor) for rotor in body.rotors):
        Ia = _without_free_axes(Ia, S)
    return JointFactor(S, U, U_D, D_inverse), Ia


def _without_free_axes(Ia: ArticulatedInertia, S: Matrix) -> ArticulatedInertia:
    """Return Ia with exact zeros in the rows and columns where Ia S = 0 (without a rotor) leaves only rounding. They
    are known for a joint that moves along or about coordinate axes, and zeros save operations down the tree.
    """
    A, H, M = Ia.A.copy(), Ia.H.copy(), Ia.M.copy()
    for j in range(S.shape[1]):
        moved = [i for i in range(6) if is_nonzero(S[i, j])]
        if len(moved) != 1:
            continue
        i = moved[0]
        if i < 3:
            A[i, :] = A[:, i] = H[i, :] = 0.0
        else:
            M[i - 3, :] = M[:, i - 3] = H[:, i - 3] = 0.0
    return ArticulatedInertia(A, H, M)


def invert_symmetric(D: Matrix) -> Matrix:
    """Return the inverse of a small symmetric positive definite matrix, by LDL^T beyond 1x1."""
    n = D.shape[0]
    if n == 1:
        out = zeros(1, 1)
        out[0, 0] = 1.0 / D[0, 0]
        return out
    factor = LdlFactor.of(D)
    solved = []
    for k in range(n):
        unit = [1.0 if i == k else 0.0 for i in range(n)]
        solved.append(factor.solve(unit))
    return np.stack(solved, axis=1)


class ArticulatedFactor:
    """M(q) factored along the tree; solves M x = y for any number of right-hand sides in O(N) each."""

    def __init__(self, model: Model, q: Values, X: Sequence[Transform] | None = None) -> None:
        self.model = model
        self.X = transforms(model, q) if X is None else X
        IA = [ArticulatedInertia.from_rigid(b.inertia) for b in model.bodies]
        self.joints: list[JointFactor] = [None] * len(model.bodies)  # type: ignore[list-item]
        for k in reversed(range(len(model.bodies))):
            body = model.bodies[k]
            self.joints[k], Ia = factor_joint(body, slice_q(body, q), IA[k])
            if body.parent != BASE:
                IA[body.parent] = IA[body.parent] + Ia.to_parent(self.X[k])

    def solve(self, y: Values) -> Vector:
        """Return x with M x = y (nv,): accelerations for torques without velocity and gravity terms."""
        bodies = self.model.bodies
        pA = [Wrench.zero() for _ in bodies]
        D_u: list[Vector] = [zeros(0)] * len(bodies)
        for k in reversed(range(len(bodies))):
            body = bodies[k]
            D_u[k], pa = self.joints[k].inward(slice_v(body, y), pA[k])
            if body.parent != BASE:
                pA[body.parent] = pA[body.parent] + pa.to_parent(self.X[k])
        x = zeros(self.model.nv)
        a = {BASE: Twist.zero()}
        for k, body in enumerate(bodies):
            qdd, a[k] = self.joints[k].outward(self.X[k], D_u[k], a[body.parent])
            x[body.v : body.v + body.joint.nv] = qdd
        return x


def aba(model: Model, q: Values, qd: Values, tau: Values, gravity: Vector | None = None) -> Vector:
    """Return the joint accelerations for given torques: M^-1 (tau - h).

    The velocity and gravity terms h come from one Newton-Euler pass with qdd = 0. The articulated-body recursion then
    runs on tau - h, so that its own velocity terms c and p vanish (Featherstone 2008, section 7.3).

    Parameters
    ----------
    q, qd, tau : (nq,), (nv,), (nv,); tau [N m or N] with joint springs, dampers and friction already added.
    gravity : (3,) base coordinates [m/s^2]; None for none.

    Returns
    -------
    qdd : (nv,) [rad/s^2 or m/s^2].

    Raises
    ------
    ZeroDivisionError : on plain numbers, where a joint moves no inertia.
    """
    X = transforms(model, q)
    h = rnea(model, q, qd, [0.0] * model.nv, gravity, X)
    return ArticulatedFactor(model, q, X).solve([t - b for t, b in zip(tau, h)])

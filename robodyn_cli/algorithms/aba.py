"""Forward dynamics by the articulated-body algorithm, O(N)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import slice_q, slice_v, transforms
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.algorithms.rnea import Wrench, rnea
from robodyn_cli.expr.graph import is_number
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Transform, Values, Vector, cross, dot, zeros
from robodyn_cli.spatial.inertia import ArticulatedInertia

Acceleration = tuple[Vector, Vector]  # angular, and of the body's origin; body coordinates


@record
class JointFactor:
    """What a joint contributes to the factorisation of M: U = I^A S, D^-1 = (S^T U + armature)^-1."""

    S: Any
    U: Any
    U_D: Any
    D_inverse: Matrix

    def bear(self, y: Vector, wrench: Wrench) -> tuple[Vector, Wrench]:
        """Return the acceleration that the joint alone would take, and the wrench that its parent feels.

        share = D^-1 (y - S^T f);  f^a = f + U share   (Featherstone 2008, equations 7.24 and 7.44).
        """
        n, f = wrench
        u = zeros(len(y))
        for j in range(len(y)):
            u[j] = y[j] - (dot(self.S[:3, j], n) + dot(self.S[3:, j], f))
        share = self.D_inverse @ u
        reaction = self.U @ share
        return share, (n + reaction[:3], f + reaction[3:])

    def follow(self, X: Transform, share: Vector, parent: Acceleration) -> tuple[Vector, Acceleration]:
        """Return the joint's acceleration and the body's: share - U_D^T X a_p;  X a_p + S qdd."""
        w_p, a_p = parent
        w, a = X.E @ w_p, X.E @ (a_p + cross(w_p, X.r))
        own = share - self.U_D.T @ np.concatenate([w, a])
        return own, (w + self.S[:3] @ own, a + self.S[3:] @ own)


def factor_joint(
    body: Body, q: Vector, inertia: ArticulatedInertia
) -> tuple[JointFactor, ArticulatedInertia]:
    """Return a joint's factor and the inertia felt through it, I^a = I^A - U D^-1 U^T.

    Source: Featherstone (2008), equations 7.14 and 7.43 to 7.45.
    """
    nv = body.joint.nv
    S = body.joint.S(q)
    columns = [inertia.column(S[:, j]) for j in range(nv)]
    U = np.stack(columns, axis=1)
    D = S.T @ U
    for j in range(nv):
        D[j, j] = D[j, j] + body.armature
    D_inverse = invert_symmetric(D)
    U_D = U @ D_inverse
    felt = inertia
    for j in range(nv):
        felt = felt.downdate(U[:, j], U_D[:, j])
    if is_number(body.armature) and body.armature == 0.0:
        felt = _released(felt, S)
    return JointFactor(S, U, U_D, D_inverse), felt


def _released(felt: ArticulatedInertia, S: Any) -> ArticulatedInertia:
    """Return I^a with the rows and columns zero that are zero but for rounding: I^a S = 0 without a rotor.

    They are known where a joint moves along or about coordinate axes, and spare arithmetic down the tree.
    """
    A, H, M = felt.A.copy(), felt.H.copy(), felt.M.copy()
    for j in range(S.shape[1]):
        moved = [i for i in range(6) if not is_number(S[i, j]) or S[i, j] != 0.0]
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
    columns = []
    for k in range(n):
        unit = [1.0 if i == k else 0.0 for i in range(n)]
        columns.append(factor.solve(unit))
    return np.stack(columns, axis=1)


class ArticulatedFactor:
    """M(q) factored along the tree; solves M x = y for any number of right-hand sides in O(N) each."""

    def __init__(self, model: Model, q: Values, X: Sequence[Transform] | None = None) -> None:
        self.model = model
        self.X = transforms(model, q) if X is None else X
        inertia = [ArticulatedInertia.from_rigid(b.inertia) for b in model.bodies]
        self.joints: list[JointFactor] = [None] * len(model.bodies)  # type: ignore[list-item]
        for k in reversed(range(len(model.bodies))):
            body = model.bodies[k]
            self.joints[k], felt = factor_joint(body, slice_q(body, q), inertia[k])
            if body.parent != BASE:
                inertia[body.parent] = inertia[body.parent] + felt.to_parent(self.X[k])

    def solve(self, y: Values) -> Vector:
        """Return x with M x = y (nv,): torques collect down the tree, accelerations spread up it."""
        bodies = self.model.bodies
        pull: list[Wrench] = [(zeros(3), zeros(3)) for _ in bodies]
        share: list[Vector] = [zeros(0)] * len(bodies)
        for k in reversed(range(len(bodies))):
            body = bodies[k]
            share[k], felt = self.joints[k].bear(slice_v(body, y), pull[k])
            if body.parent != BASE:
                n, f = self.X[k].force_to_parent(*felt)
                n_p, f_p = pull[body.parent]
                pull[body.parent] = (n_p + n, f_p + f)
        x = zeros(self.model.nv)
        motion: dict[int, Acceleration] = {BASE: (zeros(3), zeros(3))}
        for k, body in enumerate(bodies):
            own, motion[k] = self.joints[k].follow(self.X[k], share[k], motion[body.parent])
            for j in range(body.joint.nv):
                x[body.v + j] = own[j]
        return x


def aba(model: Model, q: Values, qd: Values, tau: Values, gravity: Vector | None = None) -> Vector:
    """Return the joint accelerations for given torques: M^-1 (tau - h).

    The velocity and gravity terms come from one Newton-Euler pass with qdd = 0; the articulated-body
    recursion then runs on what is left, so its own velocity terms vanish (Featherstone 2008, section 7.3).

    Parameters
    ----------
    q, qd, tau : (nq,), (nv,), (nv,); tau with joint springs, dampers and friction already added.

    Raises
    ------
    ZeroDivisionError : on plain numbers, where a joint moves nothing that has inertia.
    """
    X = transforms(model, q)
    h = rnea(model, q, qd, [0.0] * model.nv, gravity, X)
    return ArticulatedFactor(model, q, X).solve([t - b for t, b in zip(tau, h)])

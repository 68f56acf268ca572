"""Mass matrix by the composite-rigid-body algorithm."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.algorithms.kinematics import slice_q, transforms
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.spatial.algebra import Matrix, Transform, Values, Vector, columns, zeros


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

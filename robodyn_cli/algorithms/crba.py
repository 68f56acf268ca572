"""Mass matrix by the composite-rigid-body algorithm."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.algorithms.kinematics import slice_q, transforms
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.spatial.algebra import Matrix, Transform, Values, cross, dot, zeros
from robodyn_cli.spatial.inertia import RigidInertia


def crba(model: Model, q: Values, X: Sequence[Transform] | None = None) -> Matrix:
    """Return the joint-space mass matrix M (nv, nv), rotors included.

    Source: Featherstone (2008), table 6.2. Symmetric: both halves hold the same expressions.
    """
    X = transforms(model, q) if X is None else X
    composite: list[RigidInertia] = [b.inertia for b in model.bodies]
    M = zeros(model.nv, model.nv)
    for k in reversed(range(len(model.bodies))):
        body = model.bodies[k]
        if body.parent != BASE:
            composite[body.parent] = composite[body.parent] + composite[k].to_parent(X[k])
    for k, body in enumerate(model.bodies):
        S = body.joint.S(slice_q(body, q))
        I = composite[k]
        for j in range(body.joint.nv):
            w, v = S[:3, j], S[3:, j]
            n = I.I @ w + cross(I.h, v)
            f = I.m * v - cross(I.h, w)
            for i in range(j + 1):
                entry = dot(S[:3, i], n) + dot(S[3:, i], f)
                if i == j:
                    entry = entry + body.armature
                M[body.v + i, body.v + j] = M[body.v + j, body.v + i] = entry
            child, ancestor = k, body.parent
            while ancestor != BASE:
                n, f = X[child].force_to_parent(n, f)
                above = model.bodies[ancestor]
                S_a = above.joint.S(slice_q(above, q))
                for i in range(above.joint.nv):
                    entry = dot(S_a[:3, i], n) + dot(S_a[3:, i], f)
                    M[above.v + i, body.v + j] = M[body.v + j, above.v + i] = entry
                child, ancestor = ancestor, above.parent
    return M

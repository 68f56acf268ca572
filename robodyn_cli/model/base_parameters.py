"""Base inertial parameters: a tree with fewer numbers and the same equations of motion.

Part of a body's inertia moves as if it were fixed to the parent. Moved to the parent, from the leaves to the base, it
changes no joint torque; the part that reaches the base is dropped. A body on a hinge keeps 7 of its 10 numbers, one on
a slide 4 (Gautier and Khalil 1990, "Direct calculation of minimum set of inertial parameters of serial robots").
"""

from __future__ import annotations

import dataclasses

from robodyn_cli.expr.graph import is_number
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.spatial.algebra import Transform, congruence, zeros
from robodyn_cli.spatial.double_double import DoubleDouble, extended, orthonormal, rounded
from robodyn_cli.spatial.inertia import RigidInertia


def with_base_parameters(model: Model) -> Model:
    """Return a model with the same M, C and G and as few inertial parameters as its joints allow.

    They are sums and differences of numbers of any size, so they are computed with 32 digits from the parts of the
    bodies, and rounded at the end. A body with symbols in its inertia or place keeps what it has.

    Limits: loads in the joints, and momenta and energies of single bodies, are not those of the mechanism. Inertias of
    bodies may be negative; M stays positive definite.
    """
    known = [_is_known(body) for body in model.bodies]
    inertia = [_extended(body) if sure else body.inertia for body, sure in zip(model.bodies, known)]
    for k in reversed(range(len(model.bodies))):
        body = model.bodies[k]
        moved = body.joint.parent_inertia(inertia[k]) if known[k] else None
        if moved is None:
            continue
        inertia[k] = inertia[k] - moved
        if body.parent != BASE:
            there = moved.to_parent(Transform(orthonormal(body.X_tree.E), body.X_tree.r))
            inertia[body.parent] = inertia[body.parent] + (there if known[body.parent] else _rounded(there))
    bodies = tuple(
        dataclasses.replace(body, inertia=_rounded(I) if sure else I, parts=())
        for body, I, sure in zip(model.bodies, inertia, known)
    )
    return dataclasses.replace(model, bodies=bodies)


def _extended(body: Body) -> RigidInertia:
    """Return the inertia of a body as sums of two doubles, from its parts where these are known."""
    if not body.parts:
        I = body.inertia
        return RigidInertia(DoubleDouble(I.m), extended(I.h), extended(I.I))
    total = RigidInertia(DoubleDouble(0.0), extended(zeros(3)), extended(zeros(3, 3)))
    for part in body.parts:
        X = Transform(orthonormal(part.frame.E), extended(part.frame.r))
        total = total + RigidInertia.from_com(
            DoubleDouble(part.m), X.point(part.c), congruence(X.E, extended(part.I_com))
        )
    return total


def _rounded(I: RigidInertia) -> RigidInertia:
    return RigidInertia(float(I.m), rounded(I.h), rounded(I.I))


def _is_known(body: Body) -> bool:
    X, inertia = body.X_tree, body.inertia
    numbers = [inertia.m, *inertia.h, *inertia.I.ravel(), *X.E.ravel(), *X.r]
    return all(is_number(x) for x in numbers)

"""Base inertial parameters: a tree with fewer numbers and the same equations of motion.

Part of a body's inertia moves as if it were fixed to the parent. Moved to the parent, from the leaves to the base, it
changes no joint torque; the part that reaches the base is dropped. A body on a hinge keeps 7 of its 10 numbers, one on
a slide 4 (Gautier and Khalil 1990, "Direct calculation of minimum set of inertial parameters of serial robots").
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

from robodyn_cli.expr.fixed import derived
from robodyn_cli.expr.graph import is_number
from robodyn_cli.model.model import BASE, Body, Model, RigidPart
from robodyn_cli.spatial.algebra import Transform, congruence, vector, zeros
from robodyn_cli.spatial.double_double import DoubleDouble, extended, orthonormal
from robodyn_cli.spatial.inertia import RigidInertia


def with_base_parameters(model: Model) -> Model:
    """Return a model with the same M, C and G and as few inertial parameters as its joints allow.

    They are sums and differences of numbers of any size, so they are computed with 32 digits from the parts of the
    bodies, and rounded at the end. A body with symbols in its inertia or place keeps what it has.

    Limits: loads in the joints, and momenta and energies of single bodies, are not those of the mechanism. Inertias of
    bodies may be negative; M stays positive definite.
    """
    known = [_is_known(body) for body in model.bodies]
    parents = [body.parent for body in model.bodies]

    def function(values: Sequence[float]) -> list[float]:
        rest = iter(values)
        inertias = _lumped(
            [_copy(b, rest) if sure else None for b, sure in zip(model.bodies, known)], parents
        )
        return [float(x) for I in inertias for x in (I.m, *I.h, *I.I.flat)]

    inputs = [x for body, sure in zip(model.bodies, known) if sure for x in _numbers(body)]
    results = iter(derived(function, inputs))
    bodies = []
    for body, sure in zip(model.bodies, known):
        m, h, I = next(results), vector(islice(results, 3)), vector(islice(results, 9)).reshape(3, 3)
        if sure or m or any(h) or any(I.flat):
            lumped = RigidInertia(m, h, I)
            body = dataclasses.replace(body, inertia=lumped if sure else body.inertia + lumped, parts=())
        bodies.append(body)
    return dataclasses.replace(model, bodies=tuple(bodies))


def _lumped(bodies: Sequence[Body | None], parents: Sequence[int]) -> list[RigidInertia]:
    """Return the inertia of each body, and for one that is not known what others add to it, with 32 digits."""
    inertia = [_zero() if body is None else _extended(body) for body in bodies]
    for k, body in reversed(list(enumerate(bodies))):
        moved = None if body is None else body.joint.parent_inertia(inertia[k])
        if body is None or moved is None:
            continue
        inertia[k] = inertia[k] - moved
        if parents[k] != BASE:
            there = moved.to_parent(Transform(orthonormal(body.X_tree.E), body.X_tree.r))
            inertia[parents[k]] = inertia[parents[k]] + there
    return inertia


def _zero() -> RigidInertia:
    return RigidInertia(DoubleDouble(0.0), extended(zeros(3)), extended(zeros(3, 3)))


def _extended(body: Body) -> RigidInertia:
    """Return the inertia of a body as sums of two doubles, from its parts where these are known."""
    if not body.parts:
        I = body.inertia
        return RigidInertia(DoubleDouble(I.m), extended(I.h), extended(I.I))
    total = _zero()
    for part in body.parts:
        X = Transform(orthonormal(part.frame.E), extended(part.frame.r))
        total = total + RigidInertia.from_com(
            DoubleDouble(part.m), X.point(part.c), congruence(X.E, extended(part.I_com))
        )
    return total


def _numbers(body: Body) -> list[Any]:
    """Return the numbers of a body in the order in which ``_copy`` takes them."""
    X, I = body.X_tree, body.inertia
    entries = [*X.E.flat, *X.r, I.m, *I.h, *I.I.flat]
    for part in body.parts:
        entries += part.numbers
    return entries


def _copy(body: Body, numbers: Iterator[float]) -> Body:
    """Return a body with other numbers."""

    def take(*shape: int) -> Any:
        return vector(islice(numbers, math.prod(shape))).reshape(shape)

    X_tree = Transform(take(3, 3), take(3))
    inertia = RigidInertia(next(numbers), take(3), take(3, 3))
    parts = tuple(
        RigidPart(next(numbers), take(3), take(3, 3), Transform(take(3, 3), take(3))) for _ in body.parts
    )
    return dataclasses.replace(body, X_tree=X_tree, inertia=inertia, parts=parts)


def _is_known(body: Body) -> bool:
    return all(is_number(x) for x in _numbers(body))

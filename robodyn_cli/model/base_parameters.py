"""Base inertial parameters: a tree with fewer numbers and the same equations of motion.

Part of a body's inertia moves as if it were fixed to the parent. Moved to the parent, from the leaves to the base, it
changes no joint torque; the part that reaches the base is dropped. A body on a hinge keeps 7 of its 10 numbers, one on
a slide 4 (Gautier and Khalil 1990, "Direct calculation of minimum set of inertial parameters of serial robots").
"""

from __future__ import annotations

import dataclasses

from robodyn_cli.expr.graph import is_number
from robodyn_cli.model.model import BASE, Body, Model


def with_base_parameters(model: Model) -> Model:
    """Return a model with the same M, C and G and as few inertial parameters as its joints allow.

    A model with symbols among its inertias or places is returned as it is: expressions that depend on them are traced
    to single bodies.

    Limits: loads in the joints, and momenta and energies of single bodies, are not those of the mechanism. Inertias of
    bodies may be negative; M stays positive definite.
    """
    if not all(_is_known(body) for body in model.bodies):
        return model
    inertia = [body.inertia for body in model.bodies]
    for k in reversed(range(len(model.bodies))):
        body = model.bodies[k]
        moved = body.joint.parent_inertia(inertia[k])
        if moved is None:
            continue
        inertia[k] = inertia[k] - moved
        if body.parent != BASE:
            inertia[body.parent] = inertia[body.parent] + moved.to_parent(body.X_tree)
    bodies = tuple(dataclasses.replace(b, inertia=I) for b, I in zip(model.bodies, inertia))
    return dataclasses.replace(model, bodies=bodies)


def _is_known(body: Body) -> bool:
    X, inertia = body.X_tree, body.inertia
    numbers = [inertia.m, *inertia.h, *inertia.I.ravel(), *X.E.ravel(), *X.r]
    return all(is_number(x) for x in numbers)

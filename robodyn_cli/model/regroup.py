"""A tree with fewer inertial parameters and the same equations of motion.

Part of a body's inertia moves as if it were fixed to the parent: it looks alike at every position of the joint, and
the joint's own motion does not move it. Moving it there, from the leaves down, changes no joint torque; what reaches
the base is gone. A body on a hinge keeps 7 of its 10 numbers, one on a slide 4: the base parameters of Gautier and
Khalil (1990), found here from each joint's own ``unfelt`` part.
"""

from __future__ import annotations

import dataclasses

from robodyn_cli.expr.graph import is_number
from robodyn_cli.model.model import BASE, Body, Model


def regrouped(model: Model) -> Model:
    """Return a model with the same M, C and G and as few inertial parameters as its joints allow.

    Limits: loads inside joints and single bodies' momenta and energies are not those of the mechanism. Inertias of
    bodies may be negative, M is not. A model with symbols among its inertias or places is returned as it is, since
    what needs them is asked of the bodies one by one.
    """
    if not all(_is_known(body) for body in model.bodies):
        return model
    inertia = [body.inertia for body in model.bodies]
    for k in reversed(range(len(model.bodies))):
        body = model.bodies[k]
        unfelt = body.joint.unfelt(inertia[k])
        if unfelt is None:
            continue
        inertia[k] = inertia[k] - unfelt
        if body.parent != BASE:
            inertia[body.parent] = inertia[body.parent] + unfelt.to_parent(body.X_tree)
    bodies = tuple(dataclasses.replace(b, inertia=I) for b, I in zip(model.bodies, inertia))
    return dataclasses.replace(model, bodies=bodies)


def _is_known(body: Body) -> bool:
    X, inertia = body.X_tree, body.inertia
    numbers = [inertia.m, *inertia.h, *inertia.I.ravel(), *X.E.ravel(), *X.r]
    return all(is_number(x) for x in numbers)

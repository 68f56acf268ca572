"""Kinetic and potential energy of the mechanism."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.algorithms.kinematics import slice_q, slice_v, step_velocity, transforms
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.spatial.algebra import Transform, Twist, Values, Vector, cross, dot
from robodyn_cli.spatial.inertia import RigidInertia


def body_kinetic_energy(inertia: RigidInertia, velocity: Twist) -> Any:
    """Return the kinetic energy of a body [J], w.(I w / 2 + h x v) + m v.v / 2, in body coordinates."""
    w, v = velocity.w, velocity.v
    return dot(w, (0.5 * inertia.I) @ w + cross(inertia.h, v)) + 0.5 * inertia.m * dot(v, v)


def rotor_kinetic_energy(body: Body, qd: Vector) -> Any:
    """Return N^2 J qd^2 / 2 [J] of a joint's rotor; its gyroscopic effect is neglected."""
    return sum(((0.5 * J) * (rate * rate) for J, rate in zip(body.rotors, qd)), 0.0)


def kinetic_energy(model: Model, q: Values, qd: Values, X: Sequence[Transform] | None = None) -> Any:
    """Return the kinetic energy of bodies and rotors, qd^T M qd / 2 [J], in O(N).

    Parameters
    ----------
    q, qd : (nq,), (nv,).
    X : transforms from parent to body, where they are known already.
    """
    X = transforms(model, q) if X is None else X
    velocity = {BASE: Twist.zero()}
    total: Any = 0.0
    for k, body in enumerate(model.bodies):
        rate = slice_v(body, qd)
        velocity[k] = step_velocity(body, X[k], slice_q(body, q), rate, velocity[body.parent])
        total = total + body_kinetic_energy(body.inertia, velocity[k]) + rotor_kinetic_energy(body, rate)
    return total


def gravity_energy(
    model: Model, q: Values, gravity: Vector | None, X: Sequence[Transform] | None = None
) -> Any:
    """Return the potential energy of gravity, -sum m g.c [J], zero with all mass at the base's origin.

    The first moments of the composite bodies are carried down to the base: h_p = h_p + E^T h + m r.

    Parameters
    ----------
    q : (nq,).
    gravity : (3,) base coordinates [m/s^2]; None for none.
    X : transforms from parent to body, where they are known already.
    """
    if gravity is None:
        return 0.0
    X = transforms(model, q) if X is None else X
    mass: list[Any] = [b.inertia.m for b in model.bodies]
    moment: list[Vector] = [b.inertia.h for b in model.bodies]
    total: Any = 0.0
    for k in reversed(range(len(model.bodies))):
        parent = model.bodies[k].parent
        h = X[k].E.T @ moment[k] + mass[k] * X[k].r
        if parent == BASE:
            total = total - dot(gravity, h)
        else:
            mass[parent], moment[parent] = mass[parent] + mass[k], moment[parent] + h
    return total


def spring_energy(model: Model, q: Values) -> Any:
    """Return the potential energy of the elements in the joints (springs) [J]; ``q`` (nq,)."""
    total: Any = 0.0
    for body in model.bodies:
        for force in body.forces:
            total = total + force.element.potential(q[force.q])
    return total

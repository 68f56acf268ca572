"""Inverse dynamics by the recursive Newton-Euler algorithm, O(N)."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.algorithms.kinematics import Motion, slice_q, slice_v, step_motion, transforms
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.spatial.algebra import Transform, Values, Vector, cross, dot, zeros

Wrench = tuple[Vector, Vector]


def inertial_wrench(body: Body, motion: Motion) -> Wrench:
    """Return the wrench (moment about the body's origin, force) that the motion needs.

    f = m a + (wd~ + w~ w~) h;  n = I wd + w x I w + h x a   (Newton and Euler about the origin).
    """
    inertia = body.inertia
    f = inertia.m * motion.a + motion.rate_matrix() @ inertia.h
    n = inertia.I @ motion.wd + cross(motion.w, inertia.I @ motion.w) + cross(inertia.h, motion.a)
    return n, f


def joint_torque(body: Body, q: Vector, wrench: Wrench) -> Vector:
    """Return S^T f, the part of a wrench that the joint's actuator bears (nv,)."""
    S = body.joint.S(q)
    n, f = wrench
    out = zeros(body.joint.nv)
    for j in range(body.joint.nv):
        out[j] = dot(S[:3, j], n) + dot(S[3:, j], f)
    return out


def drive_torque(body: Body, q: Vector, qdd: Vector, wrench: Wrench) -> Vector:
    """Return what the joint's actuator must give (nv,): its part of the wrench and its rotor's inertia."""
    own = joint_torque(body, q, wrench)
    for j in range(body.joint.nv):
        own[j] = own[j] + body.armature * qdd[j]
    return own


def rnea(
    model: Model,
    q: Values,
    qd: Values,
    qdd: Values,
    gravity: Vector | None = None,
    X: Sequence[Transform] | None = None,
) -> Vector:
    """Return the joint torques of the rigid bodies and rotors: M qdd + C qd + G.

    Parameters
    ----------
    q, qd, qdd : (nq,), (nv,), (nv,).
    gravity : (3,) base coordinates [m/s^2]; None for none.

    Returns
    -------
    tau : (nv,) [N m or N]; gravity's pull included, joint springs, dampers and friction not.

    Source: Luh, Walker and Paul 1980; rotors as N^2 J on the joint's diagonal, without gyroscopic effect.
    """
    X = transforms(model, q) if X is None else X
    motion = {BASE: Motion.at_rest(gravity)}
    wrench: list[Wrench] = []
    for k, body in enumerate(model.bodies):
        motion[k] = step_motion(
            body, X[k], slice_q(body, q), slice_v(body, qd), slice_v(body, qdd), motion[body.parent]
        )
        wrench.append(inertial_wrench(body, motion[k]))
    return collect_torques(model, q, qdd, X, wrench)


def collect_torques(
    model: Model, q: Values, qdd: Values, X: Sequence[Transform], wrench: list[Wrench]
) -> Vector:
    """Carry the bodies' wrenches down to the base and return the joint torques (nv,)."""
    carried, _ = carry_down(model, X, wrench)
    tau = zeros(model.nv)
    for body, through in zip(model.bodies, carried):
        own = drive_torque(body, slice_q(body, q), slice_v(body, qdd), through)
        for j in range(body.joint.nv):
            tau[body.v + j] = own[j]
    return tau


def carry_down(
    model: Model, X: Sequence[Transform], wrench: Sequence[Wrench], base: Wrench | None = None
) -> tuple[list[Wrench], Wrench]:
    """Return the wrench that goes through each joint, and the one that goes through the base.

    f_k = own_k + sum of X^T f over the bodies that k carries (Featherstone 2008, equation 5.20).

    Parameters
    ----------
    wrench : what each body needs itself, about its origin in its coordinates. base : the same of the base.

    Returns
    -------
    For each body what its parent exerts on it through the joint, about the body's origin in body coordinates;
    what the ground exerts, about the base's origin in base coordinates.
    """
    carried = list(wrench)
    base = (zeros(3), zeros(3)) if base is None else base
    for k in reversed(range(len(model.bodies))):
        parent = model.bodies[k].parent
        n, f = X[k].force_to_parent(*carried[k])
        n_p, f_p = base if parent == BASE else carried[parent]
        if parent == BASE:
            base = (n_p + n, f_p + f)
        else:
            carried[parent] = (n_p + n, f_p + f)
    return carried, base

"""Inverse dynamics by the recursive Newton-Euler algorithm, O(N)."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.algorithms.kinematics import BodyMotion, slice_q, slice_v, step_motion, transforms
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.spatial.algebra import Transform, Values, Vector, Wrench, cross, vector, zeros


def inertial_wrench(body: Body, motion: BodyMotion) -> Wrench:
    """Return the wrench about the body's origin that the motion needs, in body coordinates.

    f = m a + (wd~ + w~ w~) h;  n = I wd + w x I w + h x a   (Newton and Euler about the origin); the same as
    I a + v x* I v with the spatial acceleration (Featherstone 2008, equation 5.9).
    """
    inertia = body.inertia
    f = inertia.m * motion.a + motion.rate_matrix() @ inertia.h
    n = inertia.I @ motion.wd + cross(motion.w, inertia.I @ motion.w) + cross(inertia.h, motion.a)
    return Wrench(n, f)


def joint_torque(body: Body, q: Vector, wrench: Wrench) -> Vector:
    """Return S^T f (nv,), the part of a wrench that the joint's actuator bears."""
    return wrench.project(body.joint.S(q))


def drive_torque(body: Body, q: Vector, qdd: Vector, wrench: Wrench) -> Vector:
    """Return the torque that the joint's actuator must give (nv,): its part of the wrench and its rotor's inertia."""
    return joint_torque(body, q, wrench) + vector([J * a for J, a in zip(body.rotors, qdd)])


def rnea(
    model: Model,
    q: Values,
    qd: Values,
    qdd: Values,
    gravity: Vector | None = None,
    X: Sequence[Transform] | None = None,
) -> Vector:
    """Return the joint torques of the rigid bodies and rotors, tau = M qdd + C qd + G.

    Parameters
    ----------
    q, qd, qdd : (nq,), (nv,), (nv,).
    gravity : (3,) base coordinates [m/s^2]; None for none.
    X : transforms from parent to body, where they are known already.

    Returns
    -------
    tau : (nv,) [N m or N]; gravity's pull included, joint springs, dampers and friction not.

    Source: Featherstone (2008), table 5.1, with classical accelerations (Luh, Walker and Paul 1980); rotors as N^2 J on
    the joint's diagonal, without gyroscopic effect.
    """
    X = transforms(model, q) if X is None else X
    motion = {BASE: BodyMotion.at_rest(gravity)}
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
        tau[body.v : body.v + body.joint.nv] = own
    return tau


def carry_down(
    model: Model, X: Sequence[Transform], wrench: Sequence[Wrench], base: Wrench | None = None
) -> tuple[list[Wrench], Wrench]:
    """Return the wrench that goes through each joint, and the one that goes through the base.

    f_k = own_k + sum of X^T f over the bodies that k carries (Featherstone 2008, equation 5.20).

    Parameters
    ----------
    wrench : that each body itself needs, about its origin in its coordinates. base : the same of the base.

    Returns
    -------
    The wrench of each body's parent on it, through the joint, about the body's origin in body coordinates; the wrench
    of the ground, about the base's origin in base coordinates.
    """
    carried = list(wrench)
    base = Wrench.zero() if base is None else base
    for k in reversed(range(len(model.bodies))):
        parent = model.bodies[k].parent
        share = carried[k].to_parent(X[k])
        if parent == BASE:
            base = base + share
        else:
            carried[parent] = carried[parent] + share
    return carried, base

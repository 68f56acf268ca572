"""Forward kinematics: where bodies are, how points move.

All quantities are in base coordinates unless a name says otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import BASE, Body, FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    Twist,
    Values,
    Vector,
    cross,
    identity,
    skew,
    vector,
    zeros,
)


def slice_q(body: Body, q: Values) -> Vector:
    """Return the position coordinates of a body's joint."""
    return vector(q[body.q : body.q + body.joint.nq])


def slice_v(body: Body, v: Values) -> Vector:
    """Return the velocity coordinates of a body's joint."""
    return vector(v[body.v : body.v + body.joint.nv])


@record
class Pose:
    """Axes R (columns) and origin p [m] of a frame in base coordinates."""

    R: Matrix
    p: Vector

    @staticmethod
    def identity() -> Pose:
        return Pose(identity(), zeros(3))

    def point(self, p: Vector) -> Vector:
        """Return base coordinates of a point given in this frame."""
        return self.p + self.R @ p

    def after(self, X: Transform) -> Pose:
        """Return the pose of the frame that X leads to from this frame."""
        return Pose(self.R @ X.E.T, self.p + self.R @ X.r)


def position_rates(model: Model, q: Values, v: Values) -> list[Any]:
    """Return q-dot (nq,) of velocities v (nv,)."""
    rates: list[Any] = [0.0] * model.nq
    for body in model.bodies:
        rates[body.q : body.q + body.joint.nq] = body.joint.velocity_map(slice_q(body, q), slice_v(body, v))
    return rates


def moved(model: Model, q: Values, dq: Values) -> list[Any]:
    """Return q (nq,) after a step dq (nv,) along the joints' manifolds."""
    positions = list(q)
    for body in model.bodies:
        positions[body.q : body.q + body.joint.nq] = body.joint.integrate(slice_q(body, q), slice_v(body, dq))
    return positions


def step_transform(body: Body, q: Vector) -> Transform:
    """Return X from a body's parent to the body, at the joint's position ``q`` (nq,)."""
    return body.joint.transform(q) @ body.X_tree


def transforms(model: Model, q: Values) -> list[Transform]:
    """Return X from parent to body, for each body."""
    return [step_transform(b, slice_q(b, q)) for b in model.bodies]


def poses(model: Model, X: Sequence[Transform], root: int = BASE) -> dict[int, Pose]:
    """Return the pose of each body that hangs on ``root``, in the coordinates of ``root``."""
    by_body: dict[int, Pose] = {root: Pose.identity()}
    for k, body in enumerate(model.bodies):
        if k != root and body.parent in by_body:
            by_body[k] = by_body[body.parent].after(X[k])
    return by_body


def point_jacobian(
    model: Model, q: Values, pose: dict[int, Pose], body: int, p: Vector, root: int = BASE
) -> tuple[Matrix, Matrix]:
    """Return the Jacobians (3, nv) of the velocity of point p and of the body's angular velocity.

    Column of a joint with motion subspace S = (S_w, S_v) in its body's frame (R, o):
    angular R S_w, linear R S_v + (R S_w) x (p - o) (Siciliano et al. 2009, equation 3.30).
    Motion is relative to ``root``, in its coordinates.
    """
    linear, angular = zeros(3, model.nv), zeros(3, model.nv)
    k = body
    while k != root and k != BASE:
        b = model.bodies[k]
        S = b.joint.S(slice_q(b, q))
        for j in range(b.joint.nv):
            axis = pose[k].R @ S[:3, j]
            linear[:, b.v + j] = pose[k].R @ S[3:, j] + cross(axis, p - pose[k].p)
            angular[:, b.v + j] = axis
        k = b.parent
    return linear, angular


def world_pose(model: Model, pose: dict[int, Pose], frame: FixedFrame) -> Pose:
    """Return the pose of a frame in world coordinates."""
    here = pose[frame.body]
    R, p = here.R @ frame.R, here.point(frame.p)
    return Pose(model.base.E.T @ R, model.base.point(p))


def world_jacobian(
    model: Model, q: Values, pose: dict[int, Pose], frame: FixedFrame
) -> tuple[Matrix, Matrix]:
    """Return the Jacobians (3, nv) of the velocity of a frame's origin and of its angular velocity, in the world."""
    linear, angular = point_jacobian(model, q, pose, frame.body, pose[frame.body].point(frame.p))
    to_world = model.base.E.T
    return to_world @ linear, to_world @ angular


def step_velocity(body: Body, X: Transform, q: Vector, qd: Vector, parent: Twist) -> Twist:
    """Return a body's velocity from its parent's, both in body coordinates: v = X v_p + S qd (table 5.1)."""
    return parent.to_child(X) + Twist.along(body.joint.S(q), qd)


def velocities(model: Model, X: Sequence[Transform], q: Values, qd: Values) -> dict[int, Twist]:
    """Return the spatial velocity of each body in its own coordinates, the base (at rest) included."""
    by_body = {BASE: Twist.zero()}
    for k, body in enumerate(model.bodies):
        by_body[k] = step_velocity(body, X[k], slice_q(body, q), slice_v(body, qd), by_body[body.parent])
    return by_body


@record
class BodyMotion:
    """Angular velocity w, angular acceleration wd and acceleration a of a body's origin, body coordinates.

    a is the classical acceleration of the material point, less gravity where the recursion was started with it. The
    spatial acceleration would be (wd, a - w x v) (Featherstone 2008, section 2.11); the classical one needs no v,
    which saves operations.
    """

    w: Vector
    wd: Vector
    a: Vector

    @staticmethod
    def at_rest(gravity: Vector | None = None) -> BodyMotion:
        """Return the motion of the base; gravity enters as an upward acceleration."""
        return BodyMotion(zeros(3), zeros(3), zeros(3) if gravity is None else -gravity)

    def rate_matrix(self) -> Matrix:
        """Return wd~ + w~ w~, the matrix that takes a lever arm to its acceleration."""
        return skew(self.wd) + squared_skew(self.w)

    def acceleration_of(self, p: Vector) -> Vector:
        """Return the acceleration of the body's point p."""
        return self.a + self.rate_matrix() @ p


def squared_skew(w: Vector) -> Matrix:
    """Return w~ w~ = w w^T - (w.w) E, symmetric."""
    square = [w[k] * w[k] for k in range(3)]
    out = zeros(3, 3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = -(square[j] + square[k])
        out[i, j] = out[j, i] = w[i] * w[j]
    return out


def step_motion(
    body: Body, X: Transform, q: Vector, qd: Vector, qdd: Vector, parent: BodyMotion
) -> BodyMotion:
    """Return a body's motion from its parent's, for any joint (Luh, Walker and Paul 1980, equations 11 to 13).

    With the joint's velocity (w_J, v_J) = S qd and its acceleration (wd_J, a_J) = S qdd + S_rate qd, both in body
    coordinates: w = E w_p + w_J;  wd = E wd_p + (E w_p) x w_J + wd_J;
    a = E (a_p + wd_p x r + w_p x (w_p x r)) + 2 (E w_p) x v_J + w_J x v_J + a_J.
    """
    S = body.joint.S(q)
    v_J = Twist.along(S, qd)
    a_J = Twist.along(S, qdd) + Twist.along(body.joint.S_rate(q, qd), qd)
    w_p = X.E @ parent.w
    w = w_p + v_J.w
    wd = X.E @ parent.wd + cross(w_p, v_J.w) + a_J.w
    a = X.E @ parent.acceleration_of(X.r) + cross(2.0 * w_p + v_J.w, v_J.v) + a_J.v
    return BodyMotion(w, wd, a)


def motions(
    model: Model,
    X: Sequence[Transform],
    q: Values,
    qd: Values,
    qdd: Values,
    gravity: Vector | None = None,
) -> dict[int, BodyMotion]:
    """Return the motion of each body, the base included."""
    by_body = {BASE: BodyMotion.at_rest(gravity)}
    for k, body in enumerate(model.bodies):
        by_body[k] = step_motion(
            body, X[k], slice_q(body, q), slice_v(body, qd), slice_v(body, qdd), by_body[body.parent]
        )
    return by_body


def prescribed_motion(model: Model, frame: FixedFrame) -> tuple[Vector, Vector]:
    """Return the rate and the acceleration of a point that moves on its body by formulas of t."""
    p = list(frame.p)
    if not any(isinstance(x, Expr) for x in p):
        return zeros(3), zeros(3)
    t = model.graph.symbol("t", "t")
    rate = directional(p, [t], [1.0])
    return vector(rate), vector(directional(rate, [t], [1.0]))

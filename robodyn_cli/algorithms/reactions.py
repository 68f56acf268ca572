"""Forces in joints and loop closures: the Newton-Euler recursion with the loops' multipliers as wrenches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.algorithms.kinematics import Pose, motions, poses
from robodyn_cli.algorithms.rnea import Wrench, carry_down, inertial_wrench
from robodyn_cli.loops.base import LoopFrame
from robodyn_cli.model.model import BASE, FixedFrame, Loop, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Transform, Values, Vector, cross, identity, zeros


@record
class LoopWrench:
    """What a closure exerts on its two links: (moment about the link's own point, force).

    Both in the coordinates of ``root``, the last body that the two chains share.
    """

    root: int
    on_first: Wrench
    on_second: Wrench


@record
class Reactions:
    """Wrenches (moment, force) in joints and closures [N m, N].

    joints : what the parent exerts on each body, about the body's origin in body coordinates. loops : of each
    closure. base : what the ground exerts on the whole mechanism, about the base's origin in base coordinates.
    """

    joints: list[Wrench]
    loops: list[LoopWrench]
    base: Wrench


def loop_wrench(model: Model, loop: Loop, X: Sequence[Transform], lam: Mapping[str, Any]) -> LoopWrench:
    """Return what a closure exerts on its links.

    The power of a row's multiplier is lambda Psi v. With the velocities of the two ends themselves in the place of
    v, Psi is the wrench of a unit multiplier (principle of virtual power), so the rows of the closure give it as
    they stand.

    Parameters
    ----------
    lam : multipliers by the row's name; rows without one carry nothing.
    """
    root = model.common_ancestor(loop.first.body, loop.second.body)
    pose = poses(model, X, root)
    ends = [_free_end(pose[frame.body], frame, 6 * k) for k, frame in enumerate((loop.first, loop.second))]
    total = zeros(12)
    for row in loop.element.rows(*ends):
        if row.name in lam:
            total = total + row.psi * lam[row.name]
    return LoopWrench(root, (total[3:6], total[0:3]), (total[9:12], total[6:9]))


def _free_end(here: Pose, frame: FixedFrame, place: int) -> LoopFrame:
    """Return an end whose velocity and angular velocity are coordinates themselves: entries of a (12,) vector."""
    Jv, Jw = zeros(3, 12), zeros(3, 12)
    Jv[:, place : place + 3] = identity()
    Jw[:, place + 3 : place + 6] = identity()
    rest = zeros(3)
    return LoopFrame(here.point(frame.p), here.R @ frame.R, Jv, Jw, rest, rest, rest, zeros(12))


def reactions(
    model: Model,
    q: Values,
    qd: Values,
    qdd: Values,
    lam: Mapping[str, Any],
    gravity: Vector | None,
    X: Sequence[Transform],
    applied: Mapping[int, Wrench] | None = None,
) -> Reactions:
    """Return the wrench in every joint and closure, and that of the ground.

    f_k = I a + v x* I v - (wrenches of closures and applied forces on k) + sum over the bodies that k carries.

    Parameters
    ----------
    q, qd, qdd : (nq,), (nv,), (nv,): a motion. lam : multipliers by row. gravity : (3,) base coordinates [m/s^2].
    applied : further wrenches on bodies, about the body's origin in body coordinates, by index.
    """
    motion = motions(model, X, q, qd, qdd, gravity)
    needed = {k: inertial_wrench(body, motion[k]) for k, body in enumerate(model.bodies)}
    needed[BASE] = (zeros(3), zeros(3))
    for k, (n, f) in (applied or {}).items():
        needed[k] = (needed[k][0] - n, needed[k][1] - f)
    found = []
    for loop in model.loops:
        wrench = loop_wrench(model, loop, X, lam)
        found.append(wrench)
        pose = poses(model, X, wrench.root)
        for frame, (n, f) in ((loop.first, wrench.on_first), (loop.second, wrench.on_second)):
            here = pose[frame.body]
            arm = here.R @ frame.p
            n_body, f_body = here.R.T @ (n + cross(arm, f)), here.R.T @ f
            own = needed[frame.body]
            needed[frame.body] = (own[0] - n_body, own[1] - f_body)
    joints, base = carry_down(model, X, [needed[k] for k in range(len(model.bodies))], needed[BASE])
    return Reactions(joints, found, base)

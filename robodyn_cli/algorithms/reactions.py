"""Forces in joints and loop closures: the Newton-Euler recursion with the loops' multipliers as wrenches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.algorithms.kinematics import BodyMotion, Pose, poses
from robodyn_cli.algorithms.rnea import carry_down, inertial_wrench
from robodyn_cli.loops.base import LoopFrame
from robodyn_cli.model.model import BASE, FixedFrame, Loop, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Transform, Wrench, identity, zeros


@record
class LoopWrench:
    """The wrenches that a closure exerts on its two links, each about the link's own point of the closure.

    Both in the coordinates of ``root``, the last body that the two chains share.
    """

    root: int
    on_first: Wrench
    on_second: Wrench


@record
class Reactions:
    """Wrenches in joints and closures.

    joints : of the parent on each body, about the body's origin in body coordinates. loops : of each closure. base :
    of the ground on the whole mechanism, about the base's origin in base coordinates.
    """

    joints: list[Wrench]
    loops: list[LoopWrench]
    base: Wrench


def loop_wrench(model: Model, loop: Loop, X: Sequence[Transform], lam: Mapping[str, Any]) -> LoopWrench:
    """Return the wrenches that a closure exerts on its links. A row's multiplier has the power lambda Psi v. With the
    velocities of the two ends in the place of v, Psi itself is the wrench of a unit multiplier (principle of virtual
    power), so the closure's own rows give it.

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
    return LoopWrench(root, Wrench(total[3:6], total[0:3]), Wrench(total[9:12], total[6:9]))


def _free_end(here: Pose, frame: FixedFrame, place: int) -> LoopFrame:
    """Return an end whose velocity and angular velocity are coordinates themselves: entries of a (12,) vector."""
    Jv, Jw = zeros(3, 12), zeros(3, 12)
    Jv[:, place : place + 3] = identity()
    Jw[:, place + 3 : place + 6] = identity()
    rest = zeros(3)
    return LoopFrame(here.point(frame.p), here.R @ frame.R, Jv, Jw, rest, rest, rest, zeros(12))


def reactions(
    model: Model,
    X: Sequence[Transform],
    motion: Mapping[int, BodyMotion],
    lam: Mapping[str, Any],
    applied: Mapping[int, Wrench] | None = None,
) -> Reactions:
    """Return the wrench in every joint and closure, and that of the ground.

    f_k = I a + v x* I v - (wrenches of closures and applied forces on k) + sum over the bodies that k carries.

    Parameters
    ----------
    X : transforms from parent to body. motion : of each body, gravity included (see ``motions``).
    lam : multipliers by row. applied : further wrenches on bodies, about the body's origin in body coordinates.
    """
    needed = {k: inertial_wrench(body, motion[k]) for k, body in enumerate(model.bodies)}
    needed[BASE] = Wrench.zero()
    for k, exerted in (applied or {}).items():
        needed[k] = needed[k] - exerted
    closures = []
    for loop in model.loops:
        wrench = loop_wrench(model, loop, X, lam)
        closures.append(wrench)
        pose = poses(model, X, wrench.root)
        for frame, exerted in ((loop.first, wrench.on_first), (loop.second, wrench.on_second)):
            R = pose[frame.body].R
            about_origin = exerted.shifted(R @ frame.p).rotated(R.T)
            needed[frame.body] = needed[frame.body] - about_origin
    joints, base = carry_down(model, X, [needed[k] for k in range(len(model.bodies))], needed[BASE])
    return Reactions(joints, closures, base)

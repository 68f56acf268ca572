"""Where the mass matrix is singular, and because of which joint."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from robodyn_cli.algorithms.aba import factor_joint
from robodyn_cli.algorithms.kinematics import slice_q, transforms
from robodyn_cli.errors import NumericalError
from robodyn_cli.expr.graph import is_number
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array, columns
from robodyn_cli.spatial.inertia import ArticulatedInertia

SINGULAR = 1e-12
NEARLY = 1e-6


@record
class Lightest:
    """The joint that feels the least inertia of what it carries.

    share : inertia felt with the joints beyond it free, over that with them locked; 0 where it carries nothing.
    """

    joint: str
    share: float
    carries: bool


@np.errstate(all="ignore")
def lightest_joint(model: Model, q: Array) -> Lightest | None:
    """Return the joint whose pivot of the mass matrix at q is smallest; None where that cannot be told.

    The pivots of M, leaves eliminated first, are the articulated inertias about the joints. They are compared
    with the composite inertias, which are the diagonal of M.
    """
    X = transforms(model, q.tolist())
    free = [ArticulatedInertia.from_rigid(b.inertia) for b in model.bodies]
    locked = list(free)
    found = Lightest("", 1.0, True)
    for k in reversed(range(len(model.bodies))):
        body = model.bodies[k]
        here = slice_q(body, q.tolist())
        S = body.joint.S(here)
        for s in columns(S):
            felt, carried = ((inertia @ s).dot(s) + body.armature for inertia in (free[k], locked[k]))
            if not (is_number(felt) and is_number(carried) and np.isfinite(float(carried))):
                return None
            share = float(felt) / float(carried) if carried > 0.0 else 0.0
            if share < found.share:
                found = Lightest(body.joint_name, max(share, 0.0), bool(carried > 0.0))
        if found.share < SINGULAR:
            return found
        if body.parent != BASE:
            _, rest = factor_joint(body, here, free[k])
            free[body.parent] = free[body.parent] + rest.to_parent(X[k])
            locked[body.parent] = locked[body.parent] + locked[k].to_parent(X[k])
    return found


def refuse_singular(model: Model, q: Array, prescribed: Collection[str] = ()) -> None:
    """Refuse a start at which the accelerations are not determined by the mass matrix; ``prescribed`` are joints.

    Raises
    ------
    NumericalError : the mass matrix is singular; the message names the joint.
    """
    found = lightest_joint(model, q)
    if found is None or found.share >= SINGULAR:
        return
    name = found.joint
    if not found.carries:
        what = f"joint {name!r} moves nothing that has inertia about it or along it"
        advice = "give its link a mass or an inertia, or the joint a rotor_inertia"
    else:
        what = f"joint {name!r} feels no inertia, because the joints beyond it can take all of its motion"
        advice = "give its link an inertia, or start in another configuration"
    if name in prescribed:
        raise NumericalError(
            f"the mass matrix is singular at t = 0: {what}; the multipliers are computed with its inverse. Its "
            "motion is prescribed, so a rotor_inertia of any size changes nothing but the force that drives it",
            time=0.0, joint=name, status="singular_mass_matrix",
        )  # fmt: skip
    raise NumericalError(
        f"the mass matrix is singular at t = 0: {what}, so its acceleration is not determined; {advice}",
        time=0.0, joint=name, status="singular_mass_matrix",
    )  # fmt: skip


def nearly_singular(model: Model, q: Array) -> str:
    """Return words for a message about a run that failed at q, empty if the mass matrix is not to blame."""
    if not np.all(np.isfinite(q)):
        return ""
    found = lightest_joint(model, q)
    if found is None or found.share >= NEARLY:
        return ""
    return (
        f"; the mass matrix is nearly singular there: joint {found.joint!r} feels {found.share:.1e} of the inertia "
        "that it carries"
    )

"""Where the mass matrix is singular, and because of which joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable

import numpy as np

from robodyn_cli.algorithms.aba import factor_joint
from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.kinematics import slice_q, transforms
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.expr.graph import is_number
from robodyn_cli.model.model import BASE, Model, unknown_among
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, columns
from robodyn_cli.spatial.inertia import ArticulatedInertia

SINGULAR = 1e-12
INDEFINITE = 1e-9  # of the joints' own inertias: less below zero is rounding
NEARLY = 1e-6
LIGHT = 1e-4  # of a typical inertia: a prescribed joint that feels less costs digits


@record
class Felt:
    """The inertia that a joint feels: ``free`` with the joints beyond it free, ``locked`` with them locked."""

    joint: str
    free: float
    locked: float

    @property
    def share(self) -> float:
        """The first over the second; 0 where the joint carries nothing."""
        return max(self.free / self.locked, 0.0) if self.locked > 0.0 else 0.0


@np.errstate(all="ignore")
def inertias_felt(model: Model, q: Array) -> list[Felt] | None:
    """Return what the joints' coordinates feel at q, from the leaves on, the first singular one last; None where that
    cannot be told.

    The pivots of M, leaves eliminated first, are the articulated inertias about the joints. They are compared
    with the composite inertias, which are the diagonal of M.
    """
    X = transforms(model, q.tolist())
    free = [ArticulatedInertia.from_rigid(b.inertia) for b in model.bodies]
    locked = list(free)
    inertias: list[Felt] = []
    for k in reversed(range(len(model.bodies))):
        body = model.bodies[k]
        here = slice_q(body, q.tolist())
        for s, rotor in zip(columns(body.joint.S(here)), body.rotors):
            one, other = ((inertia @ s).dot(s) + rotor for inertia in (free[k], locked[k]))
            if not (is_number(one) and is_number(other) and np.isfinite(float(other))):
                return None
            inertias.append(Felt(body.joint_name, float(one), float(other)))
        if any(x.share < SINGULAR for x in inertias):
            return inertias
        if body.parent != BASE:
            _, rest = factor_joint(body, here, free[k])
            free[body.parent] = free[body.parent] + rest.to_parent(X[k])
            locked[body.parent] = locked[body.parent] + locked[k].to_parent(X[k])
    return inertias


def lightest_joint(model: Model, q: Array) -> Felt | None:
    """Return the joint that feels the least part of what it carries; None where that cannot be told."""
    inertias = inertias_felt(model, q)
    return min(inertias, key=lambda felt: felt.share, default=None) if inertias else None


def braces(model: Model, q: Array, prescribed: Collection[str] = ()) -> dict[int, float]:
    """Return inertias that prescribed joints need beside those of the scene, by velocity coordinate.

    Where such a joint feels no inertia, or next to none, M has no inverse, or a bad one, and still nothing is
    undetermined: its acceleration is given. An inertia of any size, whose force the equations take off again, makes M
    regular (see ``equations/prescribed.py``).

    Raises
    ------
    NumericalError : the mass matrix is singular because of another joint, whose acceleration it does not determine;
        the message names the joint.
    """
    inertias: dict[int, float] = {}
    simple = {b.joint_name: k for k, b in enumerate(model.bodies) if b.joint.nv == 1}
    typical = _typical(model, q) if prescribed else 0.0
    while True:
        with witnessed():  # apart: what cancels in this pose is no structure
            felt = inertias_felt(model, q)
        if not felt:
            break
        able = [x for x in felt if x.joint in prescribed and x.joint in simple]
        light = [x for x in able if x.share < SINGULAR or x.free < LIGHT * typical]
        if not light:
            if (worst := min(felt, key=lambda x: x.share)).share < SINGULAR:
                raise _singular(worst)
            break
        place = simple[light[0].joint]
        body = model.bodies[place]
        inertias[body.v] = typical
        heavier = dataclasses.replace(body, armature=body.armature + typical)
        model = dataclasses.replace(
            model, bodies=(*model.bodies[:place], heavier, *model.bodies[place + 1 :])
        )
    return inertias


def refuse_indefinite(scene: Scene, poses: Iterable[Array]) -> None:
    """Refuse inertias that no bodies have, where they make a motion's kinetic energy negative in one of some poses.

    Single bodies may have any inertia as long as the mass matrix is that of some robot: identified parameters are such.
    Looked at is M along the motions that loops and prescribed joints allow, where a body is doubtful at all.

    Raises
    ------
    SceneError : with the joint that moves most, and the key of a doubtful body.
    """
    from robodyn_cli.model.consistency import doubtful_bodies

    doubtful = doubtful_bodies(scene)
    if not doubtful:
        return
    problem = Problem(
        scene
    )  # with a graph of its own: whether there are doubts is not to change the run's programs
    if unknown_among(problem.mass_matrix.ravel()):
        return  # who evaluates it says which data are missing
    for q in poses:
        rates = _negative_motion(problem.numbers(problem.mass_matrix, q), problem.numbers(problem.psi, q))
        if rates is not None:
            path, name, text = doubtful[0]
            key, joint = ".".join(map(str, path)), problem.model.joint_of(int(np.argmax(np.abs(rates))))
            where = scene.path
            raise SceneError(
                f"{where}: {key}: {name}: {text}, which makes the mass matrix not positive: the kinetic energy of a "
                f"motion of joint {joint!r} is negative; allowed: inertias of bodies, or identified parameters that "
                "keep the mass matrix positive",
                file=where, key=key, joint=joint,
            )  # fmt: skip


def _negative_motion(M: Array, psi: Array) -> Array | None:
    """Return rates (nv,) with Psi v = 0 and a kinetic energy below zero by more than rounding; None for none."""
    size = np.sqrt(np.where(np.diag(M) == 0.0, 1.0, np.abs(np.diag(M))))
    N = np.eye(len(M))
    if psi.size:
        _, s, Vt = np.linalg.svd(psi.reshape(-1, len(M)) / size)
        N = Vt[int((s > SINGULAR * s.max(initial=0.0)).sum()) :].T
    if not N.size:
        return None
    values, vectors = np.linalg.eigh(N.T @ (M / np.outer(size, size)) @ N)
    rates: Array = N @ vectors[:, 0] / size
    return rates if values[0] < -INDEFINITE else None


def _typical(model: Model, q: Array) -> float:
    """Return the mean of the known entries on the diagonal of M at q that are not zero, 1 where there is none."""
    diagonal = np.diag(np.array(crba(model, q.tolist()), dtype=object))
    known = [float(x) for x in diagonal if is_number(x) and x > 0.0]
    return sum(known) / len(known) if known else 1.0


def _singular(felt: Felt) -> NumericalError:
    if not felt.locked > 0.0:
        cause = f"joint {felt.joint!r} moves nothing that has inertia about it or along it"
        advice = "give its link a mass or an inertia, or the joint a rotor_inertia"
    else:
        cause = (
            f"joint {felt.joint!r} feels no inertia, because the joints beyond it can take all of its motion"
        )
        advice = "give its link an inertia, or start in another configuration"
    return NumericalError(
        f"the mass matrix is singular at t = 0: {cause}, so its acceleration is not determined; {advice}",
        time=0.0, joint=felt.joint, status="singular_mass_matrix",
    )  # fmt: skip


def nearly_singular(model: Model, q: Array) -> str:
    """Return words for a message about a run that failed at q, empty if the mass matrix is not to blame."""
    if not np.all(np.isfinite(q)):
        return ""
    felt = lightest_joint(model, q)
    if felt is None or felt.share >= NEARLY:
        return ""
    return (
        f"; the mass matrix is nearly singular there: joint {felt.joint!r} feels {felt.share:.1e} of the inertia "
        "that it carries"
    )

"""Where the mass matrix is singular, and because of which joint; what the closed mechanism has in its place."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.aba import factor_joint
from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.kinematics import moved, slice_q, transforms
from robodyn_cli.equations.constraints import inertias_along
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError, listed
from robodyn_cli.expr.fixed import is_witnessed, witnessed
from robodyn_cli.expr.graph import Graph, is_number
from robodyn_cli.expr.rebuild import renamed
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE, Body, Model, unknown_among
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import ROUNDED, mechanism_size
from robodyn_cli.spatial.algebra import Array, Matrix, Transform, Vector, columns
from robodyn_cli.spatial.inertia import ArticulatedInertia, RigidInertia

SINGULAR = 1e-12
INDEFINITE = 1e-9  # of the joints' own inertias: less below zero is rounding
NEARLY = 1e-6
LIGHT = 1e-4  # share of an inertia: a joint of a closed loop that feels less costs digits
POSES = 32  # of the opened tree, in which joints that may become light are looked at
NEAR_LIGHT = 0.05  # least share in these from which on a joint may well become light between them
DEPENDENT = 1e-9  # of the largest singular value: rows that depend on each other


@record
class Felt:
    """The inertia that a joint feels: ``free`` with the joints beyond it free, ``locked`` with them locked, ``own``
    that of its own body alone. Numbers of the scene, as the inertias are."""

    joint: str
    free: float
    locked: float
    own: float

    @property
    def share(self) -> float:
        """The first over the second; 0 where the joint carries nothing."""
        return max(float(self.free) / float(self.locked), 0.0) if float(self.locked) > 0.0 else 0.0


@np.errstate(all="ignore")
def inertias_felt(model: Model, q: Array) -> list[Felt] | None:
    """Return what the joints' coordinates feel at q, from the leaves on, the first singular one last; None where that
    cannot be told.

    The pivots of M, leaves eliminated first, are the articulated inertias about the joints. They are compared
    with the composite inertias, which are the diagonal of M.
    """
    X = transforms(model, q.tolist())
    own = [ArticulatedInertia.from_rigid(b.inertia) for b in model.bodies]
    free, locked = list(own), list(own)
    inertias: list[Felt] = []
    for k in reversed(range(len(model.bodies))):
        body = model.bodies[k]
        here = slice_q(body, q.tolist())
        felt = [_about(body, here, inertia[k]) for inertia in (free, locked, own)]
        if not all(is_number(x) and np.isfinite(float(x)) for diagonal, _ in felt for x in diagonal):
            return None
        of_joint = [Felt(body.joint_name, *x) for x in zip(felt[0][1], felt[1][0], felt[2][1])]
        inertias += of_joint
        if any(x.share < SINGULAR for x in of_joint):
            return inertias
        if body.parent != BASE:
            _, rest = factor_joint(body, here, free[k])
            free[body.parent] = free[body.parent] + rest.to_parent(X[k])
            locked[body.parent] = locked[body.parent] + locked[k].to_parent(X[k])
    return inertias


def _about(body: Body, q: Vector, inertia: ArticulatedInertia) -> tuple[list[float], list[float]]:
    """Return the diagonal of a joint's D = S^T I S, rotors included, and its pivots, the first coordinate eliminated
    first; the diagonal again where D depends on data that are missing."""
    S = columns(body.joint.S(q))
    D = np.array([[(inertia @ s).dot(r) for r in S] for s in S], dtype=object).reshape(len(S), len(S))
    for j, rotor in enumerate(body.rotors):
        D[j, j] = D[j, j] + rotor
    diagonal = list(np.diag(D))
    if all(is_number(x) for x in D.flat):
        for j in range(len(D)):
            if float(D[j, j]) > 0.0:
                for i in range(j + 1, len(D)):
                    D[i, j + 1 :] = D[i, j + 1 :] - (D[i, j] / D[j, j]) * D[j, j + 1 :]
    return diagonal, list(np.diag(D))


def lightest_joint(model: Model, q: Array) -> Felt | None:
    """Return the joint that feels the least part of what it carries; None where that cannot be told."""
    inertias = inertias_felt(model, q)
    return min(inertias, key=lambda felt: felt.share, default=None) if inertias else None


# -- closed mechanisms ---------------------------------------------------------------------------------------
def braces(problem: Problem, model: Model, q: Array) -> dict[str, float]:
    """Return inertias along the constraint rows, by name, where the opened tree's M has no inverse or a bad one.

    The closed mechanism may have its inertia all the same, since its rows give the accelerations that M does not; with
    these inertias, whose force the equations take off again, M is regular (``with_inertia`` of
    ``equations/constraints.py``).

    Parameters
    ----------
    model : the bodies as they are at the start. q : closed start (nq,).

    Raises
    ------
    NumericalError : the rows leave a motion that moves nothing with inertia; the message names the joint.
    """
    numbers = _apart(model, is_witnessed())  # places of numbers matter only to who lists comparisons
    with witnessed():  # apart: what cancels in this pose is no structure
        felt = inertias_felt(numbers, q)
    if not felt:
        return {}
    constraints, worst = problem.all_constraints, min(felt, key=lambda x: x.share)
    if not constraints.rows:
        if worst.share < SINGULAR:
            raise _singular(worst)
        return {}
    M = _numbers(numbers, q)
    if M is None:
        return {}
    psi = _moving_rows(problem, q)
    if not (_is_light(felt, M) or _is_lost(problem, model, M, psi) or _may_be_light(model, q, felt)):
        return {}
    if (least := _least_felt(model, M, psi)) is not None and least[0] < SINGULAR:
        raise _singular(worst) if least[1] == [worst.joint] else _undetermined(least[1])
    return dict(zip(constraints.names, _along(problem, model)))


def _along(problem: Problem, model: Model) -> list[float]:
    """Return inertias along all rows, as numbers of the scene, so that runs with others share their code: those in a
    pose that no loop closes and no start decides."""
    angles = np.random.default_rng(0).uniform(0.3, 1.2, model.nv)
    step = [x if unit == "rad" else 0.0 for x, unit in zip(angles.tolist(), model.v_units)]
    q, psi = moved(model, Manifold(model).neutral().tolist(), step), problem.all_constraints.psi(model.nv)
    with witnessed():
        entries = renamed(psi.ravel().tolist(), {"q": dict(enumerate(q)), "t": {0: 0.0}})
        known = np.array([x if is_number(x) else 0.0 for x in entries], dtype=object).reshape(psi.shape)
        known[_is_rounding(problem, known.astype(float))] = 0.0
        return inertias_along(crba(model, q), known)


def _is_rounding(problem: Problem, psi: Array) -> NDArray[np.bool_]:
    """Tell which rows of Psi (m, nv) are nothing but rounding, such as those of a planar loop's axes in a tilted plane.

    Such a row moves nothing, and nothing may be divided by its length.
    """
    size = mechanism_size(problem.model)
    lengths = np.array([size if unit == "m" else 1.0 for unit in problem.model.v_units])
    sizes = np.array([size if row.unit == "m" else 1.0 for row in problem.all_constraints.rows])
    return np.asarray(np.abs(psi * lengths).max(axis=1, initial=0.0) < ROUNDED * sizes)


def _moving_rows(problem: Problem, q: Array, time: float = 0.0) -> Array:
    """Return Psi (m, nv) of all rows at q (nq,), with zeros in those that are rounding."""
    psi = problem.numbers(problem.all_constraints.psi(problem.model.nv), q, time)
    return np.where(_is_rounding(problem, psi)[:, None], 0.0, psi)


def _is_light(felt: list[Felt], M: Array) -> bool:
    """Tell whether some joint feels next to nothing of what it carries."""
    # all are compared: with other numbers of the scene another joint may be the light one, of all or of its branch
    typical = float(np.diag(M).mean())
    light = [(float(x.locked) <= 0.0 or x.free < LIGHT * x.locked, x.free < LIGHT * typical) for x in felt]
    return any(share for share, _ in light)


def _is_lost(problem: Problem, model: Model, M: Array, psi: Array) -> bool:
    """Tell whether Psi M^-1 Psi^T loses digits that inertias along the rows leave: where a light branch moves in
    several rows, they are alike but for the part of the others."""

    def eigenvalues(M: Array) -> Array:
        A = psi @ np.linalg.solve(M, psi.T)
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        values: Array = np.linalg.eigvalsh(A / np.outer(size, size))
        return values

    opened = eigenvalues(M)
    if opened[0] >= LIGHT:
        return False
    along = np.array(_along(problem, model), dtype=float)
    s = np.linalg.svd(psi / np.maximum(np.linalg.norm(psi, axis=1), 1e-300)[:, None], compute_uv=False)
    least = -int((s > DEPENDENT * s.max(initial=0.0)).sum())  # of the rows that are independent
    return least < 0 and bool(opened[least] < LIGHT * eigenvalues(M + psi.T @ (along[:, None] * psi))[least])


def _may_be_light(model: Model, q: Array, felt: list[Felt]) -> bool:
    """Tell whether a joint may come to feel next to nothing, in other poses of the opened tree than q (nq,)."""
    # a body that has inertia of its own along its joint leaves the joint some in every pose
    doubtful = [x.own < LIGHT * x.locked for x in felt]
    if not any(doubtful):
        return False
    rng, plain = np.random.default_rng(0), _apart(model)
    room = [np.pi if unit == "rad" else mechanism_size(model) for unit in model.v_units]
    with witnessed():
        for _ in range(POSES):
            step = rng.uniform(-1, 1, model.nv) * room
            there = lightest_joint(plain, np.array(moved(model, q.tolist(), step)))
            if there is None or there.share < NEAR_LIGHT:
                return True
    return False


def _apart(model: Model, placed: bool = False) -> Model:
    """Return the model for numbers alone: unless they are to stay ``placed``, floats that do not know how they were
    computed, which takes a tenth of the time; what is unknown as symbols of another graph, which does not grow the
    problem's."""
    graph = Graph()

    def floats(x: Any) -> Any:
        parts = [
            (e if placed else float(e)) if is_number(e) else graph.symbol(f"u{e.index}", "unknown", e.index)
            for e in np.ravel(x)
        ]
        return np.array(parts, dtype=object).reshape(np.shape(x))

    bodies = [
        dataclasses.replace(
            body,
            X_tree=Transform(floats(body.X_tree.E), floats(body.X_tree.r)),
            inertia=RigidInertia(*(floats(x)[()] for x in (body.inertia.m, body.inertia.h, body.inertia.I))),
            armature=tuple(floats(body.rotors)),
        )
        for body in model.bodies
    ]
    return dataclasses.replace(model, bodies=tuple(bodies))


def _least_felt(model: Model, M: Array, psi: Array) -> tuple[float, list[str]] | None:
    """Return the motion with Psi v = 0 that moves the least inertia, with M (nv, nv); None where nothing can move.

    That is the share that it moves of the inertias of its joints, and these joints, those that move most first.
    Coordinates are scaled by the inertias on M's diagonal, or by those along the rows where these are next to nothing.
    """
    # what rounding leaves of a zero is to scale nothing
    psi = np.where(np.abs(psi) > SINGULAR * np.abs(psi).max(axis=1, initial=0.0, keepdims=True), psi, 0.0)
    along = np.diag(psi.T @ (np.array(inertias_along(M, psi))[:, None] * psi))
    square = np.maximum(np.diag(M), SINGULAR * along)
    size = np.sqrt(np.where(square > 0.0, square, 1.0))
    rows = psi / size
    _, s, Vt = np.linalg.svd(rows / np.maximum(np.linalg.norm(rows, axis=1), 1e-300)[:, None])
    N = Vt[int((s > DEPENDENT * s.max(initial=0.0)).sum()) :].T
    if not N.size:
        return None
    values, vectors = np.linalg.eigh(N.T @ (M / np.outer(size, size)) @ N)
    motion = np.abs(N @ vectors[:, 0])
    joints = list(dict.fromkeys(model.joint_of(int(k)) for k in np.argsort(-motion) if motion[k] > 1e-6))
    return float(values[0]), joints


def _numbers(model: Model, q: Array) -> Array | None:
    """Return the opened tree's M (nv, nv) at q (nq,); None where it depends on data that are missing."""
    with witnessed():
        M: Matrix = crba(model, q.tolist())
    return np.array(M, dtype=float) if all(is_number(x) for x in M.flat) else None


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
                f"{name}: {text}, which makes the mass matrix not positive: the kinetic energy of a "
                f"motion of joint {joint!r} is negative; allowed: inertias of bodies, or identified parameters that "
                "keep the mass matrix positive", (where, key),
                file=where, key=key, joint=joint,
            )  # fmt: skip


def negative_part(M: Any, psi: Any) -> Any:
    """Return the sum of what eigenvalues of M (N, nv, nv) along motions with Psi v = 0 lie below zero (N,).

    M is in parts of the joints' own inertias; Psi (N, m, nv). Of a symmetric matrix the singular values are the sizes
    of the eigenvalues, so that the sum is half of what they exceed the trace by.
    """
    n = M.shape[-1]
    own = np.abs(M[:, range(n), range(n)])
    size = np.sqrt(np.where(own == 0.0, 1.0, own))
    M = M / (size[:, :, None] * size[:, None, :])
    if psi.shape[1]:
        _, s, Vt = np.linalg.svd(psi / size[:, None, :], full_matrices=False)
        holds = s > SINGULAR * s.max(axis=1, initial=0.0)[:, None]
        along = np.eye(n) - Vt.transpose(0, 2, 1) @ (holds[:, :, None] * Vt)
        M = along @ M @ along
    sizes = np.linalg.svd(M, compute_uv=False).sum(axis=1)
    return 0.5 * (sizes - M[:, range(n), range(n)].sum(axis=1))


def _negative_motion(M: Array, psi: Array) -> Array | None:
    """Return rates (nv,) with Psi v = 0 and a kinetic energy below zero by more than rounding; None for none."""
    if negative_part(M[None], psi.reshape(1, -1, len(M)))[0] <= INDEFINITE:
        return None
    size = np.sqrt(np.where(np.diag(M) == 0.0, 1.0, np.abs(np.diag(M))))
    N = np.eye(len(M))
    if psi.size:
        _, s, Vt = np.linalg.svd(psi.reshape(-1, len(M)) / size)
        N = Vt[int((s > SINGULAR * s.max(initial=0.0)).sum()) :].T
    rates: Array = N @ np.linalg.eigh(N.T @ (M / np.outer(size, size)) @ N)[1][:, 0] / size
    return rates


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


def _undetermined(joints: list[str]) -> NumericalError:
    first, *rest = joints
    others = f", with {listed(rest)}," if rest else ""
    return NumericalError(
        f"the mass matrix is singular at t = 0, and so is the closed mechanism: its loops let joint {first!r} "
        f"move{others} without moving anything that has inertia, so that its acceleration is not determined; give a "
        "link there a mass or an inertia, or a joint a rotor_inertia",
        time=0.0, joint=first, status="singular_mass_matrix",
    )  # fmt: skip


def nearly_singular(problem: Problem, q: Array, time: float) -> str:
    """Return words for a message about a run that failed at q, empty if the mass matrix is not to blame."""
    if not np.all(np.isfinite(q)):
        return ""
    model = problem.model
    if problem.braces:
        M, psi = _numbers(model, q), _moving_rows(problem, q, time)
        least = None if M is None else _least_felt(model, M, psi)
        if least is None or least[0] >= NEARLY:
            return ""
        return (
            f"; the loops let joint {least[1][0]!r} move there with {least[0]:.1e} of the inertias of the joints "
            "that move"
        )
    felt = lightest_joint(model, q)
    if felt is None or felt.share >= NEARLY:
        return ""
    return (
        f"; the mass matrix is nearly singular there: joint {felt.joint!r} feels {felt.share:.1e} of the inertia "
        "that it carries"
    )

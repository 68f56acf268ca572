"""Which way driven joints go, at rest too, and which joints of a mechanism are driven."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import Exerted
from robodyn_cli.schema.fields import DRIVE
from robodyn_cli.spatial.algebra import Array

SLOW = 1e-12  # of the rates: so slow that only the direction of motion counts
AT_REST = 1e-9  # of the largest rate of a joint, below which it is at rest


def directed(v: Array) -> Array:
    """Return rates (T, nv) with those of joints at rest so small that they only tell where the joint goes next, or came
    from; of joints that never move 0."""
    v = v.copy()
    for k, most in enumerate(np.abs(v).max(axis=0)):
        moving = np.flatnonzero(np.abs(v[:, k]) > AT_REST * most)
        if most > 0.0 and len(moving) < len(v):
            still = np.setdiff1d(np.arange(len(v)), moving)
            after = moving[np.minimum(np.searchsorted(moving, still), len(moving) - 1)]
            v[still, k] = AT_REST * SLOW * most * np.sign(v[after, k])
    return v


def begun(
    v: Array, R: Array, driven: Sequence[int], arrays: dict[str, Array], given: dict[str, Exerted]
) -> Array:
    """Return rates (T, nv) in which driven joints that never move are about to go where what drives would move them;
    where that may be either way, as of motors, against what acts on them."""
    resting = [n for n, k in enumerate(driven) if not v[:, k].any()]
    if not resting:
        return v
    sums = {True: np.zeros_like(v), False: np.zeros_like(v)}
    for name, one in given.items():
        if name in arrays:
            sums[one.role == DRIVE] = sums[one.role == DRIVE] + arrays[name]
    drive, rest = (np.sign(np.einsum("tin,ti->tn", R[:, :, resting], sums[own])) for own in (True, False))
    towards = np.where(drive == 0.0, -rest, drive)
    moved: Array = v + AT_REST * np.einsum("tin,tn->ti", R[:, :, resting], towards)
    return moved


def driven_joints(
    problem: Problem, every: dict[str, Exerted], psi: Array
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return coordinates that the others follow from, as places among the velocities, and the driven ones of these.

    In loops, with Psi (m, nv), they are as many as there are degrees of freedom, and driven joints are taken first.
    """
    names, options = problem.model.v_names, problem.scene.motorisation
    acted = np.any([one.acts for one in every.values() if one.role == DRIVE], axis=0)
    wanted = [names.index(name) for name in options.joints] or np.flatnonzero(acted).tolist()
    if not len(psi):
        return tuple(range(len(names))), tuple(wanted)
    _, sizes, V = np.linalg.svd(psi)
    free = V[int(np.sum(sizes > 1e-9 * sizes.max(initial=0.0))) :].T
    chosen: list[int] = []
    for k in (*wanted, *(k for k in range(len(names)) if k not in wanted)):
        if np.linalg.matrix_rank(free[[*chosen, k]], tol=1e-9) > len(chosen):
            chosen.append(k)
    return tuple(chosen), tuple(k for k in wanted if k in chosen)

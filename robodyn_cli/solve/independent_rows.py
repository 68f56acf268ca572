"""Rows of Psi that are independent, those that follow from them, and starts at which that fails.

Rows that depend on each other in every configuration (a planar loop closed in space) are left out; where they do so at
the start alone, or where freedoms of first order are no motions, the start is singular.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.errors import SingularConfigurationError
from robodyn_cli.solve.closure import CLOSED, CUT, ROUNDED, Numbers, newton, rank
from robodyn_cli.spatial.algebra import Array

RANK_TOLERANCE = 1e-7  # ratio of singular values below which a configuration counts as singular
BEND = 1e-4  # rad, or part of the size, between the Psi that tell how rows bend
BENT = 1e-5  # bend, of 1 rad or the size, from which on a freedom of first order is no motion
MOTION_SAMPLES = 80  # configurations on each side of the start at which choices of rows are compared
MOTION_STEP = 0.1  # rad, or part of the size of the mechanism, between them
ENOUGH = 1e-13  # residual of the configurations between, at which steps go no further
MOST_CHOICES = 3000  # up to so many choices of rows are compared one by one


def is_truss(psi: Array) -> bool:
    """Tell whether the rows of Psi (m, nv) leave no freedom."""
    return bool(psi.size) and rank(psi, RANK_TOLERANCE) == psi.shape[1]


def independent_rows(
    numbers: Numbers, q: Array, tolerance: float = RANK_TOLERANCE
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return independent rows and redundant ones, which depend on the others in every configuration.

    tolerance : of the rank, and of closed loops if it is ``ROUNDED``.

    Raises
    ------
    SingularConfigurationError : rows depend on each other at this configuration alone.
    """
    example = generic_psi(numbers, q, tolerance)
    m = len(numbers.rows)
    if example is None:
        return tuple(range(m)), ()
    return _best_rows([example, *_along_the_motion(numbers, q, tolerance)], rank(example, tolerance), m)


def generic_psi(numbers: Numbers, q: Array, tolerance: float = RANK_TOLERANCE) -> Array | None:
    """Return a Psi (m, nv) with the rank that the mechanism has near a configuration; None where all rows are
    independent.

    Raises
    ------
    SingularConfigurationError : rows depend on each other at this configuration alone.
    """
    psi = numbers.psi(q)
    here = rank(psi, tolerance)
    if here == len(numbers.rows):
        return None
    cut, closed = (ROUNDED, ROUNDED) if tolerance == ROUNDED else (CUT, CLOSED)
    # the rank at nearby closed configurations is that of the mechanism itself
    rng = np.random.default_rng(7)
    generic, example = here, psi
    for _ in range(6):
        start = numbers.manifold.integrate(q, 0.05 * rng.normal(size=numbers.nv) * numbers.lengths)
        moved, residual = newton(numbers, start, range(numbers.nv), cut=cut)
        if residual < max(1e-9, closed):
            there = rank(numbers.psi(moved), tolerance)
            if there > generic:
                generic, example = there, numbers.psi(moved)
    pose = ", ".join(f"{name} {x:.6g}" for name, x in zip(numbers.q_names, q))
    if here < generic:
        raise SingularConfigurationError(
            f"the start ({pose}) is a singular configuration: the constraints lose rank there "
            f"({here} of {generic} independent rows), so multipliers are not unique; start away from it",
            rank=here, generic_rank=generic, kind="bifurcation", q=q.tolist(),
        )  # fmt: skip
    if (row := _bent(numbers, q, psi, tolerance)) is not None:
        raise SingularConfigurationError(
            f"the start ({pose}) is a singular configuration: to first order the constraints leave "
            f"{numbers.nv - here} freedoms, but {numbers.rows[row].name} bends away from some of them, so that they "
            "are no motions of the mechanism; start away from it, or look for lengths that leave it stretched or "
            "folded there",
            rank=here, kind="bifurcation", row=numbers.rows[row].name, q=q.tolist(),
        )  # fmt: skip
    return example


def _bent(numbers: Numbers, q: Array, psi: Array, tolerance: float) -> int | None:
    """Return the row most concerned where first-order freedoms are no motions, None where all may be.

    With N spanning Psi v = 0 and w the rows that depend on each other, w^T Psi = 0, a motion along N x needs
    w^T d/ds(Psi N x) = 0: no acceleration helps, since w^T Psi a = 0. Rows that are redundant in all configurations
    have it for every x.
    """
    lengths, sizes = numbers.lengths, numbers.sizes[:, None]
    rows, _, motions = np.linalg.svd(psi * lengths / sizes)
    r = rank(psi, tolerance)
    w, N = rows[:, r:], motions[r:].T
    rng = np.random.default_rng(13)
    for x in [*np.eye(N.shape[1]), *rng.normal(size=(3, N.shape[1]))]:
        n = lengths * (N @ (x / np.linalg.norm(x)))
        ahead, behind = (numbers.psi(numbers.manifold.integrate(q, way * n)) for way in (BEND, -BEND))
        bend = w.T @ (((ahead - behind) @ n) / (2.0 * BEND * sizes[:, 0]))
        if np.abs(bend).max(initial=0.0) > BENT:
            return int(np.abs(w @ bend).argmax())
    return None


def _along_the_motion(numbers: Numbers, q: Array, tolerance: float) -> list[Array]:
    """Return Psi at closed configurations on both sides of q along the mechanism's motion."""
    rng, lengths = np.random.default_rng(11), numbers.lengths
    cut, closed = (ROUNDED, ROUNDED) if tolerance == ROUNDED else (CUT, CLOSED)
    jacobians = []
    for way in (1.0, -1.0):
        here = q.copy()
        last = way * rng.normal(size=numbers.nv)
        for _ in range(MOTION_SAMPLES):
            psi = numbers.psi(here) * lengths
            free = np.linalg.svd(psi)[2][rank(psi, tolerance) :]
            step = free.T @ (free @ last)
            if not np.any(step):
                break
            last = step / np.abs(step).max()
            ahead = numbers.manifold.integrate(here, MOTION_STEP * last * lengths)
            here, residual = newton(numbers, ahead, range(numbers.nv), cut=cut, enough=ENOUGH)
            if residual > closed:
                break
            jacobians.append(numbers.psi(here))
    return jacobians


def _best_rows(samples: list[Array], rank: int, m: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the rows with the largest worst ratio of singular values over all samples of Psi, and the others."""
    psi = np.stack(samples)
    largest = np.linalg.svd(psi, compute_uv=False)[:, 0]
    keep: tuple[int, ...] = ()
    if math.comb(m, rank) <= MOST_CHOICES:
        keep = _best_choice(psi, largest, list(itertools.combinations(range(m), rank)))
    else:
        while len(keep) < rank:
            keep = _best_choice(psi, largest, [(*keep, i) for i in range(m) if i not in keep])
    return tuple(sorted(keep)), tuple(i for i in range(m) if i not in keep)


def _best_choice(psi: Array, largest: Array, choices: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
    """Return the rows whose worst ratio of singular values over all samples (T, m, n) is largest, the first of equals.

    Some of the samples bound that ratio from above, so that all are looked at for the most promising rows only.
    """
    bounds = [(-math.inf, k, 0) for k in range(len(choices))]
    while True:
        bound, k, done = heapq.heappop(bounds)
        if done == len(psi):
            return choices[k]
        some = slice(done, 1 + 2 * done)
        sigma = np.linalg.svd(psi[some][:, list(choices[k])], compute_uv=False)[:, -1]
        ratio = float((sigma / largest[some]).min())
        heapq.heappush(bounds, (max(bound, -ratio), k, min(some.stop, len(psi))))

"""The closed configuration nearest to a start, or to q = 0 where no start is given."""

from __future__ import annotations

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.closing.descent import Aligned, descend, starts_around
from robodyn_cli.solve.closing.open_loops import Closable, open_loop
from robodyn_cli.solve.closure import CLOSED, CUT, MOST_STEP, ROUNDED, Numbers, newton, rank
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.spatial.algebra import Array

NEAREST = 2  # closed configurations that are moved nearer
FEW = 8  # random starts of damped steps at each distance
NEARLY = 1e-4  # rad, or part of the size, that Newton's steps, or rounding, may account for
SLIDES = 60  # steps towards the nearest configuration at most
REGULAR = 1e-2  # ratio of singular values down to which the nearest configuration is approached

Pose = tuple[float, Array]  # distance from the start, or residual, and a configuration


@record
class Nearest:
    """How the configuration nearest to q = 0 was found: starts, how many of them closed, and its distance, in rad and
    sizes of the mechanism (root of the sum of squares)."""

    starts: int
    closed: int
    distance: float


@record
class ClosedPose:
    """A closed configuration (nq,), up to which residual, and how it was found where no coordinate had a value."""

    q: Array
    tolerance: float = CLOSED
    nearest: Nearest | None = None

    @property
    def cut(self) -> float:
        """Ratio of singular values below which directions are left alone."""
        return ROUNDED if self.tolerance == ROUNDED else CUT

    @property
    def rank_tolerance(self) -> float:
        """Ratio of singular values below which rows depend on each other."""
        return max(RANK_TOLERANCE, self.cut)


def close(numbers: Numbers, q: Array, task: Closable) -> ClosedPose:
    """Return the closed configuration nearest to q, from q itself or from starts around it.

    Missing coordinates start anywhere. The others start further and further from q, but only if nothing nearer closes
    and damped steps, which reach further, find that the loops close at all.
    """
    if not task.given:
        return _nearest_to_neutral(numbers, q, task)
    starts = [q, *starts_around(numbers, q, task.missing, np.pi, 1)]
    poses, tried = _close_from(numbers, q, task, starts)
    near = [start for start, (left, _) in zip(starts, tried) if left < NEARLY]
    exact = _regular(numbers, poses)[0] if poses else None
    if exact is None or _hides_dependence(numbers, exact[1]):
        rounded = _close_rounded(numbers, q, task, near)
        if rounded and (exact is None or _spends_freedom(numbers, exact, rounded)):
            # a pose that is given whole, and closed as well as such rows may be, stays what it is
            whole = not task.missing and np.abs(numbers.relative(q)).max() <= ROUNDED
            return ClosedPose(q if whole else rounded[1], ROUNDED)
    if not poses:
        for seed, spread in enumerate((0.0, 0.3, 1.0, np.pi), start=20):
            around = starts_around(numbers, q, task.free, spread, seed, FEW if spread else 1)
            descended, further = _descend_from(numbers, q, task, around)
            tried += further
            if descended:
                break
        else:
            raise open_loop(numbers, task, tried)
        for seed, spread in enumerate((0.3, 1.0, np.pi), start=2):
            if not poses:
                around = starts_around(numbers, q, task.free, spread, seed)
                poses, more = _close_from(numbers, q, task, around)
                tried += more
        poses = poses or [pose for pose in descended if not _far(numbers, q, pose[1], task)]
    if not poses:
        raise open_loop(numbers, task, tried)
    return ClosedPose(_regular(numbers, poses)[0][1])


def _hides_dependence(numbers: Numbers, closed: Array) -> bool:
    """Tell whether rows depend on each other but for rounding in the data, there and nearby.

    Such rows can often be closed exactly, but only far along a freedom that they seem to bind.
    """
    psi = numbers.psi(closed)
    here = rank(psi, ROUNDED)
    if here == rank(psi, CUT):
        return False
    away = 0.05 * np.random.default_rng(9).normal(size=numbers.nv) * numbers.lengths
    moved, residual = newton(numbers, numbers.step(closed, away), range(numbers.nv), cut=ROUNDED)
    return residual <= ROUNDED and rank(numbers.psi(moved), ROUNDED) == here


def _spends_freedom(numbers: Numbers, exact: Pose, rounded: Pose) -> bool:
    """Tell whether an exact pose is worse than one closed but for rounding: farther off, or with a freedom less."""
    psi = numbers.psi(exact[1])
    return rank(psi, RANK_TOLERANCE) > rank(psi, ROUNDED) or rounded[0] < exact[0] - ROUNDED


def _close_rounded(numbers: Numbers, q: Array, task: Closable, starts: list[Array]) -> Pose | None:
    """Return the nearest configuration with redundant rows that contradict each other by rounding in the data, if the
    starts lead to one."""
    poses = [
        pose
        for pose in _close_from(numbers, q, task, starts, ROUNDED)[0]
        if rank(numbers.psi(pose[1]), ROUNDED) < len(numbers.rows)
    ]
    # what is weaker than NEARLY is rounding in the data, which may look like a rank
    return _regular(numbers, poses, NEARLY)[0] if poses else None


def _far(numbers: Numbers, q: Array, closed: Array, task: Closable) -> bool:
    """Tell whether a given coordinate has moved by more than the widest starts do."""
    moved = np.abs(numbers.manifold.difference(q, closed)) / numbers.lengths
    moved[task.missing] = 0.0
    return bool(moved.max(initial=0.0) > np.pi)


def _regular(numbers: Numbers, poses: list[Pose], tolerance: float = RANK_TOLERANCE) -> list[Pose]:
    """Return the poses of highest rank, the nearest first: a regular one is preferred to any singular one."""
    ranks = [rank(numbers.psi(closed), tolerance) for _, closed in poses]
    return sorted((f for f, own in zip(poses, ranks) if own == max(ranks)), key=lambda f: f[0])


def _nearest_to_neutral(numbers: Numbers, q: Array, task: Closable) -> ClosedPose:
    """Return the closed configuration nearest to q, where no coordinate has a value, of those that starts lead to."""

    def distance(closed: Array) -> float:
        return float(np.linalg.norm(numbers.manifold.difference(q, closed) / numbers.lengths))

    poses: list[Pose] = []
    tried: list[Pose] = []
    starts: list[Array] = []
    for seed, spread in enumerate((0.0, 0.3, 1.0, np.pi), start=20):
        if spread == np.pi and poses:
            break
        around = starts_around(numbers, q, task.free, spread, seed, FEW if spread else 1)
        closed, more = _descend_from(numbers, q, task, around)
        poses, tried, starts = poses + closed, tried + more, starts + around
    if not poses or _hides_dependence(numbers, _regular(numbers, poses)[0][1]):
        near = [start for start, (left, _) in zip(starts, tried) if left < NEARLY]
        if rounded := _close_rounded(numbers, q, task, near):
            return ClosedPose(rounded[1], ROUNDED, Nearest(len(tried), len(near), distance(rounded[1])))
    if not poses:
        raise open_loop(numbers, task, tried)

    regular = sorted((closed for _, closed in _regular(numbers, poses)), key=distance)
    nearest = min((_slide_nearer(numbers, q, closed) for closed in regular[:NEAREST]), key=distance)
    return ClosedPose(nearest, CLOSED, Nearest(len(tried), len(poses), distance(nearest)))


def _slide_nearer(numbers: Numbers, q: Array, closed: Array) -> Array:
    """Return the configuration nearest to q that the closed mechanism moves to, short of singular ones.

    Steps go along the freedoms, Psi n = 0, as far as they lessen the distance; Newton's closes the loops again.
    """

    def regularity(q: Array) -> float:
        sigma = np.linalg.svd(numbers.psi(q) * lengths / numbers.sizes[:, None], compute_uv=False)
        return float(sigma[kept - 1] / sigma[0]) if kept else 1.0

    lengths, step = numbers.lengths, 1.0
    kept = rank(numbers.psi(closed), RANK_TOLERANCE)
    least = min(regularity(closed), REGULAR)
    away = numbers.manifold.difference(closed, q) / lengths
    for _ in range(SLIDES):
        freedoms = np.linalg.svd(numbers.psi(closed) * lengths / numbers.sizes[:, None])[2][kept:]
        along = freedoms.T @ (freedoms @ away)
        if np.linalg.norm(along) < 1e-8 or step < 1e-3:
            break
        bounded = min(step, MOST_STEP / np.abs(along).max())
        trial, residual = newton(numbers, numbers.step(closed, bounded * along * lengths), range(numbers.nv))
        there = numbers.manifold.difference(trial, q) / lengths
        nearer = residual <= CLOSED and not numbers.turned(trial) and there @ there < away @ away
        if nearer and regularity(trial) >= least:
            closed, away, step = trial, there, min(1.0, 2.0 * step)
        else:
            step *= 0.5
    return closed


def _close_from(
    numbers: Numbers, q: Array, task: Closable, starts: list[Array], tolerance: float = CLOSED
) -> tuple[list[Pose], list[Pose]]:
    """Return (distance from q, configuration) of the starts that close, and (residual, configuration) of every
    start."""
    cut = ROUNDED if tolerance == ROUNDED else CUT
    poses, tried = [], []
    for start in starts:
        if task.missing:  # first the unknown coordinates alone, so that the given ones pick the branch
            start, _ = newton(numbers, start, task.missing, cut=cut)
        closed, residual = newton(numbers, start, task.free, cut=cut)
        tried.append((residual, closed))
        if residual > tolerance or numbers.turned(closed):
            continue
        poses.append(_wrapped(numbers, q, task, closed, tolerance))
    return poses, tried


def _descend_from(
    numbers: Numbers, q: Array, task: Closable, starts: list[Array]
) -> tuple[list[Pose], list[Pose]]:
    """Return the same by damped steps on rotation vectors, from each start; Newton's make the end exact."""
    aligned = Aligned(numbers)
    poses, tried = [], []
    for start in starts:
        near, left = descend(aligned, start, task.free, aligned.sizes)
        tried.append((left, near))
        if left < NEARLY:
            closed, residual = newton(numbers, near, task.free)
            if residual <= CLOSED and not numbers.turned(closed):
                poses.append(_wrapped(numbers, q, task, closed))
    return poses, tried


def _wrapped(numbers: Numbers, q: Array, task: Closable, closed: Array, tolerance: float = CLOSED) -> Pose:
    """Return the distance from q and the configuration with missing angles within half a turn."""
    given = [k for k in range(numbers.nv) if k not in task.missing]
    wrapped = closed.copy()
    wrapped[task.turning] = (closed[task.turning] + np.pi) % (2 * np.pi) - np.pi
    if np.abs(numbers.relative(wrapped)).max() <= tolerance:
        closed = wrapped
    moved = np.abs(numbers.manifold.difference(q, closed)) / numbers.lengths
    distance = moved[given].sum() + 1e-6 * moved[task.missing].sum()
    # rounded, so that rounding errors do not choose between equal distances
    return float(f"{distance:.9g}"), closed

"""The closed configuration nearest to a start, or to q = 0 where no start is given."""

from __future__ import annotations

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.closing.descent import Aligned, Drawn, descend, starts_around
from robodyn_cli.solve.closing.open_loops import Closable, open_loop, refuse_turned
from robodyn_cli.solve.closure import CLOSED, CUT, MOST_STEP, ROUNDED, Numbers, newton, rank
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.spatial.algebra import Array

NEAREST = 4  # closed configurations that are moved nearer
FEW = 8  # random starts of damped steps at each distance
PULL = 0.1  # of starts far off to q = 0, beside the loops; less forgets it, more stays where no loop closes
DRAWN = 16  # starts far off
NEARLY = 1e-4  # rad, or part of the size, that Newton's steps, or rounding, may account for
SLIDES = 60  # steps towards the nearest configuration at most
ARRIVED = 1e-11  # rad, or part of the size, that it may be left along the freedoms
UNSURE = 1e-14  # part of the square of a distance that rounding may account for
MOST_STRETCH = 8.0  # of a step over the way that is left
REGULAR = 1e-2  # ratio of singular values down to which the nearest configuration is approached
LOST = 0.5  # part of the first ratio that may be lost where it is less than that

SPREADS = (0.3, 1.0, np.pi)  # of starts further and further from values that lead nowhere

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
    starts = first_starts(numbers, q, task.missing)
    poses, tried = _close_from(numbers, q, task, starts)
    refuse_turned(numbers, task, q, tried[0][1], tried[0][0])
    near = [start for start, (left, _) in zip(starts, tried) if left < NEARLY]
    exact = _regular(numbers, poses)[0] if poses else None
    if exact is None or _hides_dependence(numbers, exact[1]):
        # exact steps may go far along what is no row but for rounding, and come near nothing
        rounded = _close_rounded(numbers, q, task, near or starts)
        if rounded and (exact is None or _spends_freedom(numbers, exact, rounded)):
            # a pose that is given whole, and closed as well as such rows may be, stays what it is
            whole = not task.missing and np.abs(numbers.relative(q)).max() <= ROUNDED
            return ClosedPose(q if whole else rounded[1], ROUNDED)
    if not poses:
        aligned = Aligned(numbers)
        for seed, spread in enumerate((0.0, *SPREADS), start=20):
            around = starts_around(numbers, q, task.free, spread, seed, FEW if spread else 1)
            descended, further = _descend_from(aligned, q, task, around)
            tried += further
            if descended:
                break
        else:
            raise open_loop(numbers, task, tried)
        for around in further_starts(numbers, q, task.free):
            if not poses:
                poses, more = _close_from(numbers, q, task, around)
                tried += more
        poses = poses or [pose for pose in descended if not _far(numbers, q, pose[1], task)]
    if not poses:
        raise open_loop(numbers, task, tried)
    return ClosedPose(_regular(numbers, poses)[0][1])


def first_starts(numbers: Numbers, q: Array, missing: list[int]) -> list[Array]:
    """Return where closing starts first: at q, and where coordinates are missing, anywhere in these."""
    return [q, *starts_around(numbers, q, missing, np.pi, 1)]


def further_starts(numbers: Numbers, q: Array, free: list[int]) -> list[list[Array]]:
    """Return where it starts if nothing closes there, stage by stage."""
    return [starts_around(numbers, q, free, spread, seed) for seed, spread in enumerate(SPREADS, start=2)]


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
    return rank(psi) > rank(psi, ROUNDED) or rounded[0] < exact[0] - ROUNDED


def _close_rounded(numbers: Numbers, q: Array, task: Closable, starts: list[Array]) -> Pose | None:
    """Return the nearest configuration with redundant rows that contradict each other by rounding in the data, if the
    starts lead to one; first where these rows stay redundant nearby, since far off rounding may look like a row."""
    poses = [
        pose
        for pose in _close_from(numbers, q, task, starts, ROUNDED)[0]
        if rank(numbers.psi(pose[1]), ROUNDED) < len(numbers.rows)
    ]
    nearest = sorted(poses, key=lambda pose: pose[0])
    lasting = (pose for pose in nearest if _hides_dependence(numbers, pose[1]))
    # what is weaker than NEARLY is rounding in the data, which may look like a rank
    return next(lasting, None) or (_regular(numbers, poses, NEARLY)[0] if poses else None)


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
    aligned = Aligned(numbers)
    for seed, spread in enumerate((0.0, 0.3, 1.0, np.pi), start=20):
        if spread == np.pi and poses:
            break
        around = starts_around(numbers, q, task.free, spread, seed, FEW if spread else 1)
        if spread == 1.0:
            drawn = Drawn(aligned, q, PULL)
            far = starts_around(numbers, q, task.free, spread, seed, DRAWN)
            around = [descend(drawn, start, task.free, drawn.sizes)[0] for start in far]
        closed, more = _descend_from(aligned, q, task, around)
        poses, tried, starts = poses + closed, tried + more, starts + around
    if not poses or _hides_dependence(numbers, _regular(numbers, poses)[0][1]):
        near = [start for start, (left, _) in zip(starts, tried) if left < NEARLY]
        if rounded := _close_rounded(numbers, q, task, near):
            nearest = _slide_nearer(numbers, q, rounded[1], ROUNDED)
            return ClosedPose(nearest, ROUNDED, Nearest(len(tried), len(near), distance(nearest)))
    if not poses:
        raise open_loop(numbers, task, tried)

    regular = sorted((closed for _, closed in _regular(numbers, poses)), key=distance)
    nearest = min((_slide_nearer(numbers, q, closed) for closed in regular[:NEAREST]), key=distance)
    return ClosedPose(nearest, CLOSED, Nearest(len(tried), len(poses), distance(nearest)))


def _slide_nearer(numbers: Numbers, q: Array, closed: Array, tolerance: float = CLOSED) -> Array:
    """Return the configuration nearest to q that the closed mechanism moves to, short of singular ones.

    Steps go along the freedoms, Psi n = 0, as far as the distance bends (Barzilai and Borwein 1988); Newton's close the
    loops again.
    """

    def look(there: Array) -> tuple[Array, Array, float]:
        """Return the way to q, its part along the freedoms, and the ratio of singular values."""
        _, sigma, Vt = np.linalg.svd(numbers.psi(there) * lengths / numbers.sizes[:, None])
        away, freedoms = numbers.manifold.difference(there, q) / lengths, Vt[kept:]
        return away, freedoms.T @ (freedoms @ away), float(sigma[kept - 1] / sigma[0]) if kept else 1.0

    lengths, step = numbers.lengths, 1.0
    kept = rank(numbers.psi(closed), ROUNDED if tolerance == ROUNDED else RANK_TOLERANCE)
    cut = ROUNDED if tolerance == ROUNDED else CUT
    away, along, regularity = look(closed)
    least = min(LOST * regularity, REGULAR)
    for _ in range(SLIDES):
        if np.linalg.norm(along) < ARRIVED or step < 1e-3:
            break
        moved = min(step, MOST_STEP / np.abs(along).max()) * along
        trial, residual = newton(numbers, numbers.step(closed, moved * lengths), range(numbers.nv), cut=cut)
        there, left, regularity = look(trial)
        gained = away @ away - there @ there
        # where rounding hides whether the distance lessens, its slope has to
        nearer = gained > 0.0 if abs(gained) > UNSURE * (away @ away) else left @ left < along @ along
        if nearer and residual <= tolerance and regularity >= least and not numbers.turned(trial):
            bend = moved @ (along - left)
            step = min(moved @ moved / bend, MOST_STRETCH) if bend > 0.0 else 1.0
            closed, away, along = trial, there, left
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
    aligned: Aligned, q: Array, task: Closable, starts: list[Array]
) -> tuple[list[Pose], list[Pose]]:
    """Return the same by damped steps on rotation vectors, from each start; Newton's make the end exact."""
    numbers = aligned.numbers
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

"""Mobility of a mechanism, by counting and by rank; singular configurations told apart: dead point of the input,
bifurcation, neither.

Dead point: Psi keeps its rank, its block of passive coordinates loses it; the input cannot move the mechanism.
Bifurcation: Psi itself loses rank; the constraints no longer decide how the motion goes on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.algorithms.constraints import determinant
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError, SingularConfigurationError
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.formulations.independent import RowCombinations
from robodyn_cli.record import record
from robodyn_cli.solve import closure
from robodyn_cli.solve.closure import RANK as RANK_TOLERANCE
from robodyn_cli.solve.closure import counted_rank, rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.assemble import Mobility
from robodyn_cli.summaries.facts import ABSENT, Absent

RANK = 1e-6  # ratio of singular values below which a located pose counts as having lost rank
REDUCED = 1e-9  # ratio of singular values that counts as zero where coordinates are chosen
DECOMPOSED = 1e-14  # of the largest singular value: what rounding leaves of each
ROUNDED = 16.0  # roundings of 1 in an equation of a pose
START = 1e-9  # the same at the start of a deployment, which only rounding may part from a dead point


@record
class Singularity:
    """What kind of configuration it is, and the singular values that say so (largest first)."""

    kind: str
    psi: Array
    passive: Array


@record
class Culprit:
    """The joint that moves most, and the closure that resists least, in the direction in which rank is lost."""

    joint: str
    loop: str


def culprit(problem: Problem, q: Array, columns: Sequence[int], t: float = 0.0) -> Culprit:
    """Return joint and closure of the smallest singular value of the loops' Psi in some velocity coordinates."""
    psi = psi_at(problem, q, t)[:, list(columns)]
    U, _, Vt = np.linalg.svd(psi)
    column = columns[int(np.argmax(np.abs(Vt[min(psi.shape) - 1])))]
    row = problem.constraints.loop_rows[int(np.argmax(np.abs(U[:, min(psi.shape) - 1])))]
    return Culprit(problem.model.joint_of(column), row.closure)


def passive_determinant(problem: Problem, passive: Sequence[int]) -> Scalar:
    """Return the determinant of the passive block of Psi, whose sign change is a dead point.

    Raises
    ------
    CapabilityError : the block is not square, so the input does not determine the configuration.
    """
    rows = problem.loop_psi
    if len(passive) != len(rows):
        freedom = problem.model.nv - len(rows)
        other = "" if problem.scene.deploy.latches else ", or use deploy.criterion: multipliers"
        raise CapabilityError(
            f"a dead point needs as many driven joints as degrees of freedom: the mechanism has {freedom}, and "
            f"{problem.model.nv - len(passive)} joints are actuated or prescribed; set `actuated`"
            f"{other}",
            key="actuated",
        )
    value: Scalar = determinant(rows[:, list(passive)])
    return value


def psi_at(problem: Problem, q: Array, t: float = 0.0) -> Array:
    """Return Psi of the loops at a configuration, as numbers."""
    return problem.numbers(problem.psi[problem.constraints.of_loops], q, t)


def driven_dead_point(
    problem: Problem, passive: Sequence[int], q: Array, time: float, duration: float
) -> tuple[float, Array, str, float] | None:
    """Find the singular pose that a prescribed motion has run into at (q, time): its time, q, kind, error of the time.

    Towards it the passive rates grow without bound, so no integrator can reach it; but it is pure geometry:
    eta(q, t) = 0 with the determinant of the passive block zero, in the unknowns q and t.
    """
    if not problem.constraints.prescribed or not np.all(np.isfinite(q)):
        return None
    try:
        singular = passive_determinant(problem, passive)
    except CapabilityError:
        return None
    unknowns: list[Expr] = [*problem.q, problem.t]
    equations = [*problem.independent_rows.eta, singular]
    if len(equations) != len(unknowns):
        return None
    rows = jacobian(equations, unknowns)
    entries = [[row.get(k, 0.0) for k in range(len(unknowns))] for row in rows]
    p = RowCombinations(problem).choose(time, q, None) if problem.dependent else None
    x = np.append(q, time)
    for _ in range(50):
        here = x[:-1], float(x[-1])
        residual, J = problem.numbers(equations, *here, p=p), problem.numbers(entries, *here, p=p)
        if not np.all(np.isfinite(J)) or not np.all(np.isfinite(residual)):
            return None
        step, *_ = np.linalg.lstsq(J, -residual, rcond=1e-14)
        x = x + step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-300))
        if float(np.abs(step).max()) < 1e-14 * max(1.0, float(np.abs(x).max())):
            break
    ahead = float(x[-1]) - time
    if not np.all(np.isfinite(x)) or np.abs(residual).max() >= 1e-9:
        return None
    if not -1e-9 * max(1.0, time) <= ahead <= 1e-3 * max(duration, time):
        return None
    left = np.abs(residual) + ROUNDED * np.finfo(float).eps * np.abs(J) @ np.abs(x)
    off = float(np.abs(np.linalg.pinv(J)[-1]) @ left + np.abs(step[-1]))
    return float(x[-1]), x[:-1], classify(problem, x[:-1], passive).kind, off


def classify(problem: Problem, q: Array, passive: Sequence[int]) -> Singularity:
    """Return the kind of configuration: ``bifurcation``, ``dead_point`` or ``regular``."""
    psi, count = psi_at(problem, q), problem.loop_rank
    if not count:
        return Singularity("regular", np.zeros(0), np.zeros(0))
    whole = np.linalg.svd(psi, compute_uv=False)[:count]
    block = np.linalg.svd(psi[:, list(passive)], compute_uv=False)[:count] if len(passive) else np.zeros(0)
    if whole[-1] < RANK * whole[0]:
        return Singularity("bifurcation", whole, block)
    if len(block) and block[-1] < RANK * whole[0]:
        return Singularity("dead_point", whole, block)
    return Singularity("regular", whole, block)


def refuse_dependent_rows(problem: Problem, q: Array, time: float) -> None:
    """Tell a loss of rank of the rows that were kept, of redundant ones, from one of the loops themselves.

    Raises
    ------
    NumericalError : the loops keep their rank; other rows would have to be kept from here on.
    """
    if problem.keep_rows is None:
        return
    every = Problem(problem.scene, model=problem.model)
    rows = problem.constraints.loop_rows
    if rank(psi_at(every, q, time), RANK) < len(rows):
        return
    kept = ", ".join(row.name for row in rows)
    raise NumericalError(
        f"the constraints kept of redundant ones ({kept}) come to depend on each other at t = {time:.9g} s, although "
        "the loops do not lose rank; start closer to that configuration, or model the loop in its plane",
        time=time, status="dependent_rows",
    )  # fmt: skip


def is_dead_point(problem: Problem, q: Array, passive: Sequence[int], within: float) -> bool:
    """Tell whether the passive block is singular at q: its smallest singular value over the largest of Psi is below
    ``within``, which is about the angle [rad] to the dead point. Rows between driven joints alone are none of it.
    """
    if not len(passive) or not problem.constraints.rows:
        return False
    psi = psi_at(problem, q)
    block = psi[:, list(passive)]
    count = problem.loop_rank - rank(psi[~block.any(axis=1)])
    sigma = np.linalg.svd(block, compute_uv=False)[:count]
    return bool(len(sigma) and sigma[-1] < within * np.linalg.norm(psi, 2))


def refuse_singular_start(problem: Problem, q: Array, passive: Sequence[int]) -> None:
    """Raise if a deployment would start where it is to end: the determinant there is rounding noise.

    Raises
    ------
    SingularConfigurationError : the start is a dead point.
    """
    if not is_dead_point(problem, q, passive, START):
        return
    angles = ", ".join(f"{n} {x:.6g}" for n, x in zip(problem.model.q_names, q))
    raise SingularConfigurationError(
        f"the start is a dead point already ({angles}): its passive block of Psi is singular, so the input cannot "
        "move the mechanism; start a little away from it (initial.q)",
        key="initial.q",
        kind="dead_point",
        q=q.tolist(),
    )


def rank_tolerance(problem: Problem, q: Array, t: float = 0.0) -> float:
    """Return the ratio of singular values below which rows depend on each other where the loops are closed at q (nq,):
    larger where what they lack is rounding in the data."""
    eta = problem.numbers([row.eta for row in problem.constraints.loop_rows], q, t)
    return float(rank_tolerances(problem, np.abs(eta).max(initial=0.0)))


def rounded_rank(problem: Problem, q: Array) -> float:
    """Return the ratio of singular values of Psi at q (nq,), which is one of rounding alone where the loops close."""
    eta = problem.numbers([row.eta for row in problem.constraints.loop_rows], q)
    return float(closure.rank_tolerances(problem.model, np.abs(eta).max(initial=0.0), REDUCED))


def rank_tolerances(problem: Problem, gap: Array) -> Array:
    """Return the same where the loops are open by ``gap`` (T,), rad or m."""
    return closure.rank_tolerances(problem.model, gap, RANK_TOLERANCE)


def mobility(
    problem: Problem, sigma: Array, tolerance: float = RANK_TOLERANCE, off: Array | None = None
) -> Mobility:
    """Return degrees of freedom by Gruebler's count and by the rank of the loops' Psi.

    sigma : its singular values in a pose (k,), or in several (T, k), largest first.
    count : velocity coordinates of the tree less all rows of the closures, as Gruebler and Kutzbach count links
    and joints in space (6 (n - 1) - sum of the joints' constraints). planar_count : less only the rows that do not
    vanish identically, which for a mechanism in a plane is 3 (n - 1) - 2 j. actual : less the rank, which counts
    singular values above ``tolerance`` times the largest. Of one pose the values beside that bound are told, too, with
    their errors where those of the entries of Psi are known: off (m, nv).
    """
    nv, rows = problem.model.nv, len(problem.constraints.of_loops)
    vanishing = len(problem.constraints.dropped)
    independent = counted_rank(sigma, tolerance)
    relative = sigma / max(sigma.max(initial=0.0), 1e-300) if sigma.ndim == 1 else np.empty(0)
    kept = float(relative[independent - 1]) if 0 < independent <= len(relative) else ABSENT
    dropped = float(relative[independent]) if independent < len(relative) else ABSENT
    return Mobility(
        coordinates=nv,
        rows=rows + vanishing,
        vanishing_rows=vanishing,
        rank=independent,
        redundant_rows=rows - independent,
        count=nv - rows - vanishing,
        planar_count=nv - rows,
        actual=nv - independent,
        rank_tolerance=tolerance,
        smallest_kept=kept,
        largest_dropped=dropped,
        smallest_kept_error=_off_ratio(kept, sigma, off),
        largest_dropped_error=_off_ratio(dropped, sigma, off),
    )


def _off_ratio(ratio: float | Absent, sigma: Array, off: Array | None) -> float | Absent | None:
    """Return how far a ratio of a singular value to the largest may be off: no singular value changes by more than the
    norm of what the matrix changes by (Weyl 1912)."""
    if isinstance(ratio, Absent):
        return ABSENT
    return None if off is None else off_ratio(ratio, sigma, off)


def off_ratio(ratio: float, sigma: Array, off: Array) -> float:
    """Return the same of singular values (k,) of a matrix whose entries are off by (m, n)."""
    largest = float(sigma.max(initial=0.0))
    change = float(np.linalg.norm(off)) + DECOMPOSED * largest
    return change * (1.0 + ratio) / (largest - change) if largest > 2.0 * change else 1.0

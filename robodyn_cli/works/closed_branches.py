"""The ways in which loops close while some joints stay where they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.given.loop_conditions import LoopConditions
from robodyn_cli.observe.units import JointColumns
from robodyn_cli.ready.closed_errors import ErrorsOfClosing, largest_of
from robodyn_cli.ready.singularity import DECOMPOSED, off_ratio
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.solve.closing.descent import Aligned, descend
from robodyn_cli.solve.closing.search import halton, search
from robodyn_cli.solve.closure import SLOW, Numbers, newton, rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.assemble import BranchSearch, ClosedBranch

SINGULAR = 1e-7  # smallest over largest singular value below which a determinant has no sign


@record
class Branches:
    """Configurations (nq,) that close, the initial one first, and their records in the summary."""

    problem: Problem
    configurations: list[Array]
    described: list[ClosedBranch]
    search: BranchSearch

    def add_to(self, result: Result) -> None:
        """Add configurations, determinants and outlines to a result."""
        model = self.problem.model
        columns = JointColumns(model.q_names, model.q_units, ("branch", "joint"))
        result.add("branches/q", np.array(self.configurations), **columns.described())
        determinants = [branch.determinant for branch in self.described]
        if None not in determinants:
            result.add("branches/determinant", np.array(determinants, dtype=float))
        for name, outline in model.outlines.items():
            corners = [self.problem.world_point(corner) for corner in outline]
            drawn = [self.problem.numbers(corners, q) for q in self.configurations]
            result.add(f"branch_skeleton/{name}", np.array(drawn))


def find_branches(problem: Problem, errors: ErrorsOfClosing, q: Array, held: tuple[str, ...]) -> Branches:
    """Return the ways in which the loops close with the held joints where they are at q (nq,).

    errors : of configurations that close the loops.

    Raises
    ------
    CapabilityError : see ``refuse_freedom``.
    """
    model, free, conditions = problem.model, _free(problem, held), errors.conditions
    angles = [unit == "rad" for unit in model.q_units]
    cosines = Evaluator([row.cosine for row in problem.constraints.rows])

    def signature(q: Array) -> Array:
        turns = np.concatenate([np.where(angles, np.cos(q), q), np.where(angles, np.sin(q), 0.0)])
        return np.concatenate([turns, *(_attitude(b, q) for b in model.bodies if b.joint.quasi)])

    def closed_as_meant(q: Array) -> bool:
        return bool(np.all(np.array(cosines({"q": q.tolist(), "t": [0.0], "p": []}), dtype=float) > 0.5))

    aligned = Aligned(Numbers(problem, problem.at_start))

    def close(start: Array) -> tuple[Array, float]:
        if len(aligned.rotated):  # sines of attitudes vanish at half a turn, too, and lead there
            start, _ = descend(aligned, start, free, aligned.sizes)
        return newton(conditions, start, free, SLOW)

    starts = chain([q], _starts(problem, conditions, q, free, held))
    closures = search(close, starts, signature, closed_as_meant)
    first, *others = closures.found
    configurations = [first, *(_within_a_turn(x, angles) for x in others)]
    described = [_describe(problem, errors, x, free, k == 0) for k, x in enumerate(configurations)]
    searched = BranchSearch(closures.starts, closures.closed, len(described))
    return Branches(problem, configurations, described, searched)


def _within_a_turn(q: Array, angles: Sequence[bool]) -> Array:
    """Return a configuration whose angles are between half a turn and minus that; those that are stay as they are."""
    return np.where(angles & (np.abs(q) > np.pi), (q + np.pi) % (2 * np.pi) - np.pi, q)


def _attitude(body: Any, q: Array) -> Array:
    """Return the products of a quasi-velocity joint's coordinates: the same for a quaternion and its negative."""
    own = q[body.q : body.q + body.joint.nq]
    return np.outer(own, own).ravel()


def _free(problem: Problem, held: tuple[str, ...]) -> list[int]:
    """Return the velocity coordinates of joints that are not held."""
    return [b.v + j for b in problem.model.bodies if b.joint_name not in held for j in range(b.joint.nv)]


def refuse_freedom(problem: Problem, conditions: LoopConditions, q: Array, held: tuple[str, ...]) -> None:
    """Refuse a mechanism that closes in infinitely many ways.

    Raises
    ------
    CapabilityError
    """
    _, J = conditions.at(q, 0.0)
    free = _free(problem, held)
    left = len(free) - rank(J[problem.constraints.of_loops][:, free])
    if left > 0:
        raise CapabilityError(
            f"with {', '.join(held) or 'nothing'} held the mechanism keeps {left} degrees of freedom, so it closes in "
            f"infinitely many ways; hold {left} more joints (initial.hold, or --at) to find its branches"
        )


def _starts(
    problem: Problem, conditions: LoopConditions, q: Array, free: Sequence[int], held: tuple[str, ...]
) -> Iterator[Array]:
    """Yield configurations to begin with: points of Halton's sequence, mapped to motions of the free coordinates."""
    model, columns = problem.model, list(free)
    neutral = np.array(q)
    for body in model.bodies:
        if body.joint_name not in held:
            neutral[body.q : body.q + body.joint.nq] = body.joint.neutral()
    reach = np.where(conditions.lengths[columns] == 1.0, np.pi, 1.5 * conditions.size)
    for point in halton(problem.scene.assemble.starts - 1, len(columns)):
        dq = np.zeros(model.nv)
        dq[columns] = (2.0 * point - 1.0) * reach
        yield conditions.step(neutral, dq)


def _describe(
    problem: Problem, errors: ErrorsOfClosing, q: Array, free: Sequence[int], chosen: bool
) -> ClosedBranch:
    F, J = errors.conditions.at(q, 0.0)
    found, own = errors.of_configuration(q, free), np.ix_(problem.constraints.of_loops, list(free))
    block = J[own]
    s = np.linalg.svd(block, compute_uv=False)
    ratio = float(s[-1] / s[0]) if len(s) else 1.0
    determinant, off = _determinant(block, s, np.array([x[own] for x in found.beside[1]]))
    orientation = None if determinant is None else int(np.sign(determinant)) if ratio > SINGULAR else 0
    configuration, errors_here = (dict(zip(problem.model.q_names, x.tolist())) for x in (q, found.q))
    return ClosedBranch(
        configuration, determinant, off, orientation, ratio, off_ratio(ratio, s, found.J[own]) if len(s) else 0.0,
        float(np.abs(F).max(initial=0.0)), chosen, errors_here,
    )  # fmt: skip


def _determinant(block: Array, sigma: Array, beside: Array) -> tuple[float | None, float | None]:
    """Return the determinant of a square block with some singular values, and its error.

    beside : the block (draw, n, n) of what rounding makes of the configuration, enlarged.
    """
    if block.shape[0] != block.shape[1]:
        return None, None
    value = float(np.linalg.det(block))
    changed = largest_of(np.linalg.det(beside)[:, None] - value)
    return value, float(changed[0]) + DECOMPOSED * len(sigma) * float(sigma[:1].prod() * sigma[:-1].prod())

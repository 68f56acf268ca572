"""Close the loops of a mechanism: positions, rates, accelerations, and the ways in which they close while some joints
stay where they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from robodyn_cli.algorithms.bands import singular_values
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.rebuild import Evaluator, Values
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led
from robodyn_cli.given.prescribed import check_prescribed
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.observe import add_sample
from robodyn_cli.observe.units import JointColumns
from robodyn_cli.ready.closed_errors import ErrorsOfClosing
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.ready.prepare import held_columns, initial_positions, passive_coordinates
from robodyn_cli.ready.singularity import mobility
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.assembly import assemble as close_loops
from robodyn_cli.solve.closing.descent import Aligned, descend
from robodyn_cli.solve.closing.nearest import ClosedPose
from robodyn_cli.solve.closing.rates import RatesByLoops
from robodyn_cli.solve.closing.search import halton, search
from robodyn_cli.solve.closure import RANK, SLOW, Numbers, newton, rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.assemble import (
    AssembleErrors,
    AssembleSummary,
    BranchSearch,
    ClosedBranch,
    NearestClosure,
    UndrivenFreedoms,
)
from robodyn_cli.summaries.facts import ABSENT, Absent, LoopResidual, Termination
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.trajectories.led import position_columns

COUPLED = 1e-9  # entries of a projector that are no rounding
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
    block = J[problem.constraints.of_loops][:, list(free)]
    s = np.linalg.svd(block, compute_uv=False)
    ratio = float(s[-1] / s[0]) if len(s) else 1.0
    determinant = float(np.linalg.det(block)) if block.shape[0] == block.shape[1] else None
    orientation = None if determinant is None else int(np.sign(determinant)) if ratio > SINGULAR else 0
    configuration, off = (
        dict(zip(problem.model.q_names, x.tolist())) for x in (q, errors.of_positions(q, free))
    )
    return ClosedBranch(
        configuration, determinant, orientation, ratio, float(np.abs(F).max(initial=0.0)), chosen, off
    )


@record
class Closed:
    """A closed state: q (nq,), v and v-dot (nv,) of least norm.

    F : residuals of positions (m,). J : (m, nv). rates, accelerations : residuals of these levels (m,). redundant :
    rows that follow from others. rule : how v followed, None of loops that bind nothing.
    """

    problem: Problem
    conditions: LoopConditions
    q: Array
    v: Array
    a: Array
    F: Array
    J: Array
    rates: Array
    accelerations: Array
    redundant: tuple[str, ...]
    closure: ClosedPose
    rule: RatesByLoops | None

    @property
    def cut(self) -> float:
        """Ratio of singular values below which rank is lost."""
        return max(RANK, self.closure.cut)

    @cached_property
    def errors_of(self) -> ErrorsOfClosing:
        """The errors of configurations and states that close these loops."""
        return ErrorsOfClosing(self.conditions, self.cut)

    def errors(self) -> AssembleErrors:
        """Return the errors of the state, by coordinate."""
        model, state = self.problem.model, (self.q, self.v, self.a)
        if self.rule is None:
            of_state = tuple(np.zeros_like(x) for x in state)
        else:
            of_state = self.errors_of.of_state(*state, self.rule)
        names = (model.q_names, model.v_names, model.v_names)
        return AssembleErrors(*(dict(zip(own, x.tolist())) for own, x in zip(names, of_state)))


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
def assemble(scene: Scene, *, progress: Progress = no_progress, watch: Stopwatch | None = None) -> Result:
    """Close the loops at t = 0 at position, velocity and acceleration level.

    Rates that are not given, and accelerations, are those of least norm that the constraints allow.

    Returns
    -------
    A Result of one sample, and of all branches that were found where ``assemble.branches`` asks for them; held and
    solved coordinates, residuals and mobility in the summary.

    Raises
    ------
    CapabilityError : no loops, or branches of a mechanism that may still move. GeometryError : a loop cannot close;
    which, and by how much. SingularConfigurationError : the constraints lose rank there.
    """
    watch = watch or Stopwatch()
    closed = closed_loops(scene, watch)
    held, branches = held_joints(scene), None
    if scene.assemble.branches:
        with watch.stage("branches"):
            branches = find_branches(closed.problem, closed.errors_of, closed.q, held)
    progress(0.0, 0.0)
    result = Result.of("assemble", scene)
    add_sample(result, closed.problem, closed.q, closed.v, closed.a)
    if branches is not None:
        branches.add_to(result)
    result.summarise(summarise(closed, held, branches), seconds=watch.report())
    refuse_result(result)
    return result


def closed_loops(scene: Scene, watch: Stopwatch) -> Closed:
    """Return the state in which the loops of a scene are closed at t = 0.

    Raises
    ------
    RobodynError : see ``assemble``.
    """
    if not scene.loops and not scene.couplers:
        from robodyn_cli.scene.mjcf.compiled import HELD

        held = "".join(f"; {note}" for note in scene.notes if HELD in note)
        raise CapabilityError(f"assemble closes loops; this scene has none{held}", (scene.path,), key="loops")
    with watch.stage("equations"):
        problem = Problem(at_rest(scene))
    with watch.stage("assemble"):
        closed = close(problem)
    if scene.assemble.branches:
        refuse_freedom(problem, closed.conditions, closed.q, held_joints(scene))
    return closed


def held_joints(scene: Scene) -> tuple[str, ...]:
    """Return the joints that stay where they are."""
    return tuple(dict.fromkeys((*scene.initial.hold, *position_columns(scene.prescribed))))


def close(problem: Problem) -> Closed:
    """Return the state in which the loops are closed at t = 0."""
    scene = problem.scene
    given = initial_positions(scene, problem)
    check_prescribed(problem)
    stays = (*held_columns(scene, problem), *position_columns(scene.prescribed))
    state = close_loops(problem, given, dict(scene.initial.qd), stays)
    conditions = LoopConditions(problem, nothing_led(), np.zeros(1))
    F, J = conditions.at(state.q, 0.0)
    c, b = conditions.rates(state.q, state.v, 0.0)
    closure = state.closure or ClosedPose(state.q)
    a, *_ = np.linalg.lstsq(J, b, rcond=max(RANK, closure.cut))
    residuals = J @ state.v - c, J @ a - b
    return Closed(
        problem, conditions, state.q, state.v, a, F, J, *residuals, tuple(state.redundant), closure, state.rates
    )  # fmt: skip


def summarise(closed: Closed, held: tuple[str, ...], branches: Branches | None) -> AssembleSummary:
    """Return the summary of an assembly."""
    problem, nearest = closed.problem, closed.closure.nearest
    model, psi = problem.model, closed.J[problem.constraints.of_loops]
    tolerance = closed.cut
    return AssembleSummary(
        termination=Termination("closed", 0.0),
        samples=1,
        configuration=dict(zip(model.q_names, closed.q.tolist())),
        units=model.coordinate_units,
        rates=dict(zip(model.v_names, closed.v.tolist())),
        accelerations=dict(zip(model.v_names, closed.a.tolist())),
        held=list(held),
        solved=[name for name in model.joint_names if name not in held],
        residual=LoopResidual(
            *(float(np.abs(x).max(initial=0.0)) for x in (closed.F, closed.rates, closed.accelerations))
        ),
        residual_by_loop=_by_loop(problem, closed.F),
        error_estimate=closed.errors(),
        tolerance=closed.closure.tolerance,
        nearest=ABSENT
        if nearest is None
        else NearestClosure(nearest.starts, nearest.closed, nearest.distance),
        redundant_rows=list(closed.redundant),
        mobility=mobility(problem, singular_values(psi), tolerance),
        undriven=_undriven(problem, closed.J, tolerance),
        mass_condition=_mass_condition(closed, tolerance),
        branches=ABSENT if branches is None else branches.described,
        branch_search=ABSENT if branches is None else branches.search,
    )


def _by_loop(problem: Problem, F: Array) -> dict[str, float]:
    """Return the largest position residual of each loop."""
    largest: dict[str, float] = {}
    for i in problem.constraints.of_loops:
        loop = problem.constraints.rows[i].closure
        largest[loop] = max(largest.get(loop, 0.0), float(abs(F[i])))
    return largest


def _undriven(problem: Problem, J: Array, tolerance: float) -> list[UndrivenFreedoms] | Absent:
    """Return the freedoms of the passive coordinates, J v = 0, in parts that share no joint; absent if none is driven.

    Two coordinates belong together if the projector onto the freedoms couples them.
    """
    model, passive = problem.model, list(passive_coordinates(problem))
    if len(passive) == model.nv:
        return ABSENT
    motions = np.linalg.svd(J[:, passive])[2][rank(J[:, passive], tolerance) :]
    P = motions.T @ motions
    together = (np.abs(P) > COUPLED) | np.eye(len(P), dtype=bool)
    for _ in range(len(P).bit_length()):  # twice as many couplings in a row each time
        together = together @ together
    parts = []
    for row in np.unique(together, axis=0)[::-1] if passive else ():  # the part of the first coordinate first
        own = np.flatnonzero(row)
        if (count := round(float(np.trace(P[np.ix_(own, own)])))) > 0:
            joints = list(dict.fromkeys(model.joint_of(passive[j]) for j in own))
            parts.append(UndrivenFreedoms(count, joints))
    return parts


def _mass_condition(closed: Closed, tolerance: float) -> float | Absent:
    """Return the condition number of N^T M N, the inertia of the mechanism's freedoms N; absent without freedoms, with
    missing data, or where a freedom moves no mass."""
    motions = np.linalg.svd(closed.J)[2][rank(closed.J, tolerance) :]
    M = closed.problem.mass_matrix
    inputs = {"t": [0.0], "q": closed.q.tolist(), "p": closed.problem.at_start}
    known = Values(inputs).of(list(M.ravel()))
    if not len(motions) or any(x is None for x in known):
        return ABSENT
    sigma = np.linalg.svd(
        motions @ np.array(known, dtype=float).reshape(M.shape) @ motions.T, compute_uv=False
    )
    return float(sigma[0] / sigma[-1]) if sigma[-1] > 1e-15 * sigma[0] else ABSENT

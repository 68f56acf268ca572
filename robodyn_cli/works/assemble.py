"""Close the loops of a mechanism: positions, rates, accelerations, and the ways in which they close while some joints
stay where they are."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.algorithms.bands import singular_values
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.rebuild import Values
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led
from robodyn_cli.given.prescribed import check_prescribed
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.observe import add_sample
from robodyn_cli.ready.closed_errors import ErrorsOfClosing, OffClosed, largest_of
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.ready.prepare import held_columns, initial_positions, passive_coordinates
from robodyn_cli.ready.singularity import DECOMPOSED, mobility
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.assembly import assemble as close_loops
from robodyn_cli.solve.closing.nearest import ClosedPose
from robodyn_cli.solve.closing.rates import RatesByLoops
from robodyn_cli.solve.closure import RANK, rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.assemble import (
    AssembleErrors,
    AssembleSummary,
    NearestClosure,
    UndrivenFreedoms,
)
from robodyn_cli.summaries.facts import ABSENT, Absent, LoopResidual, Termination
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.trajectories.led import position_columns
from robodyn_cli.works.closed_branches import Branches, find_branches, refuse_freedom

COUPLED = 1e-9  # entries of a projector that are no rounding


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

    @cached_property
    def off(self) -> OffClosed:
        """The errors of the state."""
        if self.rule is None:
            q, v, a, J = map(np.zeros_like, (self.q, self.v, self.a, self.J))
            return OffClosed(q, v, a, J, (self.q[None], self.J[None]))
        return self.errors_of.of_state(self.q, self.v, self.a, self.rule)

    def errors(self) -> AssembleErrors:
        """Return the errors of the state, by coordinate."""
        model, off = self.problem.model, self.off
        named = (model.q_names, off.q), (model.v_names, off.v), (model.v_names, off.a)
        return AssembleErrors(*(dict(zip(names, x.tolist())) for names, x in named))


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
    inertia, off = _mass_condition(closed, tolerance)
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
        mobility=mobility(
            problem, singular_values(psi), tolerance, closed.off.J[problem.constraints.of_loops]
        ),
        undriven=_undriven(problem, closed.J, tolerance),
        mass_condition=inertia,
        mass_condition_error=off,
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


def _mass_condition(closed: Closed, tolerance: float) -> tuple[float | Absent, float | Absent]:
    """Return the condition number of N^T M N, the inertia of the mechanism's freedoms N, and its error; absent without
    freedoms, with missing data, or where a freedom moves no mass."""
    bound, none = rank(closed.J, tolerance), (ABSENT, ABSENT)
    if bound == closed.J.shape[1] or (M := _mass_matrix(closed.problem, closed.q)) is None:
        return none
    sigma = _inertias(closed.J, M, bound)
    if sigma[-1] <= 1e-15 * sigma[0]:
        return none
    if len(sigma) == 1:
        return 1.0, 0.0
    value = float(sigma[0] / sigma[-1])
    beside = [_inertias(J, _mass_matrix(closed.problem, q), bound) for q, J in zip(*closed.off.beside)]
    changed = largest_of(np.array([[x[0] / max(x[-1], 1e-300) - value] for x in beside]))
    rounded = DECOMPOSED * float(np.linalg.norm(M)) * (1.0 / sigma[0] + 1.0 / sigma[-1])
    return value, float(changed[0] + value * rounded)


def _mass_matrix(problem: Problem, q: Array) -> Any:
    """Return the mass matrix (nv, nv) at q (nq,); None with missing data."""
    M = problem.mass_matrix
    known = Values({"t": [0.0], "q": q.tolist(), "p": problem.at_start}).of(list(M.ravel()))
    return None if any(x is None for x in known) else np.array(known, dtype=float).reshape(M.shape)


def _inertias(J: Array, M: Array, bound: int) -> Array:
    """Return the singular values of M in the motions that J of some rank allows."""
    motions = np.linalg.svd(J)[2][bound:]
    return np.asarray(np.linalg.svd(motions @ M @ motions.T, compute_uv=False))

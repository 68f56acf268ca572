"""Close the loops of a mechanism: positions, rates, accelerations, branches."""

from __future__ import annotations

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led
from robodyn_cli.given.prescribed import check_prescribed
from robodyn_cli.observe.closing import add_sample
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.ready.mobility import mobility
from robodyn_cli.ready.prepare import held_columns, initial_positions
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.assembly import assemble as close_loops
from robodyn_cli.solve.closure import RANK
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, LoopResidual, Termination
from robodyn_cli.summaries.mechanism import AssembleSummary
from robodyn_cli.tools.progress import Progress, no_progress
from robodyn_cli.tools.stopwatch import Stopwatch
from robodyn_cli.trajectories.led import position_columns
from robodyn_cli.works.branches import Branches, find_branches, refuse_freedom


@record
class Closed:
    """A closed state: q (nq,), v and v-dot (nv,) of least norm.

    F : residuals of positions (m,). J : (m, nv). rates, accelerations : residuals of these levels (m,). redundant :
    rows that follow from others.
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
            branches = find_branches(closed.problem, closed.conditions, closed.q, held)
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
        raise CapabilityError(f"{scene.path}: assemble closes loops; this scene has none", key="loops")
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
    found = close_loops(problem, given, dict(scene.initial.qd), stays)
    conditions = LoopConditions(problem, nothing_led(), np.zeros(1))
    F, J = conditions.at(found.q, 0.0)
    c, b = conditions.rates(found.q, found.v, 0.0)
    a, *_ = np.linalg.lstsq(J, b, rcond=RANK)
    return Closed(
        problem, conditions, found.q, found.v, a, F, J, J @ found.v - c, J @ a - b, tuple(found.redundant)
    )


def summarise(closed: Closed, held: tuple[str, ...], branches: Branches | None) -> AssembleSummary:
    """Return the summary of an assembly."""
    problem = closed.problem
    model = problem.model
    return AssembleSummary(
        termination=Termination("closed", 0.0),
        samples=1,
        configuration=dict(zip(model.q_names, closed.q.tolist())),
        rates=dict(zip(model.v_names, closed.v.tolist())),
        accelerations=dict(zip(model.v_names, closed.a.tolist())),
        held=list(held),
        solved=[name for name in model.joint_names if name not in held],
        residual=LoopResidual(
            *(float(np.abs(x).max(initial=0.0)) for x in (closed.F, closed.rates, closed.accelerations))
        ),
        residual_by_loop=_by_loop(problem, closed.F),
        redundant_rows=list(closed.redundant),
        mobility=mobility(problem, closed.J[problem.constraints.of_loops]),
        branches=ABSENT if branches is None else branches.described,
        branch_search=ABSENT if branches is None else branches.search,
    )


def _by_loop(problem: Problem, F: Array) -> dict[str, float]:
    """Return the largest position residual of each loop."""
    found: dict[str, float] = {}
    for i in problem.constraints.of_loops:
        loop = problem.constraints.rows[i].closure
        found[loop] = max(found.get(loop, 0.0), float(abs(F[i])))
    return found

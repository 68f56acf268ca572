"""What comes before a run: equations, a consistent initial state, who drives what."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.ready.mass_matrix import braces, refuse_indefinite
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.assembly import Assembled, assemble
from robodyn_cli.solve.closure import rank
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.trajectories.led import position_columns, velocity_columns

if TYPE_CHECKING:
    from robodyn_cli.equations.constraints import Dependence
    from robodyn_cli.model.model import Model


@record
class Setup:
    """A scene made ready: equations, consistent initial state."""

    problem: Problem
    assembled: Assembled


def prepare(scene: Scene, watch: Stopwatch | None = None, neutral: bool = False) -> Setup:
    """Build the equations and close the loops at t = 0.

    Parameters
    ----------
    neutral : whether an open chain without initial positions may start in its neutral pose.

    Raises
    ------
    SceneError : an initial position is missing. GeometryError, SingularConfigurationError : from the assembly.
    """
    watch = watch or Stopwatch()
    with watch.stage("equations"):
        problem = _problem_of(scene) if scene.payloads else Problem(scene)
        if neutral and not problem.model.closures and not _positions_given(scene, problem):
            return Setup(problem, _neutral(problem))
        given = initial_positions(scene, problem)
        held = held_columns(scene, problem)
    with watch.stage("assemble"):
        if problem.constraints.rheonomic or (problem.model.forces and problem.elements.moving):
            from robodyn_cli.given.prescribed import check_prescribed

            check_prescribed(problem)
        hold = [*held, *(n for n in position_columns(scene.prescribed) if n not in held)]
        assembled = assemble(problem, given, dict(scene.initial.qd), hold)
        if scene.torques or scene.prescribed or scene.couplers or problem.model.forces or scene.control:
            from robodyn_cli.observe.formulas import check_formulas, check_formulas_ahead

            check_formulas(problem, assembled.q, assembled.v)
            if not assembled.redundant:
                check_formulas_ahead(problem, assembled.q, assembled.v)
        model = build_model(scene) if problem.model.switched else problem.model
        refuse_indefinite(scene, [assembled.q])
    with watch.stage("equations"):
        problem = solvable(problem, assembled, model)
    return Setup(problem, assembled)


def solvable(problem: Problem, assembled: Assembled, model: Model) -> Problem:
    """Return the equations with independent combinations of redundant rows, and with inertias along the rows where the
    opened tree's M has no inverse or a bad one; as they are where they need neither.

    Parameters
    ----------
    model : the bodies as they are at the start.

    Raises
    ------
    NumericalError : the closed mechanism has a motion that moves nothing with inertia.
    """
    needed = braces(problem, model, assembled.q)
    if not (assembled.redundant or needed):
        return problem
    groups = dependent_rows(problem, assembled) if assembled.redundant else ()
    keep = assembled.independent if assembled.redundant and not groups else None
    return Problem(problem.scene, keep_rows=keep, model=problem.model, dependent=groups, braces=needed)


def refuse_changes(scene: Scene, command: str) -> None:
    """Refuse payloads that are gripped or released, for commands that do not follow them.

    Raises
    ------
    CapabilityError
    """
    for k, payload in enumerate(scene.payloads):
        if payload.changes:
            raise CapabilityError(
                f"{command} does not follow masses that are gripped or released (here "
                f"{payload.name!r}); allowed: payloads without 'from' and 'until', and with them the commands "
                "simulate, inverse, work-precision, and deploy with latches",
                (scene.path, f"payloads.{k}"),
                key=f"payloads.{k}",
            )


def _problem_of(scene: Scene) -> Problem:
    from robodyn_cli.equations.payloads import switched_problem

    return switched_problem(scene)


def _positions_given(scene: Scene, problem: Problem) -> bool:
    given = {*scene.initial.q, *position_columns(scene.prescribed)}
    return given.issuperset(problem.model.q_names)


def _neutral(problem: Problem) -> Assembled:
    """Return the neutral pose of an open chain, at rest."""
    from robodyn_cli.model.manifold import Manifold

    q = Manifold(problem.model).neutral()
    return Assembled(q, np.zeros(problem.model.nv), 0.0, 0.0, (), ())


def held_columns(scene: Scene, problem: Problem) -> list[str]:
    """Return the coordinates of the joints in `initial.hold`."""
    return [column for name in scene.initial.hold for column in problem.model.q_columns(name)]


def initial_positions(scene: Scene, problem: Problem) -> dict[str, float]:
    """Return the positions at t = 0 that the scene gives, prescribed joints included, by coordinate.

    Raises
    ------
    SceneError : a position is missing.
    """
    given = dict(scene.initial.q)
    if scene.prescribed:
        from robodyn_cli.given.prescribed import prescribed_starts

        given |= prescribed_starts(scene)
    loops = bool(problem.model.closures)
    for name in held_columns(scene, problem) if loops else problem.model.q_names:
        if name not in given:
            why = (
                "`initial.hold` keeps it at its value" if loops else "an open chain needs one for each joint"
            )
            kind = "coordinate" if "." in name else "joint"
            raise SceneError(
                f"{kind} {name!r} has no initial position ({why})", (scene.path, "initial.q"),
                file=scene.path, key="initial.q",
            )  # fmt: skip
    return given


def passive_coordinates(problem: Problem) -> tuple[int, ...]:
    """Return the velocity coordinates that nothing drives; none without loops.

    Actuated are the joints of ``actuated`` (by default those in ``torques``) and prescribed ones.
    """
    scene, model = problem.scene, problem.model
    if not model.closures:
        return ()
    prescribed = velocity_columns(scene.prescribed)
    driven = {*scene.torques, *(() if scene.control is None else scene.control.joints), *prescribed}
    if scene.actuated is not None:
        driven = {*prescribed, *(x for name in scene.actuated for x in model.v_columns(name))}
    return tuple(k for k, name in enumerate(model.v_names) if name not in driven)


def dependent_rows(problem: Problem, assembled: Assembled) -> tuple[Dependence, ...]:
    """Return the rows that depend on each other at the start, loop by loop where they do so within loops.

    Empty where rows of loops depend on prescribed motions too: those cannot be combined.
    """
    from robodyn_cli.equations.constraints import Dependence

    constraints = problem.constraints
    loops = constraints.of_loops
    psi = problem.numbers(problem.psi, assembled.q)
    tolerance = assembled.closure.rank_tolerance if assembled.closure else RANK_TOLERANCE
    whole = rank(psi[loops], tolerance)
    if whole + len(constraints.prescribed) != len(assembled.independent):
        return ()
    names = constraints.names
    groups: dict[str, list[int]] = {}
    for i in loops:
        groups.setdefault(constraints.rows[i].closure, []).append(i)
    ranks = {loop: rank(psi[rows], tolerance) for loop, rows in groups.items()}
    if sum(ranks.values()) != whole:
        return (Dependence(tuple(names[i] for i in loops), whole),)
    return tuple(
        Dependence(tuple(names[i] for i in rows), ranks[loop])
        for loop, rows in groups.items()
        if ranks[loop] < len(rows)
    )

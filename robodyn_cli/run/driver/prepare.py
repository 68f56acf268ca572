"""What comes before a run: equations, a consistent initial state, who drives what, options of the integrator."""

from __future__ import annotations

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.record import mutable_record
from robodyn_cli.run.driver.mass_matrix import refuse_singular
from robodyn_cli.run.driver.redundancy import dependent_rows
from robodyn_cli.run.mechanism.prescribed import check_formulas, check_prescribed, prescribed_starts
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.assembly import Assembled, assemble


@mutable_record
class Setup:
    """A scene made ready: equations, consistent initial state."""

    problem: Problem
    assembled: Assembled
    watch: Stopwatch


def prepare(scene: Scene, watch: Stopwatch | None = None, modes: bool = False) -> Setup:
    """Build the equations and close the loops at t = 0.

    Parameters
    ----------
    modes : whether the caller follows the modes of joints (sticking, contact).

    Raises
    ------
    CapabilityError : there are joints with modes, and the caller does not follow them.
    SceneError : an initial position is missing. GeometryError, SingularConfigurationError : from the assembly.
    """
    watch = watch or Stopwatch()
    with watch.stage("equations"):
        problem = Problem(scene)
        if problem.gates and not modes:
            raise CapabilityError(
                f"joint {problem.gates[0].joint!r} has friction with 'law: set_valued' or a rigid stop, which only "
                "`simulate` follows; allowed here: 'transition_speed', and stops with 'stiffness'"
            )
        given = initial_positions(scene, problem)
        held = held_columns(scene, problem)
    with watch.stage("assemble"):
        check_prescribed(problem)
        hold = [*held, *(n for n in scene.prescribed or {} if n not in held)]
        assembled = assemble(problem, given, dict(scene.initial.qd or {}), hold)
        check_formulas(problem, assembled.q, assembled.v)
        refuse_singular(problem.model, assembled.q)
    if assembled.redundant:
        with watch.stage("equations"):
            groups = dependent_rows(problem, assembled)
            keep = None if groups else assembled.independent
            problem = Problem(scene, keep_rows=keep, model=problem.model, dependent=groups)
    return Setup(problem, assembled, watch)


def held_columns(scene: Scene, problem: Problem) -> list[str]:
    """Return the coordinates of the joints in `initial.hold`."""
    return [column for name in scene.initial.hold for column in problem.model.q_columns(name)]


def initial_positions(scene: Scene, problem: Problem) -> dict[str, float]:
    """Return the positions at t = 0 that the scene gives, prescribed joints included, by coordinate.

    Raises
    ------
    SceneError : a position is missing.
    """
    given = {**(scene.initial.q or {}), **prescribed_starts(scene)}
    loops = bool(problem.model.closures)
    for name in held_columns(scene, problem) if loops else problem.model.q_names:
        if name not in given:
            why = (
                "`initial.hold` keeps it at its value" if loops else "an open chain needs one for each joint"
            )
            what = "coordinate" if "." in name else "joint"
            raise SceneError(
                f"{scene.path}: initial.q: {what} {name!r} has no initial position ({why})",
                file=scene.path, key="initial.q",
            )  # fmt: skip
    return given


def passive_coordinates(problem: Problem) -> list[int] | None:
    """Return the velocity coordinates that nothing drives, None without loops.

    Actuated are the joints of ``actuated`` (by default those in ``torques``) and prescribed ones.
    """
    scene, model = problem.scene, problem.model
    if not model.closures:
        return None
    driven = {*(scene.torques or {}), *(scene.prescribed or {})}
    if scene.actuated is not None:
        driven = {*(scene.prescribed or {}), *(x for name in scene.actuated for x in model.v_columns(name))}
    return [k for k, name in enumerate(model.v_names) if name not in driven]


def options_for(scene: Scene) -> Options:
    s = scene.simulate
    return Options(s.rtol, s.atol, s.step, max_steps=s.max_steps)

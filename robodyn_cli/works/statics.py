"""Statics: the configuration in which a mechanism balances, or the torques that hold it."""

from __future__ import annotations

import numpy as np

from robodyn_cli.equations.contact_joints import contact_joints
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.given.prescribed import check_prescribed
from robodyn_cli.observe.closing import add_rows, add_sample
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.formulas import check_formulas
from robodyn_cli.observe.reactions import Loads, loads_along
from robodyn_cli.observe.units import joint_columns
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.ready.mobility import mobility
from robodyn_cli.ready.prepare import held_columns, initial_positions
from robodyn_cli.ready.singularity import psi_at
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.assembly import assemble
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, LoopResidual, Termination
from robodyn_cli.summaries.mechanism import ForceResidual, Mobility, StaticsSummary
from robodyn_cli.tools.progress import Progress, no_progress
from robodyn_cli.tools.stopwatch import Stopwatch
from robodyn_cli.trajectories.led import position_columns
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.works.balance import AtRest, balanced, held


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
def statics(scene: Scene, *, progress: Progress = no_progress, watch: Stopwatch | None = None) -> Result:
    """Find the balanced configuration of a scene, or the torques that hold the given one.

    ``balance``: springs, weights, forces and the scene's torques at t = 0 balance; joints in ``initial.hold`` and
    prescribed ones stay, and the torque that this takes is a result. ``hold``: the actuators hold the initial
    configuration; their torques in the scene are ignored.

    Returns
    -------
    A Result of one sample with torques, multipliers and, where asked for, reactions; stability of the balance in the
    summary.

    Raises
    ------
    NumericalError : no balance is found, or a force is not finite. CapabilityError : too few actuators to hold the
    mechanism. GeometryError, SingularConfigurationError : from closing the loops; a dead point of the actuators.
    """
    watch = watch or Stopwatch()
    state = rest_of(scene, watch)
    with watch.stage("evaluate"):
        loads = loads_at_rest(state) if scene.outputs.reactions else None
    progress(0.0, 0.0)
    result = report(state, loads)
    result.summarise(summarise(state, loads), seconds=watch.report())
    refuse_result(result)
    return result


def rest_of(scene: Scene, watch: Stopwatch) -> AtRest:
    """Return the balance, or the configuration that is held."""
    with watch.stage("equations"):
        problem = problem_of(scene)
    with watch.stage("assemble"):
        q = closed_configuration(problem)
    with watch.stage("solve"):
        state = balanced(problem, q) if scene.statics.find == "balance" else held(problem, q)
        refuse_beyond_stops(problem, state.q)
    return state


def problem_of(scene: Scene) -> Problem:
    """Return the equations of a scene for its statics: a configuration is held without its controller.

    Raises
    ------
    CapabilityError : a balance under a controller, whose torques may depend on more than the configuration.
    """
    if scene.control is not None and scene.statics.find == "balance":
        raise CapabilityError(
            "statics knows no controller, whose torques may depend on more than the configuration; take "
            "'control' away, or simulate until the motion comes to rest"
        )
    return Problem(at_rest(scene))


def closed_configuration(problem: Problem) -> Array:
    """Return the initial configuration q (nq,) with the loops closed, held joints where they are."""
    scene = problem.scene
    given = initial_positions(scene, problem)
    held = tuple(dict.fromkeys((*held_columns(scene, problem), *position_columns(scene.prescribed))))
    check_prescribed(problem)
    q = assemble(problem, given, {}, held).q
    check_formulas(problem, q, np.zeros(problem.model.nv))
    return q


def refuse_beyond_stops(problem: Problem, q: Array) -> None:
    """Refuse a configuration beyond a rigid stop, whose force is not among those that balance.

    Raises
    ------
    CapabilityError
    """
    for joint in contact_joints(problem.model):
        for push, at in joint.stops:
            if push * (q[joint.q] - at) < -1e-9 * max(1.0, abs(at)):
                raise CapabilityError(
                    f"joint {joint.name!r} would be at {q[joint.q]:.6g}, beyond its rigid stop at {at:.6g}, which "
                    "`statics` does not follow; allowed: stops with 'stiffness', or the joint in 'initial.hold'",
                    joint=joint.name,
                )


def loads_at_rest(state: AtRest) -> Loads:
    """Return forces and moments in joints and closures."""
    problem, still = state.problem, np.zeros((1, state.problem.model.nv))
    lam = np.zeros((1, len(problem.constraints.rows)))
    lam[0, problem.constraints.of_loops] = state.lam
    return loads_along(problem, np.zeros(1), JointMotion(state.q[None], still, still), lam)


def mobility_at(state: AtRest) -> Mobility:
    """Return the degrees of freedom of the configuration."""
    problem = state.problem
    return mobility(problem, psi_at(problem, state.q))


def report(state: AtRest, loads: Loads | None) -> Result:
    """Return the datasets of a run."""
    problem = state.problem
    scene, model = problem.scene, problem.model
    result = Result.of("statics", scene)
    still, columns = np.zeros(model.nv), joint_columns(model)["tau"].described()
    add_sample(result, problem, state.q, still, still)
    result.add("tau", state.tau[None], **columns)
    for name, term in state.terms.items():
        result.add(f"torque_terms/{name}", term[None], **columns)
    rows = problem.constraints.loop_rows
    if rows:
        dependent = mobility_at(state).redundant_rows > 0
        add_rows(result, rows, {"constraints/multipliers": state.lam[None]}, dependent)
    if loads is not None:
        loads.add_to(result)
    return result


def _beyond_limits(state: AtRest) -> list[str]:
    """Return a warning for each limit of a joint that the balance is beyond; stops have pushed already."""
    if not state.problem.scene.robot.limited:
        return []
    from robodyn_cli.observe.joint_limits import limited_joints, warnings_at_rest

    joints = [
        joint for joint in limited_joints(state.problem.scene, state.problem.model) if not joint.limits.acts
    ]
    return warnings_at_rest(joints, state.q, state.tau)


def summarise(state: AtRest, loads: Loads | None) -> StaticsSummary:
    """Return the summary of a run."""
    problem = state.problem
    model, find = problem.model, problem.scene.statics.find
    rows = problem.constraints.loop_rows
    eta = problem.numbers([row.eta for row in rows], state.q)
    return StaticsSummary(
        termination=Termination("balanced" if find == "balance" else "held", 0.0),
        mobility=mobility_at(state) if rows else ABSENT,
        warnings=_beyond_limits(state) or ABSENT,
        multipliers=dict(zip([row.name for row in rows], state.lam.tolist())) if rows else ABSENT,
        constraint_residual=LoopResidual(float(np.abs(eta).max())) if rows else ABSENT,
        samples=1,
        find=find,
        configuration=dict(zip(model.q_names, state.q.tolist())),
        torques_of_joints=dict(zip(model.v_names, state.tau.tolist())),
        equilibrium=state.facts,
        error_estimate=ForceResidual(state.facts.residual),
        reactions=ABSENT if loads is None else loads.summary(),
    )

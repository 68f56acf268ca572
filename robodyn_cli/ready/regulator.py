"""The linear quadratic regulator of a scene: its model about the pose, and the gain that costs least."""

from __future__ import annotations

import dataclasses

import numpy as np

from robodyn_cli.control.lqr import Lqr, Regulator, regulator_gain
from robodyn_cli.equations.contact_joints import moving_freely
from robodyn_cli.equations.control.model import model_scene, passive_forces
from robodyn_cli.equations.linear.reduce import Linear, held_by, independent, linearise_states
from robodyn_cli.equations.linear.residuals import Residuals, States
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.assembly import assemble
from robodyn_cli.spatial.algebra import Array, Vector

LEFT = 1e-9  # of the largest load: so much of it may be left in a pose that counts as balanced
DRIVING = ("gear", "passive", "friction")  # terms that depend on drives, and those that a model may leave out


def with_regulator(scene: Scene) -> Scene:
    """Return the scene with the regulator that its controller asks for.

    Raises
    ------
    SceneError : the driven joints cannot hold the pose, or there is no regulator.
    """
    controller = scene.control
    problem = Problem(model_scene(scene))
    model = problem.model
    pose = _pose(scene, problem)
    driven = tuple(model.v_names.index(name) for name in controller.joints)
    equations = Residuals(problem, _forces(problem, controller), moving_freely(problem.contact_joints))
    if problem.constraints.rheonomic:
        raise _refusal(scene, "a motion is prescribed, so the pose does not stay; allowed with 'lqr': none")
    states = States.one(pose, np.zeros(model.nv))
    places = independent(equations.values(states)["Psi"][0], driven)
    free = [name for name in (model.v_names[k] for k in places) if name not in model.q_names]
    if free:
        what = f"joint {model.joint_of(model.v_names.index(free[0]))!r} has an attitude"
        raise _refusal(scene, f"{what}, which 'lqr' does not linearise; allowed: joints of axes")
    states, left = held_by(equations, states, driven, places)
    needed = np.abs(equations.values(states)["load"][0]).max(initial=0.0)
    if np.abs(left).max(initial=0.0) > LEFT * max(1.0, needed):
        worst = int(np.argmax(np.abs(left)))
        raise _refusal(
            scene,
            f"the pose is no equilibrium: joint {model.v_names[places[worst]]!r} would need {left[worst]:.4g} N m "
            "(or N) more than the driven joints give there; allowed: a pose that they can hold",
        )
    linear = linearise_states(equations, states, driven, places)
    names = tuple(model.v_names[k] for k in places)
    regulator = Regulator(
        names,
        tuple(map(tuple, _gain(scene, linear, model.v_names).tolist())),
        tuple(states.tau[0][list(driven)].tolist()),
        tuple(float(pose[model.q_names.index(name)]) for name in names),
    )
    whole = dict(zip(model.q_names, pose.tolist()))
    return dataclasses.replace(
        scene, control=dataclasses.replace(controller, regulator=regulator, pose=whole)
    )


def _pose(scene: Scene, problem: Problem) -> Array:
    """Return the pose (nq,) of the model, with its loops closed: driven joints that it names keep their place."""
    names, given = problem.model.q_names, {**scene.initial.q, **scene.control.pose}
    if problem.model.closures:
        start = prepare(at_rest(scene)).assembled.q
        given = {**dict(zip(names, start.tolist())), **scene.control.pose}
        hold = [name for name in scene.control.joints if name in scene.control.pose]
        return assemble(problem, given, {}, hold).q
    lacking = [name for name in names if name not in given]
    if lacking:
        raise _refusal(
            scene, f"the pose of 'lqr' lacks joint {lacking[0]!r}, which 'initial.q' does not give either"
        )
    return np.array([float(given[name]) for name in names])


def _forces(problem: Problem, controller: Lqr) -> Vector:
    """Return the forces (nv,) of the model that are no torques of drives: also those between bodies and from outside,
    and of soft stops."""
    total = passive_forces(problem, controller.model.friction)
    for name, term in problem.passive_forces(smooth=True).items():
        total = total if name in DRIVING else total + term
    return total


def _gain(scene: Scene, linear: Linear, names: tuple[str, ...]) -> Array:
    """Return K (n, 2 f) for the weights of all joints: Q of x = (dq, dv) is X^T Q X with dq, dv = X x."""
    controller = scene.control
    f = len(linear.places)
    X = np.concatenate([np.pad(linear.dq[0], ((0, 0), (0, f))), linear.dv[0]])
    q, qd = (_by_name(w, names) for w in (controller.gains.q, controller.gains.qd))
    Q = X.T @ (np.concatenate([q, qd])[:, None] * X)
    R = np.diag(_by_name(controller.gains.tau, controller.joints))
    period = None if controller.period is None else float(controller.period)
    try:
        return regulator_gain(linear.A[0], linear.B[0], Q, R, period)
    except ValueError as error:
        raise _refusal(scene, str(error)) from None


def _by_name(weight: float | dict[str, float], names: tuple[str, ...]) -> Array:
    """Return a weight for each joint; joints that a map does not name cost nothing."""
    found = [weight.get(name, 0.0) if isinstance(weight, dict) else weight for name in names]
    return np.array([float(x) for x in found])


def _refusal(scene: Scene, why: str) -> SceneError:
    return SceneError(f"{scene.path}: control: {why}", file=scene.path, key="control")

"""What is worked out of a controller before the equations are built: its reference, its gains."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.control.design import ControlDesign, Leading, Named, WithErrors, columns_of
from robodyn_cli.control.lqr import Lqr, Regulator
from robodyn_cli.control.riccati import (
    ROUNDED,
    SAFETY,
    TRIALS,
    BestRegulator,
    Cost,
    disturbed,
    optimum,
    optimum_errors,
    refuse_unsure,
)
from robodyn_cli.equations.contact_joints import moving_freely
from robodyn_cli.equations.control.model import model_scene, passive_forces
from robodyn_cli.equations.linear.poles import poles_of
from robodyn_cli.equations.linear.reduce import Linear, held_by, independent, linearise_states
from robodyn_cli.equations.linear.residuals import Residuals, States
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.given.along import Interpolated, motion_along
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led, velocity_places
from robodyn_cli.model.model import TORQUE
from robodyn_cli.ready.doors import along, at_rest
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.ready.singularity import rounded_rank
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.assembly import closed_start
from robodyn_cli.solve.closure import RANK
from robodyn_cli.solve.load_sharing import allowed_motions
from robodyn_cli.spatial.algebra import Array, Vector
from robodyn_cli.trajectories.base import Lacks
from robodyn_cli.trajectories.course import held


def with_joint_reference(scene: Scene) -> Scene:
    """Return the scene whose controller follows a motion in joint space, where it follows any.

    In a mechanism with loops that is a motion of all joints where the law needs one, or where other joints than the
    driven ones lead: the loops give the rest.

    Raises
    ------
    GeometryError, SingularConfigurationError : from the inverse kinematics of the path, or from the loops.
    CapabilityError : the motion is not smooth.
    """
    controller = scene.control
    loops = bool(scene.loops or scene.couplers)
    ahead = loops and controller.type == "feed_forward"
    if controller.reference is None:
        return _with_reference(scene, _start_held(scene)) if ahead else scene
    followed = along(dataclasses.replace(scene, control=None, trajectory=controller.reference))
    reference: Any = followed.trajectory
    of_others = loops and any(name not in reference.joints for name in controller.joints)
    if not controller.at_point and (ahead or of_others or reference.lacks is Lacks.JOINTS):
        reference = dataclasses.replace(motion_along(Problem(followed)), jumps=reference.knots or ())
    return _with_reference(scene, reference)


def _with_reference(scene: Scene, reference: Any) -> Scene:
    return dataclasses.replace(scene, control=dataclasses.replace(scene.control, reference=reference))


def _start_held(scene: Scene) -> Interpolated:
    """Return the pose at the start, in which all joints stay."""
    setup = prepare(at_rest(scene))
    duration = scene.simulate.duration
    course = held(setup.assembled.q, duration)
    return Interpolated(setup.problem.model.q_names, duration, course, ())


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
    held = [name for name in scene.control.joints if name in scene.control.pose]
    pose = _pose(scene, problem, held)
    driven = tuple(model.v_names.index(name) for name in controller.joints)
    equations = Residuals(problem, _forces(problem, controller), moving_freely(problem.contact_joints))
    if problem.constraints.rheonomic:
        raise _refusal(scene, "a motion is prescribed, so the pose does not stay; allowed with 'lqr': none")
    states = States.one(pose, np.zeros(model.nv))
    places = independent(equations.values(states)["Psi"][0], driven, rounded_rank(problem, pose))
    free = [name for name in (model.v_names[k] for k in places) if name not in model.q_names]
    if free:
        fault = f"joint {model.joint_of(model.v_names.index(free[0]))!r} has an attitude"
        raise _refusal(scene, f"{fault}, which 'lqr' does not linearise; allowed: joints of axes")
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
    best, errors = _regulated(scene, linear, model.v_names)
    holding, off = tuple(states.tau[0][list(driven)].tolist()), _pose_errors(problem, pose, held)
    regulator = Regulator(
        names,
        tuple(map(tuple, best.K.tolist())),
        holding,
        tuple(float(pose[model.q_names.index(name)]) for name in names),
    )
    units = tuple(model.v_units[k] for k in places)
    found = ControlDesign(
        tuple(Named(name, TORQUE[model.v_units[k]]) for name, k in zip(controller.joints, driven)),
        columns_of(Leading(names, units, ())),
        WithErrors(best.K, errors.K),
        WithErrors(*poles_of(best.L, errors.L)),
        WithErrors(best.P, errors.P),
        tuple((Named(*named), float(x)) for *named, x in zip(model.q_names, model.q_units, pose)),
        holding,
        tuple(off.tolist()),
        tuple(_holding_errors(equations, states, driven, places, off).tolist()),
    )
    whole = dict(zip(model.q_names, pose.tolist()))
    own = dataclasses.replace(controller, regulator=regulator, pose=whole, design=found)
    return dataclasses.replace(scene, control=own)


def _pose(scene: Scene, problem: Problem, held: Sequence[str]) -> Array:
    """Return the pose (nq,) of the model, with its loops closed; held : the driven joints that it names."""
    names, given = problem.model.q_names, {**scene.initial.q, **scene.control.pose}
    if problem.model.closures:
        start = prepare(at_rest(scene)).assembled.q
        given = {**dict(zip(names, start.tolist())), **scene.control.pose}
        return closed_start(problem, given, held)[0]
    lacking = [name for name in names if name not in given]
    if lacking:
        raise _refusal(
            scene, f"the pose of 'lqr' lacks joint {lacking[0]!r}, which 'initial.q' does not give either"
        )
    return np.array([float(given[name]) for name in names])


def _pose_errors(problem: Problem, pose: Array, held: Sequence[str]) -> Array:
    """Return how far the positions (nq,) of a pose may be off, whose loops the joints closed that are not held."""
    from robodyn_cli.ready.closed_errors import ErrorsOfClosing

    if not problem.constraints.loop_rows:
        return np.zeros(len(pose))
    stays = velocity_places(problem.model, held)
    free = [k for k in range(problem.model.nv) if k not in stays]
    return ErrorsOfClosing(LoopConditions(problem, nothing_led(), np.zeros(1)), RANK).of_positions(pose, free)


def _holding_errors(
    equations: Residuals, states: States, driven: tuple[int, ...], places: tuple[int, ...], off: Array
) -> Array:
    """Return how far torques (n,) that hold a pose may be off: by what positions are, off (nq,), and by rounding."""
    random, own = np.random.default_rng(2), states.tau[0][list(driven)]
    q, worst = states.q[0], np.zeros(len(driven))
    for _ in range(TRIALS):
        apart = q + random.choice([-1.0, 1.0], len(q)) * (off + ROUNDED * np.abs(q))
        near, _ = held_by(equations, States.one(apart, states.v[0]), driven, places)
        worst = np.maximum(worst, np.abs(near.tau[0][list(driven)] - own))
    load = np.abs(equations.values(states)["load"][0]).max(initial=0.0)
    errors: Array = SAFETY * worst + ROUNDED * max(float(load), float(np.abs(own).max(initial=0.0)))
    return errors


def _forces(problem: Problem, controller: Lqr) -> Vector:
    """Return the forces (nv,) of the model that are no torques of drives: also those between bodies and from outside,
    and of soft stops."""
    total = passive_forces(problem, controller.model.friction)
    for name, term in problem.passive_forces(smooth=True).items():
        total = total if name in DRIVING else total + term
    return total


def _regulated(scene: Scene, linear: Linear, names: tuple[str, ...]) -> tuple[BestRegulator, BestRegulator]:
    """Return the regulator for the weights of all joints, and its errors: Q of x is X^T Q X with (dq, dv) = X x."""
    controller = scene.control
    f = len(linear.places)
    X = np.concatenate([np.pad(linear.dq[0], ((0, 0), (0, f))), linear.dv[0]])
    q, qd = (_by_name(w, names) for w in (controller.gains.q, controller.gains.qd))
    Q = X.T @ (np.concatenate([q, qd])[:, None] * X)
    R = np.diag(_by_name(controller.gains.tau, controller.joints))
    period = None if controller.period is None else float(controller.period)
    written = Cost(Q, R, np.zeros((2 * f, len(R))))

    A, B = linear.A[0], linear.B[0]
    apart, integral = disturbed(A, B, linear.rounding[0]), controller.cost == "integral"
    try:
        found = optimum(A, B, written, period, integral)
        refuse_unsure(A, B, found.K, period, apart)
        others = [optimum(*each, written, period, integral) for each in apart]
    except ValueError as error:
        raise _refusal(scene, str(error)) from None
    return found, optimum_errors(found, others)


def _by_name(weight: float | dict[str, float], names: tuple[str, ...]) -> Array:
    """Return a weight for each joint; joints that a map does not name cost nothing."""
    weights = [weight.get(name, 0.0) if isinstance(weight, dict) else weight for name in names]
    return np.array([float(x) for x in weights])


def _refusal(scene: Scene, why: str) -> SceneError:
    return SceneError(why, (scene.path, "control"), file=scene.path, key="control")


def with_controller_ready(scene: Scene) -> Scene:
    """Return the scene with what its controller follows as a motion of joints, and the numbers of its law.

    Raises
    ------
    SceneError : there is no such regulator, or the driven joints do not command the mechanism. Others from closing the
    loops, and from ``with_joint_reference``.
    """
    scene = with_joint_reference(scene)
    if scene.control.type == "lqr":
        return with_regulator(scene)
    if scene.control.shares and (scene.loops or scene.couplers):
        return _with_directions(scene)
    return scene


def _with_directions(scene: Scene) -> Scene:
    """Return the scene whose controller knows which accelerations its joints can have, where they are too many.

    Raises
    ------
    SceneError : the driven joints do not command all freedoms of the mechanism at the start.
    """
    setup = prepare(at_rest(scene))
    model, joints = setup.problem.model, scene.control.joints
    psi = setup.problem.numbers(setup.problem.psi, setup.assembled.q)
    N, _ = allowed_motions(psi[None], rounded_rank(setup.problem, setup.assembled.q))
    U, s, _ = np.linalg.svd(N[0][[model.v_names.index(name) for name in joints]])
    freedom, commanded = N.shape[2], int((s > RANK).sum())
    if commanded < freedom:
        raise SceneError(
            f"the mechanism has {freedom} degrees of freedom, and at the start the "
            f"driven joints ({', '.join(joints)}) command {commanded} of them; {scene.control.type!r} needs as many "
            "independent ones, in 'control.joints' or 'actuated'", (scene.path, "control.joints"),
            file=scene.path, key="control.joints",
        )  # fmt: skip
    if len(joints) == freedom:
        return scene
    directions = tuple(map(tuple, U[:, :freedom].tolist()))
    return dataclasses.replace(scene, control=dataclasses.replace(scene.control, directions=directions))

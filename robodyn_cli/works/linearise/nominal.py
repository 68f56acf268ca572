"""What is linearised: a state, a balance, a pose that the inputs hold, or a motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from robodyn_cli.equations.contact_joints import FIELDS, moving_freely
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.reduce import held_by, independent
from robodyn_cli.equations.linear.residuals import Residuals, States
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError, RobodynError, of_option
from robodyn_cli.ready.closed_errors import SAFETY
from robodyn_cli.ready.doors import along, at_rest
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.ready.prepare import Setup, prepare, refuse_changes
from robodyn_cli.ready.singularity import rounded_rank
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.load_sharing import LostRank, Unbalanced, share
from robodyn_cli.spatial.algebra import Array, Vector, zeros
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.works.linearise.errors import OffState, errors_of_assembled
from robodyn_cli.works.linearise.signals import inputs_of

# equations, states, and the forces that belong to the model
Along = tuple[Problem, States, Callable[[Problem], Vector]]
WORDS = {
    "state": "the state at the start",
    "balance": "a balance from the start",
    "hold": "the start, held by constant torques",
}
HELD = 1e-9  # part of the loads that may be left where inputs hold a pose


@record
class Nominal:
    """Equations and states about which they are linearised; inputs and independent coordinates by place.

    torques : of the actuators (nv,) that the equations have as expressions, beside what ``states.tau`` has.
    off : errors of the state, with those of torques that hold it; None along a motion, and where rounding decides
    whether it is held.
    """

    about: str
    problem: Problem
    equations: Residuals
    torques: Vector
    states: States
    inputs: tuple[int, ...]
    places: tuple[int, ...]
    words: str = "the state"
    off: OffState | None = None


@record
class Question:
    """What is asked: about ``state``, ``balance``, ``hold``, ``motion``, or ``controller``, the pose that it is to
    keep; inputs and outputs by name, () for all."""

    about: str = "state"
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


def nominal(scene: Scene, question: Question, watch: Stopwatch) -> Nominal:
    """Return the states about which a scene is to be linearised.

    Raises
    ------
    SceneError, CapabilityError : the scene has no such state, or a part without a linear model. Others from assembling,
    from the balance, and from the motion.
    """
    refuse_changes(scene, "linearise")
    wished = question.inputs
    if scene.control is not None and not wished:
        wished = scene.control.joints or ()
    words = WORDS.get(question.about, "")
    off: OffState | None = None
    if question.about == "motion":
        problem, states, force = _along(scene, watch)
    elif question.about == "controller":
        problem, states, words, off = _kept(scene, watch)
        force = _applied
    else:
        setup = prepare(at_rest(scene), watch, neutral=True)
        problem, states, force = setup.problem, States.one(setup.assembled.q, setup.assembled.v), _applied
        off = errors_of_assembled(problem, setup.assembled)
    if geared(problem.model):
        raise CapabilityError(
            "losses of gears depend on the direction of power, which changes about a state; linearise takes gears "
            "without 'gear'"
        )
    inputs = inputs_of(problem, wished)
    if question.about == "balance":
        states, off = _balance(problem, states)
    elif question.about == "hold":
        states, force = States.one(states.q[0], 0.0 * states.v[0]), _passive
    equations = Residuals(problem, force(problem), _parameters(problem, states))
    psi = equations.values(states)["Psi"]
    places = independent(psi[0], inputs, rounded_rank(problem, states.q[0]))
    if question.about == "hold":
        states, off = _held(problem, equations, states, inputs, places)
    torques = problem.actuator_torques if force is _applied else zeros(problem.model.nv)
    return Nominal(question.about, problem, equations, torques, states, inputs, places, words, off)


def _kept(scene: Scene, watch: Stopwatch) -> tuple[Problem, States, str, OffState | None]:
    """Return the equations, and the pose that the controller is to keep with what holds it there, and its errors; where
    its joints cannot, the others go to their balance from there, if they find one."""
    from robodyn_cli.works.loops.pose import aim_of

    aim = aim_of(integrable(scene, watch))
    setup = _assembled(aim.scene, scene.control.joints, watch)
    problem, states = setup.problem, States.one(setup.assembled.q, setup.assembled.v)
    states = dataclasses.replace(states, times=np.array([aim.time]))
    equations = Residuals(problem, _applied(problem), moving_freely(problem.contact_joints))
    values = equations.values(states)
    driven = [problem.model.v_names.index(name) for name in scene.control.joints]
    held, left = held_by(equations, states, driven, independent(values["Psi"][0], driven))
    needed = np.abs(values["load"][0]).max(initial=0.0)
    off = errors_of_assembled(problem, setup.assembled)
    if np.abs(left).max(initial=0.0) <= HELD * max(needed, 1e-12):
        return problem, held, aim.words, off
    initial = aim.scene.initial
    hold = tuple(dict.fromkeys([*initial.hold, *scene.control.joints]))
    staying = dataclasses.replace(aim.scene, initial=dataclasses.replace(initial, hold=hold))
    try:
        problem = prepare(at_rest(staying), watch, neutral=True).problem
        rest, at_rest_off = _balance(problem, states)
    except RobodynError:
        return setup.problem, held, aim.words, off
    words = f"{aim.words}, the joints that are not driven at their balance"
    return problem, dataclasses.replace(rest, times=states.times), words, at_rest_off


def _assembled(scene: Scene, driven: Sequence[str], watch: Stopwatch) -> Setup:
    """Return a scene that is assembled at the goal of its controller: where what ``initial.hold`` keeps at the start
    has to move with the driven joints, these alone are held."""
    try:
        return prepare(at_rest(scene), watch, neutral=True)
    except GeometryError:
        alone = tuple(name for name in scene.initial.hold if name in driven)
        if alone == scene.initial.hold:
            raise
        initial = dataclasses.replace(scene.initial, hold=alone)
        return prepare(at_rest(dataclasses.replace(scene, initial=initial)), watch, neutral=True)


def _applied(problem: Problem) -> Vector:
    return problem.applied


def _passive(problem: Problem) -> Vector:
    """Return the forces but for the torques of the actuators, which are inputs."""
    total: Vector = sum(problem.passive_forces(smooth=True).values(), zeros(problem.model.nv))
    return total


def _parameters(problem: Problem, states: States) -> Sequence[float]:
    """Return the parameters p of joints with exact friction and stops, which slide here.

    Raises
    ------
    CapabilityError : one is at rest, where its friction has no slope, or turns round along the motion.
    """
    parameters = list(moving_freely(problem.contact_joints))
    for joint in problem.contact_joints:
        if joint.friction is None:
            continue
        signs = set(np.sign(states.v[:, joint.v]).tolist())
        if len(signs) > 1 or 0.0 in signs:
            raise CapabilityError(
                f"joint {joint.name!r} has friction that sticks, and is at rest or turns round: there it has no linear "
                "model; allowed: states in which it slides one way, or friction with 'law: smooth'",
                joint=joint.name,
            )
        parameters[joint.place + FIELDS.index("direction")] = signs.pop()
    return parameters


def _balance(problem: Problem, states: States) -> tuple[States, OffState | None]:
    """Return the balance reached from a configuration, and its errors; what holds joints of ``initial.hold`` is a
    constant torque."""
    from robodyn_cli.works.equilibria import balanced
    from robodyn_cli.works.statics import errors_of

    rest = balanced(problem, states.q[0])
    own = problem.numbers(problem.actuator_torques, rest.q)
    still = np.zeros(problem.model.nv)
    found = States(np.zeros(1), rest.q[None], still[None], None, (rest.tau - own)[None])
    off = errors_of(rest)
    return found, None if off is None else OffState(off.q, still, off.holding)


def _held(
    problem: Problem,
    equations: Residuals,
    states: States,
    inputs: Sequence[int],
    places: tuple[int, ...],
) -> tuple[States, OffState | None]:
    """Return the state with the constant torques of the inputs that hold it, and its errors.

    Raises
    ------
    CapabilityError : they cannot.
    """
    from robodyn_cli.works.statics import errors_held

    state, left = held_by(equations, states, inputs, places)
    values = equations.values(state)
    needed = np.abs(values["load"][0]).max(initial=0.0)
    if np.abs(left).max(initial=0.0) > HELD * max(needed, 1e-12):
        names = [problem.model.v_names[k] for k in inputs]
        raise CapabilityError(
            f"{', '.join(names) or 'no input'} cannot hold this pose: a force of {np.abs(left).max():.3g} N m or N is "
            "left; name more inputs, or linearise about a balance (--at balance)"
        )
    q = state.q[0]
    try:
        shared = share(values["Psi"], inputs, {"load": values["load"]}, rounded_rank(problem, q))
    except (LostRank, Unbalanced):
        return state, None
    off = errors_held(
        problem, range(values["Psi"].shape[1]), inputs, (q, shared.multipliers[0], shared.tau[0])
    )
    # two ways to the same torques differ by their rounding
    if off is None:
        return state, None
    return state, OffState(off.q, 0.0 * off.tau, off.tau + SAFETY * np.abs(shared.tau - state.tau)[0])


def _along(scene: Scene, watch: Stopwatch) -> Along:
    """Return states along the motion of the scene's command: ``inverse``, or ``simulate``.

    Torques of ``inverse`` and of a controller are constants there, other torques belong to the model.

    Raises
    ------
    CapabilityError : another command's.
    """
    command = scene.command or "simulate"
    if command not in ALONG:
        raise of_option("--along", f"the command is {command!r}; allowed: {', '.join(ALONG)}, or none")
    return ALONG[command](scene, watch)


def _along_inverse(scene: Scene, watch: Stopwatch) -> Along:
    from robodyn_cli.works.inverse import inverse

    with watch.stage("motion"):
        scene = along(scene)
        result = inverse(scene)
    return Problem(scene), _states(result, result["tau"]), _passive


def _along_simulation(scene: Scene, watch: Stopwatch) -> Along:
    from robodyn_cli.works.simulate import simulate

    with watch.stage("motion"):
        result = simulate(scene)
    problem = prepare(at_rest(scene), watch).problem
    if scene.control is not None:
        return problem, _states(result, result["tau"]), _passive
    return problem, _states(result, np.zeros_like(result["qd"])), _applied


def _states(result: Result, tau: Array) -> States:
    return States(result.time, result["q"], result["qd"], result["qdd"], tau)


# commands along whose motion a scene is linearised
ALONG: dict[str, Callable[[Scene, Stopwatch], Along]] = {
    "simulate": _along_simulation,
    "inverse": _along_inverse,
}

"""What is linearised: a state, a balance, a pose that the inputs hold, or a motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from robodyn_cli.equations.contact_joints import FIELDS, moving_freely
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.reduce import held_by, independent
from robodyn_cli.equations.linear.residuals import Residuals, States
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.ready.doors import along, at_rest
from robodyn_cli.ready.prepare import prepare, refuse_changes
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, Vector, zeros
from robodyn_cli.tools.stopwatch import Stopwatch
from robodyn_cli.works.linearise.signals import inputs_of

# equations, states, and the forces that belong to the model
Along = tuple[Problem, States, Callable[[Problem], Vector]]
HELD = 1e-9  # part of the loads that may be left where inputs hold a pose


@record
class Nominal:
    """Equations and states about which they are linearised; inputs and independent coordinates by place.

    torques : of the actuators (nv,) that the equations have as expressions, beside what ``states.tau`` has.
    """

    about: str
    problem: Problem
    equations: Residuals
    torques: Vector
    states: States
    inputs: tuple[int, ...]
    places: tuple[int, ...]


@record
class Question:
    """What is asked: about ``state``, ``balance``, ``hold`` or ``motion``; inputs and outputs by name, () for all."""

    about: str = "state"
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


def nominal(scene: Scene, asked: Question, watch: Stopwatch) -> Nominal:
    """Return the states about which a scene is to be linearised.

    Raises
    ------
    SceneError, CapabilityError : the scene has no such state, or a part without a linear model. Others from assembling,
    from the balance, and from the motion.
    """
    refuse_changes(scene, "linearise")
    wished = asked.inputs
    if scene.control is not None and not wished:
        wished = scene.control.joints or ()
    if asked.about == "motion":
        problem, states, force = _along(scene, watch)
    else:
        setup = prepare(at_rest(scene), watch, neutral=True)
        problem, states, force = setup.problem, States.one(setup.assembled.q, setup.assembled.v), _applied
    if geared(problem.model):
        raise CapabilityError(
            "losses of gears depend on the direction of power, which changes about a state; linearise takes gears "
            "without 'gear'"
        )
    inputs = inputs_of(problem, wished)
    if asked.about == "balance":
        states = _balance(problem, states)
    elif asked.about == "hold":
        states, force = States.one(states.q[0], 0.0 * states.v[0]), _passive
    equations = Residuals(problem, force(problem), _parameters(problem, states))
    psi = equations.values(states)["Psi"]
    places = independent(psi[0], inputs)
    if asked.about == "hold":
        states = _held(equations, states, inputs, places)
    torques = problem.actuator_torques if force is _applied else zeros(problem.model.nv)
    return Nominal(asked.about, problem, equations, torques, states, inputs, places)


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
    found = list(moving_freely(problem.contact_joints))
    for joint in problem.contact_joints:
        if joint.friction is None:
            continue
        signs = set(np.sign(states.v[:, joint.v]).tolist())
        if len(signs) > 1 or 0.0 in signs:
            raise CapabilityError(
                f"joint {joint.name!r} has friction that sticks, and is at rest or turns round: there it has no linear "
                "model; allowed: states in which it slides one way, or friction with 'law: smooth'"
            )
        found[joint.place + FIELDS.index("direction")] = signs.pop()
    return found


def _balance(problem: Problem, states: States) -> States:
    """Return the balance reached from a configuration; what holds joints of ``initial.hold`` is a constant torque."""
    from robodyn_cli.works.balance import balanced

    rest = balanced(problem, states.q[0])
    own = problem.numbers(problem.actuator_torques, rest.q)
    still = np.zeros(problem.model.nv)
    return States(np.zeros(1), rest.q[None], still[None], None, (rest.tau - own)[None])


def _held(equations: Residuals, states: States, inputs: Sequence[int], places: tuple[int, ...]) -> States:
    """Return the state with the constant torques of the inputs that hold it.

    Raises
    ------
    CapabilityError : they cannot.
    """
    found, left = held_by(equations, states, inputs, places)
    needed = np.abs(equations.values(states)["load"][0]).max(initial=0.0)
    if np.abs(left).max(initial=0.0) > HELD * max(needed, 1e-12):
        names = [equations.problem.model.v_names[k] for k in inputs]
        raise CapabilityError(
            f"{', '.join(names) or 'no input'} cannot hold this pose: a force of {np.abs(left).max():.3g} N m or N is "
            "left; name more inputs, or linearise about a balance (--at balance)"
        )
    return found


def _along(scene: Scene, watch: Stopwatch) -> Along:
    """Return states along the motion of the scene's command: ``inverse``, or ``simulate``.

    Torques of ``inverse`` and of a controller are constants there, other torques belong to the model.

    Raises
    ------
    CapabilityError : another command's.
    """
    command = scene.command or "simulate"
    if command not in ALONG:
        raise SceneError(f"--along: the scene's command is {command!r}; allowed: {', '.join(ALONG)}, or none")
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

"""What is linearised (a state, a balance, a pose that the inputs hold, or a motion), and inputs and outputs by their
names."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.contact_joints import FIELDS, moving_freely
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.reduce import Linear, held_by, independent
from robodyn_cli.equations.linear.residuals import Residuals, States, by_steps, by_symbols, evaluated
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError, RobodynError, did_you_mean, of_option
from robodyn_cli.model.model import TORQUE, Model
from robodyn_cli.ready.doors import along, at_rest
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.ready.prepare import Setup, passive_coordinates, prepare, refuse_changes
from robodyn_cli.ready.singularity import rounded_rank
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, Vector, zeros
from robodyn_cli.summaries.linear import LinearSignal
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.works.functions.derivatives import frame_jacobian

TORQUES = "tau"  # symbol group of the torques beside those of the equations


def inputs_of(problem: Problem, names: Sequence[str]) -> tuple[int, ...]:
    """Return the velocity coordinates whose torques are inputs: those asked for, else the actuated ones.

    Raises
    ------
    SceneError : one is unknown, or given twice.
    """
    scene, model = problem.scene, problem.model
    if not names:
        driven = passive_coordinates(problem) if model.closures else _unactuated(problem)
        fixed = {model.v_names.index(name) for name in scene.prescribed if name in model.v_names}
        return tuple(k for k in range(model.nv) if k not in driven and k not in fixed)
    places = []
    for name in names:
        _known("--input", name, model.v_names)
        if name in scene.prescribed:
            raise of_option(f"--input {name}", "the joint is prescribed, so no torque moves it")
        places.append(model.v_names.index(name))
    if len(set(places)) < len(places):
        raise of_option("--input", f"a joint is given twice among {', '.join(names)}")
    return tuple(places)


def _unactuated(problem: Problem) -> tuple[int, ...]:
    """Return the coordinates of an open chain without an actuator."""
    scene, model = problem.scene, problem.model
    if scene.actuated is None:
        return ()
    driven = {column for name in scene.actuated for column in model.v_columns(name)}
    return tuple(k for k, name in enumerate(model.v_names) if name not in driven)


def input_signals(model: Model, places: Sequence[int]) -> list[LinearSignal]:
    return [LinearSignal(model.v_names[k], TORQUE[model.v_units[k]]) for k in places]


def state_signals(model: Model, places: Sequence[int]) -> list[LinearSignal]:
    """Return the states: changes of the independent coordinates, then of their rates."""
    steps = [LinearSignal(model.v_names[k], model.v_units[k]) for k in places]
    return [*steps, *(LinearSignal(f"qd.{x.name}", f"{x.unit}/s") for x in steps)]


class LinearOutputs:
    """What is measured: changes of coordinates, of rates (``qd.NAME``), of points (x, y, z in the world), and of the
    formulas of ``outputs.signals``.

    Parameters
    ----------
    torques : of the actuators (nv,) as expressions, beside what ``States.tau`` has.

    Raises
    ------
    SceneError : there is nothing of a name, or a formula that needs the controller.
    """

    def __init__(self, problem: Problem, torques: Vector, asked: Sequence[str]) -> None:
        self.problem = problem
        model, given = problem.model, problem.scene.outputs.signals
        self.asked = tuple(asked) or model.v_names
        allowed = [*model.v_names, *(f"qd.{name}" for name in model.v_names), *model.points, *given]
        for name in self.asked:
            _known("--output", name, allowed)
        self._inputs = problem.graph.symbols([f"tau.{name}" for name in model.v_names], TORQUES)
        tau = {f"tau.{name}": x + u for name, x, u in zip(model.v_names, torques, self._inputs)}
        names = problem.environment | tau
        self._formulas = {
            name: _formula_of(name, given[name], names)
            for name in self.asked
            if name in given and name not in (*model.v_names, *model.points)
        }

    @property
    def signals(self) -> list[LinearSignal]:
        """The outputs in their order."""
        model, signals = self.problem.model, []
        for name in self.asked:
            if name in self._formulas:
                signals.append(
                    LinearSignal(name, getattr(self.problem.scene.outputs.signals[name], "unit", "1"))
                )
            elif name in model.v_names:
                signals.append(LinearSignal(name, model.v_units[model.v_names.index(name)]))
            elif name in model.points:
                signals += [LinearSignal(f"{name}.{axis}", "m") for axis in "xyz"]
            else:
                signals.append(LinearSignal(name, f"{model.v_units[model.v_names.index(name[3:])]}/s"))
        return signals

    def matrices(self, states: States, linear: Linear, inputs: Sequence[int]) -> tuple[Array, Array]:
        """Return C (T, outputs, 2n) and D (T, outputs, inputs): only formulas may depend on torques at once."""
        model, n = self.problem.model, len(linear.places)
        step = np.concatenate([linear.dq, np.zeros((*linear.dq.shape[:2], n))], axis=2)
        rows, direct = [], []
        for name in self.asked:
            through = np.zeros((len(states), 1, len(inputs)))
            if name in self._formulas:
                slopes = self._slopes(self._formulas[name], states)
                rows.append(slopes["q"] @ step + slopes["v"] @ linear.dv)
                through = slopes["tau"][:, :, list(inputs)]
            elif name in model.v_names:
                rows.append(step[:, [model.v_names.index(name)]])
            elif name in model.points:
                J = frame_jacobian(self.problem, model.points[name])[3:]
                rows.append(evaluated({"J": J}, states.groups)["J"] @ step)
                through = np.zeros((len(states), 3, len(inputs)))
            else:
                rows.append(linear.dv[:, [model.v_names.index(name[3:])]])
            direct.append(through)
        return np.concatenate(rows, axis=1), np.concatenate(direct, axis=1)

    def _slopes(self, y: Any, states: States) -> dict[str, Array]:
        """Return the derivatives (T, 1, nv) of a formula by steps, by rates and by torques."""
        slopes = {
            "q": by_steps(self.problem, [y]), "v": by_symbols([y], self.problem.v),
            "tau": by_symbols([y], self._inputs),
        }  # fmt: skip
        return evaluated(slopes, {**states.groups, TORQUES: states.tau})


def _formula_of(name: str, signal: Any, names: Mapping[str, Any]) -> Any:
    """Return the expression of a signal.

    Raises
    ------
    SceneError : it needs what only the controller knows, which is no part of the linear model.
    """
    formula = getattr(signal, "value", signal)
    missing = sorted(formula.names - names.keys())
    if missing:
        raise of_option(
            f"--output {name}",
            f"its formula needs {', '.join(missing)} of the controller, which is no part of the "
            "linear model; allowed: formulas of t, q, qd, tau and parameters",
        )
    return formula.evaluate(names)


def _known(option: str, name: str, allowed: Sequence[str]) -> None:
    if name not in allowed:
        raise of_option(
            f"{option} {name}", f"unknown{did_you_mean(name, list(allowed))}; allowed: {', '.join(allowed)}"
        )


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
    """

    about: str
    problem: Problem
    equations: Residuals
    torques: Vector
    states: States
    inputs: tuple[int, ...]
    places: tuple[int, ...]
    words: str = "the state"


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
    if question.about == "motion":
        problem, states, force = _along(scene, watch)
    elif question.about == "controller":
        problem, states, words = _kept(scene, watch)
        force = _applied
    else:
        setup = prepare(at_rest(scene), watch, neutral=True)
        problem, states, force = setup.problem, States.one(setup.assembled.q, setup.assembled.v), _applied
    if geared(problem.model):
        raise CapabilityError(
            "losses of gears depend on the direction of power, which changes about a state; linearise takes gears "
            "without 'gear'"
        )
    inputs = inputs_of(problem, wished)
    if question.about == "balance":
        states = _balance(problem, states)
    elif question.about == "hold":
        states, force = States.one(states.q[0], 0.0 * states.v[0]), _passive
    equations = Residuals(problem, force(problem), _parameters(problem, states))
    psi = equations.values(states)["Psi"]
    places = independent(psi[0], inputs, rounded_rank(problem, states.q[0]))
    if question.about == "hold":
        states = _held(equations, states, inputs, places)
    torques = problem.actuator_torques if force is _applied else zeros(problem.model.nv)
    return Nominal(question.about, problem, equations, torques, states, inputs, places, words)


def _kept(scene: Scene, watch: Stopwatch) -> tuple[Problem, States, str]:
    """Return the equations, and the pose that the controller is to keep with what holds it there; where its joints
    cannot, the others go to their balance from there, if they find one."""
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
    if np.abs(left).max(initial=0.0) <= HELD * max(needed, 1e-12):
        return problem, held, aim.words
    initial = aim.scene.initial
    hold = tuple(dict.fromkeys([*initial.hold, *scene.control.joints]))
    staying = dataclasses.replace(aim.scene, initial=dataclasses.replace(initial, hold=hold))
    try:
        problem = prepare(at_rest(staying), watch, neutral=True).problem
        rest = _balance(problem, states)
    except RobodynError:
        return setup.problem, held, aim.words
    words = f"{aim.words}, the joints that are not driven at their balance"
    return problem, dataclasses.replace(rest, times=states.times), words


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


def _balance(problem: Problem, states: States) -> States:
    """Return the balance reached from a configuration; what holds joints of ``initial.hold`` is a constant torque."""
    from robodyn_cli.works.equilibria import balanced

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
    state, left = held_by(equations, states, inputs, places)
    needed = np.abs(equations.values(states)["load"][0]).max(initial=0.0)
    if np.abs(left).max(initial=0.0) > HELD * max(needed, 1e-12):
        names = [equations.problem.model.v_names[k] for k in inputs]
        raise CapabilityError(
            f"{', '.join(names) or 'no input'} cannot hold this pose: a force of {np.abs(left).max():.3g} N m or N is "
            "left; name more inputs, or linearise about a balance (--at balance)"
        )
    return state


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

"""The functions of a scene's model that become C: what each takes and gives, as expressions of one graph."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from robodyn_cli.algorithms.composite import coriolis
from robodyn_cli.algorithms.kinematics import world_pose
from robodyn_cli.equations.control.control import NOISE, STATES
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.residuals import Residuals
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import PARAMETER_GROUP, TORQUE, FixedFrame
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.ready.prepare import refuse_changes
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.spatial.algebra import Array, Vector, zeros
from robodyn_cli.works.functions.derivatives import centre_of_mass, frame_jacobian

# what functions take, in this order, and the symbol groups of the graph
GROUPS = {"t": "t", "q": "q", "qd": "v", "qdd": "a", "tau": "tau", "z": STATES, "noise": NOISE}
MOST_OPERATIONS = 100_000  # of one function; a compiler needs minutes for more


@record
class Output:
    """An array that a function gives, row by row: its shape, what it is, and the units of its entries.

    least : what errors are part of where its entries vanish.
    """

    entries: Array
    meaning: str
    units: str
    least: float = 0.0

    @property
    def size(self) -> int:
        return int(self.entries.size)


@record
class CFunction:
    """A function of C: its name, what it does, what it takes of ``GROUPS``, and its outputs by name.

    solved : whether the outputs are linear equations whose solution it gives, see ``solve_constrained``.
    """

    name: str
    meaning: str
    takes: tuple[str, ...]
    outputs: Mapping[str, Output]
    solved: bool = False

    @cached_property
    def program(self) -> Program:
        return make_program(self.entries, [GROUPS[name] for name in self.takes])

    @property
    def entries(self) -> dict[str, Sequence[Any]]:
        return {name: list(output.entries.flat) for name, output in self.outputs.items()}


@record
class ModelFunctionsOfScene:
    """The functions of a scene, and those that it has not, with the reasons; problem : the equations."""

    problem: Problem
    functions: tuple[CFunction, ...]
    left_out: Mapping[str, str]


def functions_of(scene: Scene) -> ModelFunctionsOfScene:
    """Return the functions of a scene's model and controller.

    Raises
    ------
    CapabilityError : functions of a state cannot hold a part of the scene: it is named.
    """
    refuse(scene)
    problem = Problem(scene)
    _refuse_contacts(problem)
    functions: list[CFunction] = []
    left_out: dict[str, str] = {}
    for name, make in _all(problem):
        try:
            function = _checked(make(), name)
        except ZeroDivisionError:
            left_out[name] = "a mass or an inertia that it divides by is zero"
        except RobodynError as error:
            if name.startswith("control"):
                raise
            left_out[name] = error.message
        else:
            functions.append(function)
    return ModelFunctionsOfScene(problem, tuple(functions), left_out)


def ready(scene: Scene) -> Scene:
    """Return the scene with what is found ahead of its equations: motions that are prescribed, what a controller
    follows."""
    return integrable(scene) if scene.control is not None or scene.prescribed else scene


def refuse(scene: Scene) -> None:
    """Refuse what acts in Python or by events.

    Raises
    ------
    CapabilityError : with its name.
    """
    refuse_changes(scene, "export --c")
    if scene.control is not None and scene.control.type == "python":
        raise CapabilityError(
            "a function in Python has no C; allowed: a controller of another type, such as "
            "'formulas', or --set control=null",
            (scene.path, "control"),
            key="control",
        )


def _refuse_contacts(problem: Problem) -> None:
    for joint in problem.contact_joints:
        part, other = (
            ("friction", "'law: smooth'")
            if joint.friction is not None
            else ("limits", "a stop with stiffness")
        )
        kind = "friction that sticks" if joint.friction is not None else "a rigid stop"
        raise CapabilityError(
            f"{kind} holds and releases joint {joint.name!r} "
            f"by events, which no function of a state has; allowed: {other}, or none",
            (problem.scene.path, f"robot.joints.{joint.name}.{part}"),
            key=f"robot.joints.{joint.name}.{part}",
        )


def _checked(function: CFunction, name: str) -> CFunction:
    """Return a function that takes the time where it depends on it.

    Raises
    ------
    SceneError : it needs data that the scene does not give. CapabilityError : it depends on what events change, or is
    too long.
    """
    entries = [x for output in function.entries.values() for x in output]
    groups = {symbol.value[1] for symbol in free_symbols(entries)}
    if PARAMETER_GROUP in groups:
        raise CapabilityError("it depends on what events switch")
    timed = "t" in groups and "t" not in function.takes
    takes = ("t", *function.takes) if timed else function.takes
    function = dataclasses.replace(function, name=name, takes=takes)
    operations = function.program.operations
    if operations > MOST_OPERATIONS:
        raise CapabilityError(f"it has {operations} operations; allowed: {MOST_OPERATIONS}")
    return function


Made = tuple[str, Callable[[], CFunction]]


def _all(problem: Problem) -> Iterator[Made]:
    """Give the names of all functions with what makes them."""
    yield from _rigid(problem)
    if problem.constraints.rows:
        yield from _constrained(problem)
    else:
        yield "inverse_dynamics", lambda: _inverse(problem)
        yield "forward_dynamics", lambda: _forward(problem)
    yield from _places(problem)
    if problem.control is not None:
        yield from _control(problem)


def _units(names: Sequence[str]) -> str:
    """Return units of columns: one where they are the same, else one after the other."""
    return names[0] if len(set(names)) == 1 else ", ".join(names)


def torque_units(problem: Problem) -> str:
    return _units([TORQUE[unit] for unit in problem.model.v_units])


def _function(meaning: str, takes: Sequence[str], **outputs: Output) -> CFunction:
    return CFunction("", meaning, tuple(takes), outputs)


def _rigid(p: Problem) -> Iterator[Made]:
    tau = torque_units(p)

    yield (
        "mass_matrix",
        lambda: _function(
            "Mass matrix: kinetic energy is qd^T M qd / 2, rotors included. Symmetric.",
            ("q",),
            M=Output(p.mass_matrix, "mass matrix", "kg m^2, kg m or kg"),
        ),
    )
    yield (
        "coriolis",
        lambda: _function(
            "Coriolis matrix of Christoffel's symbols: M-dot = C + C^T.",
            ("q", "qd"),
            C=Output(coriolis(p.rigid, p.q, p.v, p.X), "C qd are the velocity terms of torques", "SI"),
        ),
    )
    yield (
        "coriolis_torques",
        lambda: _function(
            "Velocity terms C qd of the torques, by one Newton-Euler pass.",
            ("q", "qd"),
            Cqd=Output(p.rigid_terms()["coriolis"], "centrifugal and Coriolis torques", tau),
        ),
    )
    yield (
        "gravity",
        lambda: _function(
            "Torques that hold the weight of the bodies.",
            ("q",),
            G=Output(p.gravity_torques, "gravity torques", tau),
        ),
    )


def _acting(p: Problem) -> Vector:
    """Return the torques of springs, dampers, friction with its exact sign, and forces (nv,)."""
    return sum(p.passive_forces(smooth=False).values(), zeros(p.model.nv))


def _inverse(p: Problem) -> CFunction:
    return _function(
        "Inverse dynamics: tau = M qdd + C qd + G less springs, dampers, friction (exact sign, 0 at rest) and forces.",
        ("q", "qd", "qdd"),
        tau=Output(p.inverse_dynamics - _acting(p), "torques of the joints", torque_units(p)),
    )


def _refuse_losses(p: Problem) -> None:
    if geared(p.model):
        raise CapabilityError(
            "losses of gears depend on the drive, so accelerations do not follow from torques"
        )


def _forward(p: Problem) -> CFunction:
    _refuse_losses(p)
    tau: Any = zeros(p.model.nv)
    tau[:] = p.graph.symbols(p.model.v_names, "tau")
    return _function(
        "Forward dynamics: the inverse of inverse_dynamics.",
        ("q", "qd", "tau"),
        qdd=Output(p.free_accelerations(tau + _acting(p) - p.bias), "accelerations", _rates(p, 2)),
    )


def _rates(p: Problem, order: int) -> str:
    over = "/s" if order == 1 else "/s^2"
    return _units([f"{unit}{over}" for unit in p.model.v_units])


def _constrained(p: Problem) -> Iterator[Made]:
    rows, size = ", ".join(p.constraints.names), mechanism_size(p.model)
    yield (
        "constraints",
        lambda: _function(
            f"Residuals of loops, couplers and prescribed joints, zero where they hold. Rows: {rows}.",
            ("q",),
            eta=Output(np.array(p.constraints.eta, dtype=object), "residuals", "m or rad, as the row", size),
        ),
    )
    yield (
        "constraint_jacobian",
        lambda: _function(
            f"Jacobian of the residuals: Psi qd + d eta / dt = 0. Rows: {rows}.",
            ("q",),
            Psi=Output(p.psi, "rows by rates", "SI"),
        ),
    )
    yield "forward_dynamics", lambda: _constrained_forward(p)


def _constrained_forward(p: Problem) -> CFunction:
    _refuse_losses(p)
    parts = Residuals(p, _acting(p), ()).parts
    outputs = {name: Output(np.asarray(entries, dtype=object), "", "SI") for name, entries in parts.items()}
    meaning = (
        "Forward dynamics where loops, couplers and prescribed joints hold: M qdd + C qd + G = tau + springs, dampers, "
        "friction and forces + Psi^T lambda, Psi qdd + gamma = 0. q and qd must satisfy them. Of rows that depend on "
        "each other some have lambda = 0; qdd is the same for all choices."
    )
    return CFunction("", meaning, ("q", "qd"), outputs, solved=True)


def places_of(problem: Problem) -> dict[str, FixedFrame]:
    """Return points, frames and links by name, as ``Mechanism.forward_kinematics`` finds them."""
    model = problem.model
    return {**model.links, **model.points, **model.frames}


def _places(p: Problem) -> Iterator[Made]:
    yield (
        "centre_of_mass",
        lambda: _function(
            "Centre of mass of all moving bodies, in the world.",
            ("q",),
            c=Output(centre_of_mass(p), "position", "m"),
        ),
    )
    for name, frame in places_of(p).items():
        yield f"pose_{name}", partial(_pose, p, frame, name)
        yield f"jacobian_{name}", partial(_jacobian, p, frame, name)


def _pose(p: Problem, frame: FixedFrame, name: str) -> CFunction:
    pose = world_pose(p.model, p.pose, frame)
    return _function(
        f"Pose of {name} in the world.",
        ("q",),
        p=Output(pose.p, "position of its origin", "m"),
        R=Output(pose.R, "rotation; columns are its axes", "1"),
    )


def _jacobian(p: Problem, frame: FixedFrame, name: str) -> CFunction:
    return _function(
        f"Jacobian of {name}: J qd is its twist in axes of the world, angular velocity before velocity.",
        ("q",),
        J=Output(frame_jacobian(p, frame), "rows: wx, wy, wz, vx, vy, vz", "SI"),
    )


def _control(p: Problem) -> Iterator[Made]:
    """Give the law of the controller: continuous with the rates of its states, or sampled with their updates."""
    control = p.control
    assert control is not None
    n, state = _units(control.units), ("t", "q", "qd", "z")
    states = ", ".join(control.names) or "none"

    def array(entries: Sequence[Any]) -> Array:
        return np.array(list(entries), dtype=object)

    start: list[Any] = control.starts.tolist()
    for k, measured in zip(control.last, control.measured.q if control.last else ()):
        start[k] = measured
    yield (
        "control_torques",
        lambda: _function(
            f"Torques of the controller on {', '.join(control.joints)}.",
            state,
            tau=Output(array(control.torques), "torques of the driven joints", n),
        ),
    )
    yield (
        "control_start",
        lambda: _function(
            f"States of the controller before it begins: {states}.",
            ("q", "noise") if control.channels else ("q",),
            z=Output(array(start), "states", "SI"),
        ),
    )
    if control.period is None:
        yield (
            "control_rates",
            lambda: _function(
                f"Rates of the controller's states: {states}.",
                state,
                zd=Output(array(control.rates), "rates of the states", "SI"),
            ),
        )
        return
    yield (
        "control_update",
        lambda: _function(
            f"States of the controller ({states}) after its sample at t = n CONTROL_PERIOD, n = 0, 1, ...",
            (*state, "noise") if control.channels else state,
            zn=Output(array(control.phases[0]), "new states", "SI"),
        ),
    )
    if control.rest:
        yield (
            "control_delayed",
            lambda: _function(
                "The same at t = n CONTROL_PERIOD + CONTROL_REST, where delayed torques begin to act.",
                state,
                zn=Output(array(control.phases[1]), "new states", "SI"),
            ),
        )

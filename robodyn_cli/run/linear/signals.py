"""Inputs and outputs of a linear system by their names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.linear.reduce import Linear
from robodyn_cli.equations.linear.residuals import States
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError, did_you_mean
from robodyn_cli.model.model import TORQUE, Model
from robodyn_cli.record import record
from robodyn_cli.run.driver.prepare import passive_coordinates
from robodyn_cli.run.functions.places import frame_jacobian
from robodyn_cli.run.observation.evaluation import SampleFunction
from robodyn_cli.spatial.algebra import Array


@record
class Signal:
    """A state, an input or an output: its name, its unit."""

    name: str
    unit: str


def inputs_of(problem: Problem, asked: Sequence[str]) -> tuple[int, ...]:
    """Return the velocity coordinates whose torques are inputs: those asked for, else the actuated ones.

    Raises
    ------
    SceneError : one is unknown, or given twice.
    """
    scene, model = problem.scene, problem.model
    if not asked:
        driven = passive_coordinates(problem) if model.closures else _unactuated(problem)
        fixed = {model.v_names.index(name) for name in scene.prescribed if name in model.v_names}
        return tuple(k for k in range(model.nv) if k not in driven and k not in fixed)
    places = []
    for name in asked:
        _known("--input", name, model.v_names)
        if name in scene.prescribed:
            raise SceneError(f"--input {name}: the joint is prescribed, so no torque moves it")
        places.append(model.v_names.index(name))
    if len(set(places)) < len(places):
        raise SceneError(f"--input: a joint is given twice among {', '.join(asked)}")
    return tuple(places)


def _unactuated(problem: Problem) -> tuple[int, ...]:
    """Return the coordinates of an open chain without an actuator."""
    scene, model = problem.scene, problem.model
    if scene.actuated is None:
        return ()
    driven = {column for name in scene.actuated for column in model.v_columns(name)}
    return tuple(k for k, name in enumerate(model.v_names) if name not in driven)


def input_signals(model: Model, places: Sequence[int]) -> list[Signal]:
    return [Signal(model.v_names[k], TORQUE[model.v_units[k]]) for k in places]


def state_signals(model: Model, places: Sequence[int]) -> list[Signal]:
    """Return the states: changes of the independent coordinates, then of their rates."""
    steps = [Signal(model.v_names[k], model.v_units[k]) for k in places]
    return [*steps, *(Signal(f"qd.{x.name}", f"{x.unit}/s") for x in steps)]


class Outputs:
    """What is measured: changes of coordinates, of rates (``qd.NAME``) and of points (x, y, z in the world).

    Raises
    ------
    SceneError : there is nothing of a name.
    """

    def __init__(self, problem: Problem, asked: Sequence[str]) -> None:
        self.problem = problem
        model = problem.model
        self.asked = tuple(asked) or model.v_names
        allowed = [*model.v_names, *(f"qd.{name}" for name in model.v_names), *model.points]
        for name in self.asked:
            _known("--output", name, allowed)

    @property
    def signals(self) -> list[Signal]:
        """The outputs in their order."""
        model, found = self.problem.model, []
        for name in self.asked:
            if name in model.v_names:
                found.append(Signal(name, model.v_units[model.v_names.index(name)]))
            elif name in model.points:
                found += [Signal(f"{name}.{axis}", "m") for axis in "xyz"]
            else:
                found.append(Signal(name, f"{model.v_units[model.v_names.index(name[3:])]}/s"))
        return found

    def matrices(self, states: States, linear: Linear) -> Array:
        """Return C (T, outputs, 2n); D is zero, for no output is an acceleration or a force."""
        model, n = self.problem.model, len(linear.places)
        step = np.concatenate([linear.dq, np.zeros((*linear.dq.shape[:2], n))], axis=2)
        rows = []
        for name in self.asked:
            if name in model.v_names:
                place = model.v_names.index(name)
                rows.append(step[:, [place]])
            elif name in model.points:
                J = frame_jacobian(self.problem, model.points[name])[3:]
                function = SampleFunction({"J": list(J.flat)}, tuple(states.groups), 1)
                rows.append(function(**states.groups)["J"].reshape(len(states), 3, model.nv) @ step)
            else:
                place = model.v_names.index(name[3:])
                rows.append(linear.dv[:, [place]])
        return np.concatenate(rows, axis=1)


def _known(option: str, name: str, allowed: Sequence[str]) -> None:
    if name not in allowed:
        raise SceneError(
            f"{option} {name}: unknown{did_you_mean(name, list(allowed))}; allowed: {', '.join(allowed)}"
        )

"""Inputs, states and outputs of linear systems, by their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.linear.reduce import Linear
from robodyn_cli.equations.linear.residuals import States, by_steps, by_symbols, evaluated
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import did_you_mean, of_option
from robodyn_cli.model.model import TORQUE, Model
from robodyn_cli.ready.prepare import passive_coordinates
from robodyn_cli.spatial.algebra import Array, Vector
from robodyn_cli.summaries.linear import LinearSignal
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

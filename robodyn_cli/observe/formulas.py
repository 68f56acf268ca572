"""Check that the formulas of a scene have values at a state: torques, forces and prescribed motions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr.formula import FormulaTree, formulas_in
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.spatial.algebra import Array

BESIDE = 1e-9  # change of a coordinate, over its size or 1, that shows whether a formula is at an edge
AHEAD = 1e-6  # part of the duration after the start at which formulas must have a value too


def check_formulas(problem: Problem, q: Array, v: Array) -> None:
    """Refuse torques, forces and prescribed motions that have no value at the start q (nq,), v (nv,), t = 0.

    Raises
    ------
    SceneError : names the formula and what it depends on.
    """
    found = formula_without_value(problem, 0.0, q, v)
    if found is not None:
        raise SceneError(f"{found}, at the start (t = 0)", file=problem.scene.path)


def check_formulas_ahead(problem: Problem, q: Array, v: Array) -> None:
    """Refuse formulas that have a value at the start but none where the motion goes: sqrt(x) at x = 0 with x falling.

    Accelerations are asked for only where a formula is at the edge of what it is defined on. They are not known yet
    where joints stick or lie on stops.

    Raises
    ------
    SceneError : names the formula and what it depends on.
    """
    if problem.contact_joints or not _at_an_edge(problem, q, v):
        return
    a = problem.numbers(problem.forward.qdd, q, v=v)
    soon = AHEAD * problem.scene.simulate.duration
    moved = Manifold(problem.model).integrate(q, soon * v + 0.5 * soon * soon * a)
    found = formula_without_value(problem, soon, moved, v + soon * a) if np.isfinite(moved).all() else None
    if found is not None:
        raise SceneError(f"{found}, right after the start (t = {soon:.3g} s)", file=problem.scene.path)


def _at_an_edge(problem: Problem, q: Array, v: Array) -> bool:
    """Tell whether a small change of what a formula depends on leaves it without a value."""
    env = _environment(problem, 0.0, q, v)
    for formula in _of(problem):
        for name in formula.names & env.keys():
            x = env[name]
            change = BESIDE * max(1.0, abs(x))
            if any(_without_value(formula, env | {name: near}) for near in (x - change, x + change)):
                return True
    return False


def formula_without_value(problem: Problem, t: float, q: Array, v: Array) -> str | None:
    """Return in words the first formula without a finite value at t [s], q (nq,) and v (nv,), None if all have one."""
    env = _environment(problem, t, q, v)
    return next((words for formula in _of(problem) if (words := _without_value(formula, env))), None)


def _environment(problem: Problem, t: float, q: Array, v: Array) -> dict[str, float]:
    """Return the values of all names that formulas may use."""
    scene, model = problem.scene, problem.model
    env = {"t": t, **{f"p.{name}": x for name, x in scene.parameters.items()}}
    env |= {f"q.{name}": x for name, x in zip(model.q_names, q.tolist())}
    env |= {f"qd.{name}": x for name, x in zip(model.v_names, v.tolist())}
    return env | dict(zip(problem.spans, problem.numbers(list(problem.spans.values()), q, t, v).tolist()))


def _of(problem: Problem) -> Iterator[FormulaTree]:
    scene = problem.scene
    forces = [f.element for f in problem.model.forces]
    return formulas_in([scene.torques, scene.prescribed, scene.robot.points, forces])


def _without_value(formula: FormulaTree, env: dict[str, float]) -> str:
    """Return in words that a formula has no finite value, "" where it has one."""
    if not formula.names <= env.keys():
        return ""
    try:
        value = float(formula.evaluate(env))
    except NumericalError as error:
        return error.message
    return "" if np.isfinite(value) else f"{formula.where}: formula {formula.text!r} is {value}"

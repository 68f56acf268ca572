"""Formulas of a scene that have no value: at the start, right after it, or where a run ends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr.formula import OWN, FormulaTree, formulas_in
from robodyn_cli.expr.graph import Graph, Scalar
from robodyn_cli.expr.intervals import bounds
from robodyn_cli.expr.rebuild import numbers
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

BESIDE = 1e-9  # change of a coordinate, over its size or 1, that shows whether a formula is at an edge
AHEAD = 1e-6  # part of the duration after the start at which formulas must have a value too


@record
class TimedState:
    """A time [s] and a state: q (nq,), v (nv,), and the states z of a controller, None for those at the start."""

    t: float
    q: Array
    v: Array
    z: Array | None = None


def check_formulas(problem: Problem, q: Array, v: Array) -> None:
    """Refuse formulas that have no value at the start q (nq,), v (nv,), t = 0.

    Raises
    ------
    SceneError : names the formula and what it depends on.
    """
    fault = formula_without_value(problem, TimedState(0.0, q, v))
    if fault is not None:
        raise SceneError(f"{fault.sentence}, at the start (t = 0)", fault.about, **fault.details)


def check_formulas_ahead(problem: Problem, q: Array, v: Array) -> None:
    """Refuse formulas that have a value at the start but none where the motion goes: sqrt(x) at x = 0 with x falling.

    Accelerations are asked for only where a formula is at the edge of what it is defined on. They are not known yet
    where joints stick or lie on stops.

    Raises
    ------
    SceneError : names the formula and what it depends on.
    """
    if problem.is_held or not _at_an_edge(problem, TimedState(0.0, q, v)):
        return
    a = problem.numbers(problem.forward.qdd, q, v=v)
    soon = AHEAD * problem.scene.simulate.duration
    moved = Manifold(problem.model).integrate(q, soon * v + 0.5 * soon * soon * a)
    there = TimedState(soon, moved, v + soon * a)
    fault = formula_without_value(problem, there) if np.isfinite(moved).all() else None
    if fault is not None:
        raise SceneError(
            f"{fault.sentence}, right after the start (t = {soon:.3g} s)", fault.about, **fault.details
        )


def _at_an_edge(problem: Problem, at: TimedState) -> bool:
    """Tell whether a small change of what a formula depends on leaves it without a value."""
    for formula, env in _formulas(problem, at):
        for name, x in env.items():
            change = BESIDE * max(1.0, abs(x))
            if any(
                _without_value(formula, env | {name: near}) is not None for near in (x - change, x + change)
            ):
                return True
    return False


def formula_without_value(problem: Problem, at: TimedState) -> NumericalError | None:
    """Return the error of the first formula without a finite value at an instant, None if all have one."""
    return next((error for x in _formulas(problem, at) if (error := _without_value(*x)) is not None), None)


def formula_ending(problem: Problem, at: TimedState, to: TimedState) -> NumericalError | None:
    """Return the error of the first formula that has a finite value at one instant, and not all the way to another.

    On the way, what it depends on goes straight from the one to the other.
    """
    graph = Graph()
    part = graph.symbol("part", "part")
    for (formula, here), (_, there) in zip(_formulas(problem, at), _formulas(problem, to)):
        if not all(np.isfinite(x) for x in (*here.values(), *there.values())):
            continue
        try:
            value = formula.evaluate({name: x + part * (there[name] - x) for name, x in here.items()})
        except NumericalError:
            continue
        reach = bounds(value, part, np.zeros(1), np.ones(1))
        if not (np.isfinite(reach.low[0]) and np.isfinite(reach.high[0])):
            values = ", ".join(f"{name} = {x:.6g}" for name, x in sorted(here.items()))
            value = float(formula.evaluate(here))
            text = f"formula {formula.text!r} is {value:.6g} at {values}, and has no finite value next to it"
            return NumericalError(text, **formula.where)
    return None


def _formulas(problem: Problem, at: TimedState) -> Iterator[tuple[FormulaTree, dict[str, float]]]:
    """Yield the formulas of torques, motions, forces and the controller, each with the values of what it names."""
    scene = problem.scene
    for formula in formulas_in([scene.torques, scene.prescribed, scene.robot.points, scene.couplers]):
        yield formula, _values(problem, formula, problem.environment, at)
    for force in problem.model.forces:
        for formula in formulas_in([force.element]):
            names = dict(problem.environment)
            if not formula.names.isdisjoint(OWN):
                line = problem.elements.line(force)
                names |= zip(OWN, (line.length, line.rate))
            yield formula, _values(problem, formula, names, at)
    if problem.control is not None:
        law = problem.control.controller
        for formula in formulas_in([law.law, law.state]):
            yield formula, _values(problem, formula, problem.control.exact.names(), at)


def _values(
    problem: Problem, formula: FormulaTree, names: Mapping[str, Scalar], at: TimedState
) -> dict[str, float]:
    """Return the values of the names of a formula."""
    entries = {name: names[name] for name in sorted(formula.names) if name in names}
    control = problem.control
    z = at.z if at.z is not None or control is None else control.starts
    groups = {"t": [at.t], "q": at.q, "v": at.v, "z": [] if z is None else z, "p": problem.model.switched}
    return dict(zip(entries, numbers(list(entries.values()), groups).tolist()))


def _without_value(formula: FormulaTree, env: Mapping[str, float]) -> NumericalError | None:
    """Return the error of a formula that has no finite value, None where it has one."""
    if not formula.names <= env.keys():
        return None
    try:
        value = float(formula.evaluate(env))
    except NumericalError as error:
        return error
    return (
        None
        if np.isfinite(value)
        else NumericalError(f"formula {formula.text!r} is {value}", **formula.where)
    )

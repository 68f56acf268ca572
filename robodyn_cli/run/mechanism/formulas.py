"""Check that the formulas of a scene have values at a state: torques, forces and prescribed motions."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr.formula import Formula
from robodyn_cli.spatial.algebra import Array


def check_formulas(problem: Problem, q: Array, v: Array) -> None:
    """Refuse torques, forces and prescribed motions that have no value at the start q (nq,), v (nv,), t = 0.

    Raises
    ------
    SceneError : names the formula and what it depends on.
    """
    found = formula_without_value(problem, 0.0, q, v)
    if found is not None:
        raise SceneError(f"{found}, at the start (t = 0)", file=problem.scene.path)


def formula_without_value(problem: Problem, t: float, q: Array, v: Array) -> str | None:
    """Return in words the first formula without a finite value at t [s], q (nq,) and v (nv,), None if all have one."""
    scene, model = problem.scene, problem.model
    env = {"t": t, **{f"p.{name}": x for name, x in scene.parameters.items()}}
    env |= {f"q.{name}": x for name, x in zip(model.q_names, q.tolist())}
    env |= {f"qd.{name}": x for name, x in zip(model.v_names, v.tolist())}
    for formula in _formulas([scene.torques, scene.prescribed, [f.element for f in model.forces]]):
        if formula.names <= env.keys():
            try:
                value = float(formula.evaluate(env))
            except NumericalError as error:
                return error.message
            if not np.isfinite(value):
                return f"{formula.where}: formula {formula.text!r} is {value}"
    return None


def _formulas(value: Any) -> Iterator[Formula]:
    """Yield the formulas in records, maps and lists."""
    if isinstance(value, Formula):
        yield value
    elif isinstance(value, Mapping):
        yield from _formulas(tuple(value.values()))
    elif isinstance(value, (list, tuple)):
        for entry in value:
            yield from _formulas(entry)
    elif dataclasses.is_dataclass(value):
        yield from _formulas([getattr(value, field.name) for field in dataclasses.fields(value)])

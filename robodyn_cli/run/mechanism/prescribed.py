"""Check that a simulation can follow the prescribed motions: they agree with the start and do not jump."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robodyn_cli.equations.discontinuities import is_of_time, switches, switching_times
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.loops.base import Row
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import zeros

BESIDE = (1e-9, 1e-7, 1e-5)  # parts of the duration: distances from a jump at which both sides are evaluated
JUMP = 1e-6  # rad, rad/s, m or m/s


def prescribed_starts(scene: Scene) -> dict[str, float]:
    """Return where the prescribed joints are at t = 0.

    Raises
    ------
    SceneError : initial.q says something else. NumericalError : a formula has no value there.
    """
    starts = {}
    for name, formula in scene.prescribed.items():
        env = {"t": 0.0, **{f"p.{n}": x for n, x in scene.parameters.items()}}
        start = float(formula.evaluate(env))
        given = scene.initial.q.get(name)
        if given is not None and abs(given - start) > 1e-9 * max(1.0, abs(start)):
            raise SceneError(
                f"{scene.path}: initial.q.{name}: {given:.9g} contradicts prescribed.{name}, which starts at "
                f"{start:.9g}; leave it out of initial.q, or make them agree",
                file=scene.path, key=f"initial.q.{name}",
            )  # fmt: skip
        starts[name] = start
    return starts


def check_prescribed(problem: Problem) -> None:
    """Refuse motions that no finite torque can follow.

    Raises
    ------
    NumericalError : the rate or the acceleration at t = 0 is not finite. SceneError : position or rate jump.
    """
    constraints = problem.constraints
    _check_moving_ends(problem)
    for i in constraints.rheonomic:
        row = constraints.rows[i]
        name = row.name.partition(".")[2] if i in constraints.prescribed else row.name.rpartition(".")[0]
        where = f"the prescribed motion in {name!r} (row {row.name})"
        if i in constraints.prescribed:
            formula = problem.scene.prescribed[name]
            where = f"{formula.where or f'prescribed.{name}'}: the motion {formula.text!r}"
        for what, entry in (("rate", row.eta_t), ("acceleration", row.gamma)):
            if not np.isfinite(_at(entry, 0.0)):
                raise NumericalError(
                    f"{where} has no finite {what} at t = 0", time=0.0, joint=name, status="not_finite"
                )
        _refuse_jumps(problem, row, where, name, {"position": row.eta, "rate": row.eta_t})


def _refuse_jumps(problem: Problem, row: Row, where: str, name: str, entries: Mapping[str, Scalar]) -> None:
    """Refuse a motion of which one of ``entries``, of opposite sign as in eta = q - s(t), jumps.

    Raises
    ------
    SceneError : with the time and both values.
    """
    for time in _doubtful_times(problem, row):
        step = _beside(row, time, problem.scene.simulate.duration)
        slack = JUMP + 10.0 * step * max(abs(_at(row.gamma, t)) for t in (time - step, time + step))
        for what, entry in entries.items():
            before, after = -_at(entry, time - step), -_at(entry, time + step)
            if abs(after - before) > slack + 10.0 * step * abs(_at(row.eta_t, time + step)):
                raise SceneError(
                    f"{where} jumps at t = {time:.9g} s: its {what} goes from {before:.6g} to {after:.6g}, which "
                    "takes an infinite torque; let it go there in finite time",
                    joint=name, time=time,
                )  # fmt: skip


def _check_moving_ends(problem: Problem) -> None:
    """Refuse ends of forces on the ground that jump; their rates may jump, and dampers with them.

    Raises
    ------
    SceneError : with the force, the time and both places. NumericalError : no finite place or rate at t = 0.
    """
    for key, place, rate in problem.elements.moving:
        where = f"the motion of the place {key!r}"
        for axis, x, v in zip("xyz", place, rate):
            if not (np.isfinite(_at(x, 0.0)) and np.isfinite(_at(v, 0.0))):
                raise NumericalError(
                    f"{where} has no finite place or rate at t = 0", time=0.0, status="not_finite"
                )
            row = Row(key, -x, zeros(0), 0.0, -v)
            _refuse_jumps(problem, row, where, key, {axis: -x})


def _beside(row: Row, time: float, duration: float) -> float:
    """Return the smallest distance from a time [s] at which the motion has values on both sides."""
    for part in BESIDE:
        there = [_at(entry, time + s * part * duration) for entry in (row.eta_t, row.gamma) for s in (-1, 1)]
        if np.all(np.isfinite(there)):
            break
    return part * duration


def _doubtful_times(problem: Problem, row: Row) -> list[float]:
    """Return the times at which the motion may jump: formulas switch there, or are not smooth."""
    found = [s for s in switches([row.eta, row.eta_t, row.gamma]) if is_of_time(s, problem.t)]
    duration = problem.scene.simulate.duration
    times = {x for s in found for x in switching_times(s, problem.t, duration) if 0.0 < x < duration}
    hidden = [x for key, found in problem.switching.time_structures if key == row.name for x in found.points]
    return sorted(times.union(hidden))


def _at(entry: Scalar, time: float) -> float:
    """Return an entry of a row that depends on time, q and v (both taken as 0)."""
    try:
        return float(evaluate([entry], {"t": [time], "q": _Zeros(), "v": _Zeros()})[0])
    except (ArithmeticError, ValueError):
        return float("nan")


class _Zeros:
    def __getitem__(self, index: int) -> float:
        return 0.0

"""Check that a simulation can follow the prescribed motions: they agree with the start and do not jump."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.equations.discontinuities import is_of_time, switches, switching_times
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr.formula_tree import NOWHERE
from robodyn_cli.expr.rebuild import Interpreter, evaluate
from robodyn_cli.loops.base import Row
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, zeros
from robodyn_cli.trajectories.formulas import FORMS, evaluated, joint_expressions, time_symbol
from robodyn_cli.trajectories.joint_space import attitude_places
from robodyn_cli.trajectories.led import Follows, position_columns

BESIDE = (1e-9, 1e-7, 1e-5)  # parts of the duration: distances from a jump at which both sides are evaluated
JUMP = 1e-6  # rad, rad/s, m or m/s
START = np.zeros(1)  # s


def prescribed_starts(scene: Scene) -> dict[str, float]:
    """Return where the prescribed joints are at t = 0, by column of q.

    Raises
    ------
    SceneError : initial.q says something else. NumericalError : a formula has no value there.
    """
    t, env = time_symbol(scene.parameters)
    columns = position_columns(scene.prescribed)
    positions = joint_expressions(evaluated(scene.prescribed, env), columns, t).q
    starts = dict(zip(columns, (float(x) for x in evaluate(positions, {"t": [0.0]}))))
    for places in attitude_places(columns).values():
        names = [columns[k] for k in places]
        if sum(scene.initial.q.get(name, starts[name]) * starts[name] for name in names) < 0.0:
            starts |= {name: -starts[name] for name in names}  # the same attitude
    for name, start in starts.items():
        given = scene.initial.q.get(name)
        if given is not None and abs(given - start) > 1e-9 * max(1.0, abs(start)):
            raise SceneError(
                f"{given:.9g} contradicts prescribed.{name}, which starts at "
                f"{start:.9g}; leave it out of initial.q, or make them agree", (scene.path, f"initial.q.{name}"),
                file=scene.path, key=f"initial.q.{name}",
            )  # fmt: skip
    return starts


def refuse_both(scene: Scene) -> None:
    """Refuse joints that are prescribed and led by a trajectory in joint space.

    Raises
    ------
    SceneError
    """
    led = () if scene.trajectory is None else position_columns(scene.trajectory.joints)
    both = [name for name in led if name in position_columns(scene.prescribed)]
    if both:
        raise SceneError(
            f"joint {both[0]!r} moves by `trajectory` and by `prescribed`; leave it out of one of them",
            (scene.path,),
            key=f"prescribed.{both[0]}",
        )


def check_prescribed(problem: Problem) -> None:
    """Refuse motions that no finite torque can follow.

    Raises
    ------
    NumericalError : the rate or the acceleration at t = 0 is not finite. SceneError : position or rate jump.
    """
    constraints = problem.constraints
    _check_moving_ends(problem)
    for i in constraints.rheonomic:
        row = _Course(problem, constraints.rows[i])
        name = row.name.partition(".")[2] if i in constraints.prescribed else row.name.rpartition(".")[0]
        what, where = f"the prescribed motion in {name!r} (row {row.name})", NOWHERE
        if i in constraints.prescribed:
            formula = _formula(problem.scene.prescribed, name)
            what = f"the motion {formula.text!r}"
            where = formula.where or {"about": (f"prescribed.{name}",)}
        for order, (value,) in zip(("rate", "acceleration"), row.at(START)[1:]):
            if not np.isfinite(value):
                raise NumericalError(
                    f"{what} has no finite {order} at t = 0",
                    **where,
                    time=0.0,
                    joint=name,
                    status="not_finite",
                )
        _refuse_jumps(problem, row, (where, what), i in constraints.prescribed)


def _refuse_jumps(
    problem: Problem, row: _Course, named: tuple[Mapping[str, Any], str], prescribed: bool, rates: bool = True
) -> None:
    """Refuse a motion that jumps, in its position or, unless ``rates`` is false, in its rate.

    named : the motion's place in the scene and what it is, in words.

    Raises
    ------
    SceneError : with the time and both values.
    """
    where, what = named
    name = row.name.partition(".")[2] if prescribed else row.name.rpartition(".")[0]
    times = _doubtful_times(problem, row.row, prescribed)
    if not times.size:
        return
    step = _beside(row, times, problem.scene.simulate.duration)
    before, after = row.at(times - step), row.at(times + step)
    slack = JUMP + 10.0 * step * (np.maximum(np.abs(before[2]), np.abs(after[2])) + np.abs(after[1]))
    for k, quantity in enumerate(("position", "rate")[: 1 + rates]):
        jumps = np.flatnonzero(np.abs(after[k] - before[k]) > slack)
        if jumps.size:
            first = jumps[0]
            raise SceneError(
                f"{what} jumps at t = {times[first]:.9g} s: its {quantity} goes from {before[k][first]:.6g} to "
                f"{after[k][first]:.6g}, which takes an infinite torque; let it go there in finite time", **where,
                joint=name, time=float(times[first]),
            )  # fmt: skip


def _check_moving_ends(problem: Problem) -> None:
    """Refuse ends of forces on the ground that jump; their rates may jump, and dampers with them.

    Raises
    ------
    SceneError : with the force, the time and both places. NumericalError : no finite place or rate at t = 0.
    """
    for key, place, rate in problem.elements.moving:
        for x, v in zip(place, rate):
            what = f"the motion of the place {key!r}"
            row = _Course(problem, Row(key, -x, zeros(0), 0.0, -v))
            if not np.all(np.isfinite(row.at(START)[:2])):
                raise NumericalError(
                    f"{what} has no finite place or rate at t = 0", time=0.0, status="not_finite"
                )
            _refuse_jumps(problem, row, (NOWHERE, what), False, rates=False)


class _Course:
    """The motion that a row asks for, as it is seen from the neutral pose at rest."""

    def __init__(self, problem: Problem, row: Row) -> None:
        self.row, self.name = row, row.name
        self._values = Interpreter([row.eta, row.eta_t, row.gamma])
        self._state = {"q": Manifold(problem.model).neutral(), "v": np.zeros(problem.model.nv)}

    def at(self, times: Array) -> Array:
        """Return position, rate and acceleration (3, T) at times (T,); not finite where there is none."""
        try:
            with np.errstate(all="ignore"):
                values = self._values({"t": times[None], **self._state})
        except (ArithmeticError, ValueError):  # of numbers that do not depend on time
            return np.full((3, len(times)), np.nan)
        return -np.array([np.broadcast_to(x, times.shape) for x in values], dtype=float)


def _formula(prescribed: Mapping[str, Any], column: str) -> Any:
    """Return the formula of a column, or the first one of its joint's attitude."""
    joint = column.rpartition(".")[0]
    formula = prescribed.get(column) or next(
        prescribed[f"{joint}.{x}"] for x in FORMS if f"{joint}.{x}" in prescribed
    )
    return formula[0] if isinstance(formula, tuple) else formula


def _beside(row: _Course, times: Array, duration: float) -> Array:
    """Return the smallest distance from each time [s] at which the motion has values on both sides."""
    distances = np.full(len(times), BESIDE[-1] * duration)
    for part in reversed(BESIDE):
        sides = [row.at(times + side * part * duration)[1:] for side in (-1, 1)]
        distances[np.all(np.isfinite(sides), axis=(0, 1))] = part * duration
    return distances


def _doubtful_times(problem: Problem, row: Row, prescribed: bool) -> Array:
    """Return the times at which the motion may jump: formulas switch there, or are not smooth."""
    duration = problem.scene.simulate.duration
    formula = _formula(problem.scene.prescribed, row.name.partition(".")[2]) if prescribed else None
    followed = formula.followed if isinstance(formula, Follows) else None
    if followed is not None and followed.breakpoints is not None:
        return np.unique([x for x in followed.breakpoints if 0.0 < x < duration])
    unsmooth = [s for s in switches([row.eta, row.eta_t, row.gamma]) if is_of_time(s, problem.t)]
    times = {x for s in unsmooth for x in switching_times(s, problem.t, duration) if 0.0 < x < duration}
    keys = (row.name, row.closure)  # those of an attitude have one key
    hidden = [
        x for key, unsmooth in problem.switching.time_structures if key in keys for x in unsmooth.points
    ]
    return np.unique([*times, *hidden])

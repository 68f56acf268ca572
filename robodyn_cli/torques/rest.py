"""Joints with Coulomb friction or gear losses that stand still for a while along a motion.

At rest, friction takes any value within its bounds, so the torque of the actuator is not determined there; the reported
torques are those without friction. A rate no larger than the rounding error of the path counts as rest.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.forces.friction import Friction, Gear
from robodyn_cli.given.motion import Planned
from robodyn_cli.model.model import TORQUE, JointForce, Model
from robodyn_cli.solve.quadrature import gaps_between
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.torques.checks import LEAST

MOST_PERIODS = 3  # that a warning lists for one joint
ROUNDING = 64 * np.finfo(float).eps  # relative, of what a motion is computed from


def with_rest(problem: Problem, planned: Planned) -> Planned:
    """Return the motion with rates of exactly zero in joints with dry friction where rounding explains them."""
    dry = _dry(problem.model)
    if not dry:
        return planned
    qd = planned.motion.qd.copy(order="F")
    for k, (force, *_) in dry.items():
        qd[np.abs(qd[:, k]) <= explained_rate(planned, force), k] = 0.0
        _begin_as_they_go_on(qd[:, k], planned.times)
    return dataclasses.replace(planned, motion=dataclasses.replace(planned.motion, qd=qd))


def _begin_as_they_go_on(rates: Array, times: Array) -> None:
    """Give rates (T,) of zero at either end of the motion, and of a piece between knots where samples lie at both of
    its ends, the sign that they have inside: friction there is that of the piece."""
    if len(times) < 2:
        return
    gaps = gaps_between(times)
    for ends, inside in ((np.append(0, gaps + 1), 1), (np.append(gaps, len(times) - 1), -1)):
        ends = ends[rates[ends] == 0.0]
        rates[ends] = LEAST * np.sign(rates[ends + inside])


def explained_rate(planned: Planned, force: JointForce) -> float:
    """Return the rate [rad/s or m/s] of the coordinate of a force in a joint that the errors of the path explain.

    Rates that come from closing loops or leading a point are off by rounding of the fastest. A position that is off
    by rounding, or by what closes a loop, moves at that error over the time between samples.
    """
    q, qd = planned.motion.q, planned.motion.qd
    solved = planned.target is not None or bool(planned.residuals)
    position = ROUNDING * float(np.abs(q if solved else q[:, force.q]).max())
    position += planned.residuals.get("position", 0.0)
    fastest = float(np.abs(qd if solved else qd[:, force.v]).max())
    return ROUNDING * fastest + position / float(np.diff(planned.times).max())


def rest_warnings(problem: Problem, planned: Planned) -> list[str]:
    """Return one warning about all joints that stand still over more than two samples where dry friction may act."""
    joints: dict[str, list[str]] = {}  # names by when they stand still
    frictions: dict[str, list[str]] = {}  # names by the bounds of friction
    gears: list[str] = []
    for place, forces in _dry(problem.model).items():
        periods = _periods(planned.times, planned.motion.qd[:, place] == 0.0)
        if not periods:
            continue
        joints.setdefault(_listed(periods), []).append(forces[0].name)
        for force in forces:
            if isinstance(force.element, Friction):
                plus, minus = force.element.breakaway(force.gear_ratio)
                bounds = f"{-minus:.6g} to {plus:.6g} {TORQUE[force.unit]}"
                frictions.setdefault(bounds, []).append(force.name)
            else:
                gears.append(force.name)
    if not joints:
        return []
    standing = "; ".join(
        f"{', '.join(names)} {'stands' if len(names) == 1 else 'stand'} still {when}"
        for when, names in joints.items()
    )
    causes, left_out = [], []
    if frictions:
        listed = "; ".join(f"{bounds} in {', '.join(names)}" for bounds, names in frictions.items())
        causes.append(f"dry friction takes any value within its bounds ({listed})")
        left_out.append("dry friction")
    if gears:
        causes.append(f"gears bear a part of the load ({', '.join(gears)})")
        left_out.append("losses of gears")
    return [
        f"{standing}: there {' and '.join(causes)}, so the actuator torques of these joints are not determined; "
        f"those reported for that time are without {' and '.join(left_out)}"
    ]


def _periods(times: Array, still: Array) -> list[tuple[float, float]]:
    """Return from when to when a joint stands still, over more than two samples each."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]])))
    starts, ends = edges[::2], edges[1::2] - 1
    return [(float(times[i]), float(times[k])) for i, k in zip(starts, ends) if k - i >= 2]


def _listed(periods: Sequence[tuple[float, float]]) -> str:
    """Say when, in one line however many periods there are."""
    shown = ", ".join(f"from {start:.4g} to {end:.4g} s" for start, end in periods[:MOST_PERIODS])
    more = len(periods) - MOST_PERIODS
    return f"{shown} and {more} more {'time' if more == 1 else 'times'}" if more > 0 else shown


def _dry(model: Model) -> dict[int, list[JointForce]]:
    """Return dry friction and gears by the velocity coordinates on which they act, those in space left out.

    A rotation in space stands still only where all of its rates vanish, which rounding does not bring about in one
    that turns.
    """
    by_coordinate: dict[int, list[JointForce]] = {}
    for force in (f for body in model.bodies for f in body.forces if not f.in_space):
        if isinstance(force.element, Gear) or (isinstance(force.element, Friction) and force.element.dry):
            by_coordinate.setdefault(force.v, []).append(force)
    return by_coordinate

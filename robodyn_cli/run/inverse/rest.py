"""Joints with Coulomb friction or gear losses that stand still for a while along a motion.

At rest, friction takes any value within its bounds, so the torque of the actuator is not determined there; the reported
torques are those without friction. A rate no larger than the rounding error of the path counts as rest.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.forces.friction import Friction
from robodyn_cli.forces.gear import Gear
from robodyn_cli.model.model import JointForce, Model
from robodyn_cli.run.mechanism.motion import Planned
from robodyn_cli.run.observation.units import TORQUE

ROUNDING = 64 * np.finfo(float).eps  # relative, of what a motion is computed from


def with_rest(problem: Problem, planned: Planned) -> Planned:
    """Return the motion with rates of exactly zero in joints with dry friction where rounding explains them."""
    dry = _dry(problem.model)
    if not dry:
        return planned
    qd = planned.motion.qd.copy(order="F")
    for k, (force, *_) in dry.items():
        qd[np.abs(qd[:, k]) <= explained_rate(planned, force), k] = 0.0
    return dataclasses.replace(planned, motion=dataclasses.replace(planned.motion, qd=qd))


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
    return ROUNDING * fastest + position / float(planned.times[1] - planned.times[0])


def rest_warnings(problem: Problem, planned: Planned) -> list[str]:
    """Return a warning for each joint that stands still over more than two samples where dry friction may act."""
    found = []
    for place, forces in _dry(problem.model).items():
        still = planned.motion.qd[:, place] == 0.0
        if not (still[1:-1] & still[2:] & still[:-2]).any():
            continue
        time = float(planned.times[int(np.argmax(still[1:] & still[:-1]))])
        found.append(
            f"joint {forces[0].name!r} stands still from t = {time:.6g} s on: {_bounds(forces)}, so its actuator "
            "torque is not determined there; reported is the torque without them"
        )
    return found


def _bounds(forces: Sequence[JointForce]) -> str:
    """Say what may act in a joint at rest."""
    parts = []
    for force in forces:
        if isinstance(force.element, Friction):
            plus, minus = force.element.breakaway(force.gear_ratio)
            parts.append(f"its friction is anything from {-minus:.6g} to {plus:.6g} {TORQUE[force.unit]}")
        else:
            parts.append("its gear bears a part of the load")
    return " and ".join(parts)


def _dry(model: Model) -> dict[int, list[JointForce]]:
    """Return dry friction and gears by the velocity coordinates on which they act, those in space left out.

    A rotation in space stands still only where all of its rates vanish, which rounding does not bring about in one
    that turns.
    """
    found: dict[int, list[JointForce]] = {}
    for force in (f for body in model.bodies for f in body.forces if not f.in_space):
        if isinstance(force.element, Gear) or (isinstance(force.element, Friction) and force.element.dry):
            found.setdefault(force.v, []).append(force)
    return found

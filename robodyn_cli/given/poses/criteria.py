"""What decides between the positions that meet a task: rows c(q), of which |c|^2 is to be small."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum

import numpy as np

from robodyn_cli.algorithms.kinematics import position_rates
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import torque_terms
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.calculus import directional, substitute
from robodyn_cli.expr.fixed import derived
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.given.poses.limits import PositionLimits
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import size_number
from robodyn_cli.spatial.algebra import Matrix, identity, vector, zeros


class Criterion(str, Enum):
    """What is to be small.

    NEAREST : the way from a given position, in rad and in sizes of the mechanism. LIMITS : the way from the middle of
    the joints' limits, as parts of half the range. TORQUE : the torques that hold the arm, as parts of the joints'
    ``effort`` limits where all have one.
    """

    NEAREST = "nearest"
    LIMITS = "away_from_limits"
    TORQUE = "least_torque"


@record
class Given:
    """What criteria refer to: the symbols of a position near and of the limits, and the sizes of coordinates (nv,)."""

    near: Sequence[Expr]
    limits: PositionLimits
    lower: Sequence[Expr]
    upper: Sequence[Expr]
    lengths: Sequence[float]


def criterion_rows(criterion: Criterion, problem: Problem, given: Given) -> tuple[list[Scalar], Matrix]:
    """Return c (k,) and C (k, nv) = dc/dq.

    Raises
    ------
    CapabilityError : the criterion has no meaning for the mechanism.
    """
    if criterion is Criterion.NEAREST:
        return _nearest(problem, given)
    if criterion is Criterion.LIMITS:
        return _away_from_limits(problem, given)
    return _torques(problem)


def _nearest(problem: Problem, given: Given) -> tuple[list[Scalar], Matrix]:
    model, q, near = problem.model, problem.q, given.near
    c: list[Scalar] = []
    for body in model.bodies:
        own = slice(body.q, body.q + body.joint.nq)
        c += list(body.joint.difference(vector(near[own]), vector(q[own])))
    # of an attitude too, as long as it is near
    C = identity(model.nv)
    for k, unit in enumerate(given.lengths):
        c[k], C[k, k] = c[k] / unit, 1.0 / unit
    return c, C


def _away_from_limits(problem: Problem, given: Given) -> tuple[list[Scalar], Matrix]:
    limits = given.limits
    both = [
        k for k in range(len(limits.places)) if np.isfinite(limits.lower[k]) and np.isfinite(limits.upper[k])
    ]
    if not both:
        raise CapabilityError(
            f"criterion {Criterion.LIMITS.value} needs joints with `limits: {{lower, upper}}`; there are none"
        )
    c: list[Scalar] = []
    C = zeros(len(both), problem.model.nv)
    for row, k in enumerate(both):
        lower, upper = given.lower[k], given.upper[k]
        scale = 2.0 / (upper - lower)
        c.append((problem.q[limits.places[k]] - 0.5 * (lower + upper)) * scale)
        C[row, limits.velocities[k]] = scale
    return c, C


def holding_torques(problem: Problem) -> list[Scalar]:
    """Return the torques (nv,) that hold an open chain at q, at rest and at t = 0.

    Raises
    ------
    CapabilityError : loops share the load.
    """
    if problem.model.closures:
        raise CapabilityError(
            f"criterion {Criterion.TORQUE.value} fits open chains; in a mechanism with loops actuators share the load"
        )
    total = zeros(problem.model.nv)
    for name, term in torque_terms(problem).items():
        if name not in ("inertia", "coriolis"):
            total = total + term
    rest = {symbol.index: 0.0 for symbol in (problem.t, *problem.v, *problem.a)}
    return substitute(list(total), dict(rest))


def efforts(scene: Scene, problem: Problem) -> list[float] | None:
    """Return the effort limits (nv,) of the joints, None where one has none."""
    by_joint = {joint.name: dict(joint.forces).get("limits") for joint in scene.robot.joints}
    found = [by_joint.get(name) for name in problem.model.v_names]
    values = [None if limits is None else limits.effort for limits in found]
    return None if any(x is None for x in values) else [x for x in values if x is not None]


def _torques(problem: Problem) -> tuple[list[Scalar], Matrix]:
    model = problem.model
    tau = holding_torques(problem)
    scales = efforts(problem.scene, problem)
    if scales is None:
        # torques at arm's length: comparable numbers, of the order of one
        masses = [body.inertia.m for body in model.bodies if isinstance(body.inertia.m, float)]
        g = [x for x in model.gravity if isinstance(x, float)]

        def weight(x: Sequence[float]) -> list[float]:
            return [max(sum(x[len(g) :]) * (math.hypot(*x[: len(g)]) or 1.0), 1e-300)]

        scales = [derived(weight, [*g, *masses])[0] * size_number(model)] * model.nv
    c = [x / scale for x, scale in zip(tau, scales)]
    C = zeros(len(c), model.nv)
    for k in range(model.nv):
        unit = [float(j == k) for j in range(model.nv)]
        for row, entry in enumerate(directional(c, problem.q, position_rates(model, problem.q, unit))):
            C[row, k] = entry
    return c, C

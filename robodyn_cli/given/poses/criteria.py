"""What decides between the positions that meet a task: rows c(q), of which |c|^2 is to be small.

Limits of positions: as numbers for compiled steps, where to start within them, and whole turns back into them.
"""

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
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.observe.joint_limits import limited_joints
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.spans import sides
from robodyn_cli.solve.closure import size_number
from robodyn_cli.spatial.algebra import Array, Matrix, identity, vector, zeros


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
    """Return the effort limits (nv,) of the joints, of the larger side, None where one has none."""
    by_column = [scene.robot.limits_of(name) for name in problem.model.v_names]
    values = [None if limits is None else limits.effort for limits in by_column]
    return (
        None if any(x is None for x in values) else [max(map(abs, sides(x))) for x in values if x is not None]
    )


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


TURN = 2.0 * math.pi
TRAVEL = 1.5  # sizes of the mechanism to which a slide without limits may go, to either side
ROUNDING = 1e-9  # rad or m by which a limit may be passed


@record
class PositionLimits:
    """The joints with a limit of position: names, places in q and v; lower and upper limits (k,), or infinity."""

    names: tuple[str, ...]
    places: list[int]
    velocities: list[int]
    lower: Array
    upper: Array

    @staticmethod
    def of(scene: Scene, model: Model, respected: bool = True) -> PositionLimits:
        """Return the limits of a scene; none where they are not to be respected."""
        joints = [
            joint
            for joint in (limited_joints(scene, model) if respected else [])
            if joint.limits.lower is not None or joint.limits.upper is not None
        ]
        lower = [-math.inf if x.limits.lower is None else float(x.limits.lower) for x in joints]
        upper = [math.inf if x.limits.upper is None else float(x.limits.upper) for x in joints]
        return PositionLimits(
            tuple(x.name for x in joints),
            [x.place for x in joints],
            [x.velocity for x in joints],
            np.array(lower, dtype=float),
            np.array(upper, dtype=float),
        )

    @property
    def numbers(self) -> Array:
        """The parameters of compiled steps: lower limits, then upper ones; one entry where there are none."""
        return np.concatenate([self.lower, self.upper]) if self.places else np.zeros(1)

    def excess(self, q: Array) -> Array:
        """Return by how much positions q (..., nq) are beyond each limit (..., k), 0 within."""
        own = q[..., self.places]
        return np.maximum(0.0, np.maximum(self.lower - own, own - self.upper))

    def within(self, q: Array) -> Array:
        """Tell which positions q (..., nq) are within all limits."""
        out: Array = self.excess(q).max(axis=-1, initial=0.0) <= ROUNDING
        return out

    def spread(self, points: Array, model: Model, size: float) -> Array:
        """Return positions (T, nq) for points (T, nv) of the unit cube: between the limits, else whole turns."""
        manifold = Manifold(model)
        low = np.array([-math.pi if unit == "rad" else -TRAVEL * size for unit in model.v_units])
        high = -low
        for k, lower, upper in zip(self.velocities, self.lower, self.upper):
            wide = high[k] - low[k]
            if math.isfinite(lower) and math.isfinite(upper):
                low[k], high[k] = lower, upper
            elif math.isfinite(lower):
                low[k], high[k] = lower, lower + wide
            elif math.isfinite(upper):
                low[k], high[k] = upper - wide, upper
        steps = low + points * (high - low)
        return np.array([manifold.integrate(manifold.neutral(), dq) for dq in steps])

    def unwound(self, q: Array, near: Array, model: Model) -> Array:
        """Return q (..., nq) with turning joints changed by whole turns: within the limits, there nearest to ``near``.

        Joints that are tied to others stay as they are.
        """
        if model.closures:
            return q
        out = np.array(q)
        limits = dict(zip(self.places, zip(self.lower, self.upper)))
        for body in model.bodies:
            if body.joint.dh_variable != "theta":
                continue
            x, wanted = out[..., body.q], near[..., body.q]
            lower, upper = limits.get(body.q, (-math.inf, math.inf))
            turns = np.round((wanted - x) / TURN)
            turns = np.minimum(turns, np.floor((upper + ROUNDING - x) / TURN))
            most = np.ceil((lower - ROUNDING - x) / TURN)
            # a limit that no whole turn meets is left for the caller to find
            out[..., body.q] = x + TURN * np.maximum(turns, most)
        return out

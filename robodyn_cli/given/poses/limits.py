"""Limits of positions: as numbers for compiled steps, where to start within them, and whole turns back into them."""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.observe.joint_limits import limited_joints
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

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
        found = [
            joint
            for joint in (limited_joints(scene, model) if respected else [])
            if joint.limits.lower is not None or joint.limits.upper is not None
        ]
        lower = [-math.inf if x.limits.lower is None else float(x.limits.lower) for x in found]
        upper = [math.inf if x.limits.upper is None else float(x.limits.upper) for x in found]
        return PositionLimits(
            tuple(x.name for x in found),
            [x.place for x in found],
            [x.velocity for x in found],
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

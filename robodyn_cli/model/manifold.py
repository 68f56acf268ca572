"""Steps of a mechanism's q along the joints' own manifolds, on numbers.

A step of joints with q-dot = v is one sum for all of them; each joint with quasi-velocities makes its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.model.model import Body, Model
from robodyn_cli.spatial.algebra import Array, vector


class Manifold:
    """q (nq,) as points, steps in velocity coordinates (nv,).

    position : for each velocity coordinate its place in q, -1 where it is no rate of a position.
    """

    def __init__(self, model: Model) -> None:
        self.quasi: list[Body] = [body for body in model.bodies if body.joint.quasi]
        self.nq, self.nv = model.nq, model.nv
        self.position = np.full(model.nv, -1)
        neutral = np.zeros(model.nq)
        for body in model.bodies:
            if not body.joint.quasi:
                self.position[body.v : body.v + body.joint.nv] = range(body.q, body.q + body.joint.nq)
            neutral[body.q : body.q + body.joint.nq] = body.joint.neutral()
        self._neutral = neutral
        self._from = np.flatnonzero(self.position >= 0)
        self._to = self.position[self._from]

    def columns(self, velocity: int) -> range:
        """Return the places in q of what a velocity coordinate moves: one, or all of a joint with quasi-velocities."""
        if self.position[velocity] >= 0:
            return range(self.position[velocity], self.position[velocity] + 1)
        body = next(b for b in self.quasi if b.v <= velocity < b.v + b.joint.nv)
        return range(body.q, body.q + body.joint.nq)

    def rate(self, q: Array, v: Array) -> Array:
        """Return q-dot (nq,) at position q (nq,) and velocity v (nv,)."""
        out = np.zeros(self.nq)
        out[self._to] = v[self._from]
        for body in self.quasi:
            here, there = self._slices(body)
            out[here] = _numbers(body.joint.velocity_map(_vector(q[here]), _vector(v[there])))
        return out

    def rates(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Return q-dot and q-ddot (nq,) at position q (nq,), velocity v and acceleration a (nv,)."""
        first, second = self.rate(q, v), np.zeros(self.nq)
        second[self._to] = a[self._from]
        for body in self.quasi:
            here, there = self._slices(body)
            at, w, rate = _vector(q[here]), _vector(v[there]), _vector(first[here])
            # q-dot = N(q) v, N of at most the second degree in q: differences over unit lengths are exact
            bent = body.joint.velocity_map(at + rate, w) - body.joint.velocity_map(at - rate, w)
            second[here] = _numbers(body.joint.velocity_map(at, _vector(a[there])) + 0.5 * bent)
        return first, second

    def neutral(self) -> Array:
        """Return the position at which every joint's transform is the identity."""
        return self._neutral.copy()

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return the position reached from ``q`` with constant velocity ``dq`` in unit time."""
        out = q.copy()
        out[self._to] += dq[self._from]
        for body in self.quasi:
            here, there = self._slices(body)
            out[here] = _numbers(body.joint.integrate(_vector(q[here]), _vector(dq[there])))
        return out

    def difference(self, q0: Array, q1: Array) -> Array:
        """Return the velocity (nv,) that leads from q0 to q1 in unit time."""
        out = np.zeros(self.nv)
        out[self._from] = q1[self._to] - q0[self._to]
        for body in self.quasi:
            here, there = self._slices(body)
            out[there] = _numbers(body.joint.difference(_vector(q0[here]), _vector(q1[here])))
        return out

    def normalise(self, q: Array) -> Array:
        """Return ``q`` put back on the manifold."""
        out = q.copy()
        for body in self.quasi:
            here, _ = self._slices(body)
            out[here] = _numbers(body.joint.normalise(_vector(q[here])))
        return out

    @staticmethod
    def _slices(body: Body) -> tuple[slice, slice]:
        return slice(body.q, body.q + body.joint.nq), slice(body.v, body.v + body.joint.nv)


def _vector(x: Array) -> Any:
    return vector(x.tolist())


def _numbers(x: Any) -> Array:
    return np.array([float(e) for e in x])

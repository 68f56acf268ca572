"""Limits of a scene's joints along a path, as rows of the path's acceleration."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn_cli.fastest.rows import FINE, PLACES, Passed, Rows
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import JointMotion

INSET = 1e-9  # of a segment: its ends are looked at from inside, as friction and splines may jump there
LINEAR = 1e-9  # of the limits, up to which forces count as linear in x
TINY = 1e-12

Torques = Callable[[Array, Array, Array], Array]


@record
class LimitedPath:
    """A path q(s), the torques of its robot, and the limits.

    motion : q, dq/ds and d2q/ds2 at many s. torques : tau (T, nv) of q, qd, qdd.
    speed, acceleration, effort : places in v, and bounds, of the joints that have one.
    """

    motion: Callable[[Array], JointMotion]
    torques: Torques
    speed: tuple[list[int], Array]
    acceleration: tuple[list[int], Array]
    effort: tuple[list[int], Array]

    def at(self, s: Array, places: tuple[float, ...] = PLACES) -> JointMotion:
        """Return the path at places in each segment, K places rows."""
        D = np.diff(s)[:, None]
        inside = np.clip(np.array(places), INSET, 1.0 - INSET)
        return self.motion((s[:-1, None] + D * inside).ravel())

    def torques_at(self, way: JointMotion, u: Array, x: Array) -> Array:
        """Return the limited torques (T, n) at speeds and accelerations (T,), in parts of their limits."""
        places, bounds = self.effort
        if not places:
            return np.zeros((len(u), 0))
        qd = np.asfortranarray(way.qd * np.sqrt(x)[:, None])
        qdd = np.asfortranarray(way.qd * u[:, None] + way.qdd * x[:, None])
        return np.asarray(self.torques(way.q, qd, qdd)[:, places] / bounds)

    def typical(self, way: JointMotion, length: float) -> float:
        """Return an x of the size that the limits allow."""
        zero = np.zeros(len(way.q))
        u = [np.abs(self.torques_at(way, zero + 1.0, zero) - self.torques_at(way, zero, zero))]
        places, bounds = self.acceleration
        u.append(np.abs(way.qd[:, places]) / bounds)
        steepest = np.concatenate(u, axis=1).max(axis=1)
        return length / float(np.median(steepest)) / 2.0 if np.median(steepest) > 0.0 else 1.0


class PathLimits:
    """The rows of a path on any grid; those of the last grid are kept while only the profile changes."""

    def __init__(self, path: LimitedPath) -> None:
        self.path = path
        self.grid: Array | None = None
        self.typical: float | None = None
        self.fine: tuple[Array, JointMotion] | None = None
        self.linear = True

    def __call__(self, s: Array, x: Array | None) -> Rows:
        """Return the rows on a grid (K + 1,); forces that are not linear in x as tangents at x (K, 3)."""
        if self.grid is None or s is not self.grid:
            self.grid, self.way = s, self.path.at(s)
            if self.typical is None:
                self.typical = self.path.typical(self.way, float(s[-1] - s[0]))
            zero = np.zeros(len(self.way.q))
            self.still = self.path.torques_at(self.way, zero, zero)
            self.inertia = self.path.torques_at(self.way, zero + 1.0, zero) - self.still
        assert self.typical is not None
        at = (
            np.full(len(self.way.q), self.typical)
            if x is None
            else np.maximum(x.ravel(), TINY * self.typical)
        )
        low, high = self._forces(0.5 * at), self._forces(1.5 * at)
        here = 0.5 * (low + high) if x is not None and self.linear else self._forces(at)
        if x is None:
            off = np.abs(0.5 * (low + high) - here) / np.maximum(1.0, np.abs(here))
            self.linear = not off.size or bool(off.max() < LINEAR)
        slope = (high - low) / at[:, None]
        return self._rows(slope, here - slope * at[:, None])

    def passed(self, s: Array, u: Array, x: Array) -> Passed:
        """Return by how much the limits are passed for u and x (K, 9) at the ``FINE`` places, forces as they are."""
        if self.fine is None or self.fine[0] is not s:
            self.fine = s, self.path.at(s, FINE)
        path, way = self.path, self.fine[1]
        flat_u, flat_x = u.ravel()[:, None], x.ravel()[:, None]
        (quick, acceleration), (fast, speed) = path.acceleration, path.speed
        effort = path.torques_at(way, u.ravel(), np.maximum(x.ravel(), TINY * (self.typical or 0.0)))
        qdd = (way.qd[:, quick] * flat_u + way.qdd[:, quick] * flat_x) / acceleration
        squares = np.square(way.qd[:, fast] / speed) * flat_x
        ends = JointMotion(way.q[[0, -1]], way.qd[[0, -1]], way.qdd[[0, -1]])
        still = path.torques_at(ends, flat_u[[0, -1], 0], np.zeros(2))
        values = np.concatenate([effort, qdd], axis=1).reshape(*u.shape, -1)
        at_rest = np.concatenate([still, qdd[[0, -1]]], axis=1)
        return Passed.of(values, squares.reshape(*u.shape, -1), at_rest)

    def _forces(self, x: Array) -> Array:
        return self.path.torques_at(self.way, np.zeros(len(x)), x)

    def _rows(self, slope: Array, offset: Array) -> Rows:
        (places, bounds), way = self.path.acceleration, self.way
        rest = np.zeros((len(way.q), len(places)))
        A = np.concatenate([self.inertia, way.qd[:, places] / bounds], axis=1)
        B = np.concatenate([slope, way.qdd[:, places] / bounds], axis=1)
        C = np.concatenate([offset, rest], axis=1)
        at_rest = np.concatenate([self.still, rest], axis=1)[[0, -1]]
        places, bounds = self.path.speed
        with np.errstate(divide="ignore"):
            most = 1.0 / np.square(way.qd[:, places] / bounds).max(axis=1, initial=0.0)
        three = len(PLACES)
        shape = (len(way.q) // three, three, A.shape[1])
        return Rows(A.reshape(shape), B.reshape(shape), C.reshape(shape), most.reshape(shape[:2]), at_rest)

"""Motion of links in a plane: poles, centrodes and acceleration poles of one against another, curvature of paths.

All from positions, velocities and accelerations at one instant, in world axes, with the normal n of the plane. A link
that turns against another at a rate W, with the acceleration A of turning, while its point at d = 0 has the velocity v
and the acceleration a as seen from the other, has its pole and its acceleration pole at

    d = n x v / W,        d = (W^2 a + A n x a) / (W^4 + A^2).

Where both links are at rest against each other and begin to move, a and A take the place of v and W. Uncertainties are
those that a part ``EPSILON`` of the largest rates and accelerations of the motion leaves.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from robodyn_cli.algorithms.kinematics import motions, velocities, world_pose
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.record import record
from robodyn_cli.solve.guided import CLOSED
from robodyn_cli.spatial.algebra import Array, cross

EPSILON = CLOSED  # part of rates and accelerations that is not known
NOTHING = 1e-11  # part of the largest rates, below which they are rounding
Scales = tuple[float, float, float, float]  # largest w, v, wd and a of all links
FLAT = 1e-8  # part of the largest rates that motion in a plane may have across it


def link_outputs(problem: Problem, names: Iterable[str]) -> dict[str, list[Scalar]]:
    """Return, by ``links/NAME``, the expressions of a link's origin p (3), angular velocity (3), velocity (3), angular
    acceleration (3), acceleration (3) and axes R (9, row by row) in the world."""
    model = problem.model
    speed = velocities(model, problem.X, problem.q, problem.v)
    motion = motions(model, problem.X, problem.q, problem.v, problem.a)
    outputs: dict[str, list[Scalar]] = {}
    for name in names:
        frame = model.links[name]
        pose = world_pose(model, problem.pose, frame)
        to_world = model.base.E.T @ problem.pose[frame.body].R
        here, way = speed[frame.body], motion[frame.body]  # of links welded to the base too
        vectors = (here.w, here.v + cross(here.w, frame.p), way.wd, way.acceleration_of(frame.p))
        outputs[f"links/{name}"] = [*pose.p, *(x for y in vectors for x in to_world @ y), *pose.R.flat]
    return outputs


@record
class LinkMotion:
    """The motion of a link at T samples: p, w, v, wd, a (T, 3) of its origin, and its axes R (T, 3, 3)."""

    p: Array
    w: Array
    v: Array
    wd: Array
    a: Array
    R: Array

    @staticmethod
    def of(array: Array | None, samples: int) -> LinkMotion:
        """Return the motion of an output of ``link_outputs`` (T, 24); None: of the base."""
        if array is None:
            p, w, v, wd, a = np.zeros((5, samples, 3))
            return LinkMotion(p, w, v, wd, a, np.tile(np.eye(3), (samples, 1, 1)))
        p, w, v, wd, a = (array[:, 3 * k : 3 * k + 3] for k in range(5))
        return LinkMotion(p, w, v, wd, a, array[:, 15:].reshape(-1, 3, 3))

    def velocity(self, at: Array) -> Array:
        """Return the velocity of its points at (T, 3)."""
        return np.asarray(self.v + np.cross(self.w, at - self.p))

    def acceleration(self, at: Array) -> Array:
        """Return the acceleration of its points at (T, 3)."""
        d = at - self.p
        return np.asarray(self.a + np.cross(self.wd, d) + np.cross(self.w, np.cross(self.w, d)))

    def seen(self, point: Array) -> Array:
        """Return points (T, 3) of the world in its axes."""
        return np.asarray(np.einsum("tij,ti->tj", self.R, point - self.p))


@record
class PairMotion:
    """Motion of one link as another one sees it: rate W and its derivative A (T,) about the normal n (3,); velocity and
    acceleration (T, 3) of the origin p (T, 3) of the first link's frame; scales : what all links have at most.
    """

    first: LinkMotion
    second: LinkMotion
    normal: Array
    W: Array
    A: Array
    v: Array
    a: Array
    scales: Scales

    @staticmethod
    def of(first: LinkMotion, second: LinkMotion, normal: Array, scales: Scales) -> PairMotion:
        """Return the motion of the first link as the second one sees it (relative motion, with Coriolis')."""
        v = first.v - second.velocity(first.p)
        a = first.a - second.acceleration(first.p) - 2.0 * np.cross(second.w, v)
        W, A = (first.w - second.w) @ normal, (first.wd - second.wd) @ normal
        return PairMotion(first, second, normal, W, A, v, a, scales)

    @property
    def is_flat(self) -> bool:
        """Whether the links move against each other in the plane."""
        w = self.first.w - self.second.w
        across = np.abs(w - self.W[:, None] * self.normal).max()
        return bool(
            across <= FLAT * self.scales[0] and np.abs(self.v @ self.normal).max() <= FLAT * self.scales[1]
        )

    @property
    def still(self) -> float:
        """The rate of turning that is rounding."""
        return NOTHING * self.scales[0]

    def pole(self) -> tuple[Array, Array]:
        """Return the pole in the world (T, 3), nan at infinity, and how far it may be off (T,)."""
        W, v, (w_most, v_most, wd_most, a_most) = self.W.copy(), self.v.copy(), self.scales
        speed = np.linalg.norm(v, axis=1)
        rests = (np.abs(W) <= self.still) & (speed <= NOTHING * v_most)
        W[rests], v[rests] = self.A[rests], self.a[rests]
        least = np.where(rests, NOTHING * wd_most, self.still)
        with np.errstate(divide="ignore", invalid="ignore"):
            d = np.cross(self.normal, v) / W[:, None]
            off = EPSILON * np.where(rests, a_most, v_most) + EPSILON * np.where(rests, wd_most, w_most) * (
                np.linalg.norm(d, axis=1)
            )
            off = off / np.abs(W)
        d[np.abs(W) <= least] = np.nan
        return self.first.p + d, off

    def acceleration_pole(self) -> tuple[Array, Array]:
        """Return the acceleration pole in the world (T, 3), nan at infinity, and how far it may be off (T,)."""
        W, A, (w_most, _, wd_most, a_most) = self.W, self.A, self.scales
        square = W**4 + A**2
        with np.errstate(divide="ignore", invalid="ignore"):
            d = (W[:, None] ** 2 * self.a + A[:, None] * np.cross(self.normal, self.a)) / square[:, None]
            off = (
                EPSILON * (a_most + (wd_most + 2.0 * w_most**2) * np.linalg.norm(d, axis=1)) / np.sqrt(square)
            )
        d[np.sqrt(square) <= NOTHING * (w_most**2 + wd_most)] = np.nan
        return self.first.p + d, off


def scales_of(links: Collection[LinkMotion]) -> Scales:
    """Return the largest angular velocity, velocity, angular acceleration and acceleration of links."""
    w, v, wd, a = (
        max(float(np.abs(getattr(link, name)).max()) for link in links) for name in ("w", "v", "wd", "a")
    )
    return w, v, wd, a


def normal_of(links: Iterable[LinkMotion]) -> Array:
    """Return the normal (3,) of the plane in which links move, z of the world where none turns; of two the one that
    points more along z, y or x."""
    w = np.concatenate([link.w for link in links] or [np.zeros((1, 3))])
    most = w[int(np.argmax((w * w).sum(axis=1)))]
    size = float(np.linalg.norm(most))
    if size == 0.0:
        return np.array([0.0, 0.0, 1.0])
    n = most / size
    lead = next(x for x in n[::-1] if abs(x) > 0.5)
    return np.asarray(n if lead > 0.0 else -n)


def curvature(v: Array, a: Array, normal: Array) -> tuple[Array, Array]:
    """Return the curvature (T,) of a path with velocities v and accelerations a (T, 3), positive to the left about the
    normal, nan at rest, and how far it may be off (T,): k = n . (v x a) / |v|^3."""
    speed = np.linalg.norm(v, axis=1)
    v_most, a_most = float(speed.max()), float(np.linalg.norm(a, axis=1).max())
    with np.errstate(divide="ignore", invalid="ignore"):
        k = np.cross(v, a) @ normal / speed**3
        off = EPSILON * (np.linalg.norm(a, axis=1) * v_most + speed * a_most) / speed**3
        off = off + 3.0 * EPSILON * np.abs(k) * v_most / speed
    k[speed <= NOTHING * v_most] = np.nan
    return k, off


def pressure_angle(line: Array, v: Array, a: Array, normal: Array) -> tuple[Array, Array]:
    """Return the angle (T,) from the way of a point with v and a (T, 3) to a line (T, 3) along which a force acts,
    continued from one within a right angle, and how far it may be off (T,). At rest the way is along a."""
    speed = np.linalg.norm(v, axis=1)
    v_most = float(speed.max())
    rests = speed <= 1e-9 * v_most
    way = np.where(rests[:, None], a, v)
    angle = np.arctan2(np.cross(way, line) @ normal, np.einsum("ti,ti->t", way, line))
    angle = np.unwrap(angle, period=np.pi)
    angle = angle - np.pi * np.round(angle[0] / np.pi)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = EPSILON * (1.0 + v_most / np.where(rests, v_most, speed))
    return angle, off

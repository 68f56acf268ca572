"""A serial arm as axes in its zero position, from which its closed form is recognised.

The two canonical subproblems of rotations about given axes, for many right-hand sides at once.

Paden and Kahan (1986); in the form of Elias and Wen (2025), who build inverse kinematics from them. Vectors are
(3,) or (T, 3), angles (T,).
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

PARALLEL = (
    1e-12  # sine of the angle up to which axes count as parallel, and part of the reach up to which they meet
)


@record
class Axis:
    """A joint's axis in the zero position: place in q, whether it turns, unit direction h and a point p on it."""

    place: int
    turns: bool
    h: Array
    p: Array


@record
class Screws:
    """The axes from the base to a frame, base coordinates; the frame's origin p and axes R at zero; the world's pose.

    scale : the sum of the distances between the axes' points [m], to judge lengths by.
    """

    axes: tuple[Axis, ...]
    p: Array
    R: Array
    E: Array
    r: Array
    nq: int
    scale: float

    @staticmethod
    def of(model: Model, frame: FixedFrame) -> Screws | None:
        """Return the axes, None where joints are tied to each other, of other kinds, or not known as numbers."""
        if frame.body == BASE or model.closures:
            return None
        path = [model.bodies[k] for k in model.path_to(frame.body)]
        if any(not body.joint.dh_variable for body in path):
            return None
        X = transforms(
            model, [0.0] * model.nq if not any(b.joint.quasi for b in model.bodies) else _neutral(model)
        )
        pose = poses(model, X)
        path_poses = [pose[k] for k in model.path_to(frame.body)]
        at = path_poses[-1].point(frame.p)
        entries = [x for here in path_poses for x in (*here.R.flat, *here.p)] + [*at, *frame.R.flat]
        if any(isinstance(x, Expr) for x in (*entries, *model.base.E.flat, *model.base.r)):
            return None
        axes = tuple(
            Axis(body.q, body.joint.dh_variable == "theta", _floats(here.R[:, 2]), _floats(here.p))
            for body, here in zip(path, path_poses)
        )
        points = [np.zeros(3), *(axis.p for axis in axes), _floats(at)]
        scale = float(sum(np.linalg.norm(b - a) for a, b in zip(points, points[1:]))) or 1.0
        R = _floats(path_poses[-1].R @ frame.R)
        return Screws(axes, _floats(at), R, _floats(model.base.E), _floats(model.base.r), model.nq, scale)

    @property
    def turning(self) -> tuple[Axis, ...]:
        return tuple(axis for axis in self.axes if axis.turns)

    def in_base(self, p: Array, R: Array) -> tuple[Array, Array]:
        """Return targets p (T, 3) and R (T, 3, 3) of the world in base coordinates, R as a turn from zero."""
        return (p - self.r) @ self.E.T, self.E @ R @ self.R.T

    def meet(self, first: Axis, second: Axis) -> Array | None:
        """Return the point in which two axes meet, None where they do not or are parallel."""
        n = np.cross(first.h, second.h)
        square = float(n @ n)
        apart = second.p - first.p
        if square < PARALLEL**2 or abs(float(n @ apart)) > PARALLEL * self.scale * np.sqrt(square):
            return None
        along = float(np.cross(apart, second.h) @ n) / square
        out: Array = first.p + along * first.h
        return out

    def passes(self, axis: Axis, point: Array) -> bool:
        """Tell whether an axis goes through a point."""
        return float(np.linalg.norm(np.cross(point - axis.p, axis.h))) <= PARALLEL * self.scale


def parallel(first: Axis, second: Axis) -> bool:
    """Tell whether two axes have one direction, or opposite ones."""
    return float(np.linalg.norm(np.cross(first.h, second.h))) <= PARALLEL


def _neutral(model: Model) -> list[float]:
    return [x for body in model.bodies for x in body.joint.neutral()]


def _floats(x: Array) -> Array:
    return np.array([float(e) for e in x.ravel()]).reshape(x.shape)


def dots(a: Array, b: Array) -> Array:
    """Return a . b row by row."""
    out: Array = np.einsum("...i,...i->...", a, b)
    return out


def rotations(axis: Array, angle: Array) -> Array:
    """Return the rotations (T, 3, 3) by angles (T,) about one unit axis (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # E + sin K + (1 - cos) K^2 as one product
    parts = np.stack([np.eye(3), K, K @ K]).reshape(3, 9)
    out: Array = np.column_stack([np.ones(len(angle)), np.sin(angle), 1.0 - np.cos(angle)]) @ parts
    return out.reshape(-1, 3, 3)


def turned(R: Array, a: Array) -> Array:
    """Return R a row by row, R (T, 3, 3)."""
    return np.einsum("tij,tj->ti", R, np.broadcast_to(a, (len(R), 3)))


def turned_back(R: Array, a: Array) -> Array:
    """Return R^T a row by row, R (T, 3, 3)."""
    return np.einsum("tji,tj->ti", R, np.broadcast_to(a, (len(R), 3)))


def angle_between(axis: Array, first: Array, second: Array) -> Array:
    """Return the angle (T,) about the axis that turns the direction of ``first`` to that of ``second``."""
    sine = dots(axis, np.cross(first, second))
    cosine = dots(first, second) - dots(first, axis) * dots(second, axis)
    out: Array = np.arctan2(sine, cosine)
    return out


@record
class Pair:
    """Two angles (T,) that solve an equation, and by how much the equation fails (0 where there are solutions).

    The derivative of the equation's left side is positive at ``plus`` and negative at ``minus``.
    """

    plus: Array
    minus: Array
    missed: Array


def component_angles(h: Array, axis: Array, p: Array, d: Array) -> Pair:
    """Return the angles at which rot(axis, angle) p has the component d along h; the nearest where there are none.

    h . rot(k, angle) p = (h . k)(k . p) + a sin(angle) + b cos(angle), a = h . (k x p), b = h . p - (h . k)(k . p).
    """
    across = np.cross(axis, p)
    fixed = dots(h, axis) * dots(axis, p)
    a, b = dots(h, across), dots(h, p) - fixed
    size = np.hypot(a, b)
    wanted = d - fixed
    inside = np.sqrt(np.maximum(0.0, (size - wanted) * (size + wanted)))
    half = np.arctan2(inside, wanted)
    middle = np.arctan2(a, b)
    return Pair(middle - half, middle + half, np.maximum(0.0, np.abs(wanted) - size))

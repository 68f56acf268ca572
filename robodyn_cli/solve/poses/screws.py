"""A serial arm as axes in its zero position, from which its closed form is recognised."""

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
        found = [pose[k] for k in model.path_to(frame.body)]
        at = found[-1].point(frame.p)
        entries = [x for here in found for x in (*here.R.flat, *here.p)] + [*at, *frame.R.flat]
        if any(isinstance(x, Expr) for x in (*entries, *model.base.E.flat, *model.base.r)):
            return None
        axes = tuple(
            Axis(body.q, body.joint.dh_variable == "theta", _floats(here.R[:, 2]), _floats(here.p))
            for body, here in zip(path, found)
        )
        points = [np.zeros(3), *(axis.p for axis in axes), _floats(at)]
        scale = float(sum(np.linalg.norm(b - a) for a, b in zip(points, points[1:]))) or 1.0
        R = _floats(found[-1].R @ frame.R)
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

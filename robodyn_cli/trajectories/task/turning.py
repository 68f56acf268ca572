"""How a frame is turned along its path: by turns about fixed axes, or facing along the path or towards a point."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.task import taylor
from robodyn_cli.trajectories.task.curves import ORDER, series_of


class Turning(Protocol):
    """The frame's axes as a function of its place on the path."""

    def axes(self, p: Array, s: Array) -> Array:
        """Return the series (n + 1, T, 3, 3) of R at places s (T,) with positions p (ORDER + 1, T, 3)."""
        ...


class Turns:
    """R = R0 exp(turn_1 b_1(s)) exp(turn_2 b_2(s)) ..., each b from 0 to 1: spherical linear interpolation by parts.

    Parameters
    ----------
    R0 : (3, 3). turns : rotation vectors (3,) in the frame's axes. parts : b of each.
    """

    def __init__(self, R0: Array, turns: Sequence[Array], parts: Sequence[Course]) -> None:
        self.R0, self.turns, self.parts = R0, turns, parts

    def axes(self, p: Array, s: Array) -> Array:
        R = taylor.constant(self.R0, p)
        for turn, part in zip(self.turns, self.parts):
            angle = float(np.linalg.norm(turn))
            if angle == 0.0:
                continue
            x, y, z = turn / angle
            K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            sine, cosine = taylor.sine_and_cosine(angle * series_of(part, s, ORDER)[..., 0])
            versine = -cosine
            versine[0] += 1.0
            turned = sine[..., None, None] * K + versine[..., None, None] * (K @ K)
            turned[0] += np.eye(3)
            R = taylor.multiplied(R, turned)
        return R


class Attitudes:
    """The cubic spline through unit quaternions, made of length 1 at every place: rates and their rates are continuous.

    Parameters
    ----------
    places : (N,), increasing. axes : (N, 3, 3), from each to the next by the shorter turn.
    """

    def __init__(self, places: Array, axes: Sequence[Array]) -> None:
        from scipy.interpolate import CubicSpline  # takes long to import: only where it is used

        q = [quaternion.from_rotation_vector(quaternion.logarithm(axes[0]))]
        for before, after in itertools.pairwise(axes):
            q.append(quaternion.product(q[-1], quaternion.from_rotation_vector(turn_between(before, after))))
        self.course = Course(places, CubicSpline(places, np.array(q, dtype=float)).c[::-1])

    def axes(self, p: Array, s: Array) -> Array:
        q = taylor.unit(series_of(self.course, s, ORDER))
        w, (x, y, z) = q[..., 0], np.moveaxis(q[..., 1:], -1, 0)
        zero = np.zeros_like(w)
        V = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), (0, 1), (-2, -1))
        # R = 1 + 2 w V + 2 V V with V = [v]x
        R = 2.0 * (taylor.scaled(w, V) + taylor.multiplied(V, V))
        R[0] += np.eye(3)
        return R


class Facing:
    """One axis of the frame along the path or towards a point, the axis after the next one as near to ``up`` as can be.

    Parameters
    ----------
    point : (3,), None for the tangent of the path. axis : 0, 1, 2. up : (3,).
    """

    def __init__(self, point: Array | None, axis: int, up: Array) -> None:
        self.point, self.axis, self.up = point, axis, up

    def axes(self, p: Array, s: Array) -> Array:
        if self.point is None:
            n = len(p) - 1
            way = p[1:] * np.arange(1, n + 1).reshape(n, 1, 1)
        else:
            way = -p
            way[0] += self.point
        forward = taylor.unit(way)
        side = taylor.unit(taylor.crossed(taylor.constant(self.up, forward), forward))
        columns = {
            self.axis: forward,
            (self.axis + 1) % 3: side,
            (self.axis + 2) % 3: taylor.crossed(forward, side),
        }
        return np.stack([columns[k] for k in range(3)], axis=-1)


def turn_between(R: Array, to: Array) -> Array:
    """Return the rotation vector (3,), in the axes of R, of the shorter turn to other axes."""
    turn = quaternion.logarithm(R.T @ to)
    return turn if math.hypot(*turn) > 1e-12 else np.zeros(3)  # rounding is no turn

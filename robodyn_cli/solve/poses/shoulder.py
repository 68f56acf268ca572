"""What the six-axis families share: the first axis with its two sides, then two parallel axes as shoulder and elbow."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.planar_2r import two_bars
from robodyn_cli.solve.poses.screws import Axis
from robodyn_cli.solve.poses.subproblems import (
    angle_between,
    component_angles,
    dots,
)
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import ELBOWS, SIDES


@record
class Shoulder:
    """The first axis and the parallel second one, with a point that the arm carries at a known height along the latter.

    first, second : the axes. end : the point in the zero position. forward : +1 or -1, which side of the first axis
    along (h1 x h2) counts as the front: the one on which the point, or else the elbow, is in the zero position.
    """

    first: Axis
    second: Axis
    end: Array
    forward: float

    @staticmethod
    def of(first: Axis, second: Axis, elbow: Array, end: Array) -> Shoulder:
        """Return the shoulder of an arm whose second and third axes are parallel."""
        front = np.cross(first.h, second.h)
        sides = [float(front @ (x - first.p)) for x in (end, elbow)]
        scale = max(float(np.linalg.norm(end - first.p)), float(np.linalg.norm(elbow - first.p)))
        clear = [x for x in sides if abs(x) > 1e-9 * scale]
        return Shoulder(first, second, end, float(np.sign(clear[0])) if clear else 1.0)

    def angles(self, target: Array) -> Iterator[tuple[str, float, Array]]:
        """Give q1 (T,) for targets (T, 3) of the point: h2 . rot(h1, -q1) x is known.

        Before it come the name of the side to which the arm reaches, and its sign along h1 x h2.
        """
        lever = target - self.first.p
        height = np.full(len(target), float(self.second.h @ (self.end - self.first.p)))
        pair = component_angles(self.second.h, -self.first.h, lever, height)
        # the derivative of the height by q1 is h2 . (-h1 x u) = (h1 x h2) . u: how far in front the point u lies
        sides = ((1.0, pair.plus), (-1.0, pair.minus))
        for name, (sign, q1) in zip(SIDES, sides if self.forward > 0.0 else sides[::-1]):
            yield name, sign, q1


def two_links(h: Array, upper: Array, lower: Array, target: Array) -> Iterator[tuple[float, Array, Array]]:
    """Give the angles (T,) of shoulder and elbow, both about h, for which two links reach a target.

    upper, lower : (3,) in the zero position. target : (T, 3) from the shoulder, at their height along h. The first
    entry is the sign of the bend, that of h . (upper x lower) as they are then.
    """
    flat = target - np.outer(dots(target, h), h)
    u, w = upper - h * (h @ upper), lower - h * (h @ lower)
    bend, lean = two_bars(float(np.linalg.norm(u)), float(np.linalg.norm(w)), np.linalg.norm(flat, axis=1))
    towards, at_zero = angle_between(h, np.broadcast_to(u, flat.shape), flat), angle_between(h, u, w)
    for sign in (1.0, -1.0):
        yield sign, towards - sign * lean, sign * bend - at_zero


def elbow_name(bend: float, side: float) -> str:
    """Return whether the elbow is on the side of h1: the bend's sign about h2, for an arm that reaches to that side."""
    return ELBOWS[0] if bend * side < 0.0 else ELBOWS[1]

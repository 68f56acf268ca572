"""The torques that a motor bears at each speed, and how much of them a point of a duty cycle uses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

Points = Sequence[tuple[float, float]]


@record
class Envelope:
    """A curve of torque over speed from standstill to the largest speed, where it falls to zero.

    speeds (n,) [rad/s], torques (n,) [N m], none negative. Every ray from rest crosses the curve once, so that
    ``use`` is defined.
    """

    speeds: Array
    torques: Array

    @staticmethod
    def through(points: Points) -> Envelope:
        """Return the curve through points (speed, torque), closed at the largest speed."""
        last = points[-1]
        closed = [*points, (last[0], 0.0)] if last[1] > 0.0 else list(points)
        speeds, torques = np.array(closed, dtype=float).T
        return Envelope(speeds, torques)

    @property
    def top_speed(self) -> float:
        """The largest speed [rad/s]."""
        return float(self.speeds[-1])

    def use(self, speed: Array, torque: Array) -> Array:
        """Return how much of the curve points (speed [rad/s], torque [N m]) use, shaped as these.

        The number s >= 0 for which (speed / s, torque / s) lies on the curve: up to 1 the point is inside, and a
        motor that is s times as fast and s times as strong just bears it. Signs do not matter.
        """
        w, T = np.broadcast_arrays(np.abs(speed), np.abs(torque))
        angles = np.arctan2(self.torques, self.speeds)[::-1]  # rising
        edge = np.clip(np.searchsorted(angles, np.arctan2(T, w), side="right"), 1, len(angles) - 1)
        k = len(angles) - 1 - edge  # the edge from vertex k to k + 1
        dw, dT = np.diff(self.speeds)[k], np.diff(self.torques)[k]
        found: Array = (w * dT - T * dw) / (self.speeds[k] * dT - self.torques[k] * dw)
        return found


def curve_problems(points: Points) -> Iterable[tuple[tuple[int, ...], str]]:
    """Yield what is wrong with rows of speed and torque: the place of a number, and what is wrong."""
    if points[0][0] != 0.0:
        yield (0, 0), f"the first speed is 0 (value {points[0][0]:g})"
        return
    for k, (speed, torque) in enumerate(points):
        last = k == len(points) - 1
        if torque < 0.0 or (torque == 0.0 and not last):
            allowed = "a number >= 0" if last else "a number > 0, but for the last row"
            yield (k, 1), f"is no torque of an envelope (value {torque:g}); allowed: {allowed}"
            return
        if k and not speed > points[k - 1][0]:
            yield (k, 0), f"speeds must increase (value {speed:g} after {points[k - 1][0]:g})"
            return
        if k > 1 and not math.atan2(torque, speed) < math.atan2(points[k - 1][1], points[k - 1][0]):
            yield (k, 1), f"the torque must not rise faster than the speed (value {torque:g})"
            return

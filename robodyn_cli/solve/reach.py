"""Failures of following a target; the caller turns these into messages that name the point.

When a target gets out of reach, and when it is farthest, are times of the motion, not of its samples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn_cli.spatial.algebra import Array

Miss = Callable[[Array], Array]  # distances (n,) [m] to what is reached at times (n,) [s]
PARTS, ROUNDS = 32, 7  # into which a bracket is divided, and how often


def leaving(miss: Miss, low: float, high: float, limit: float) -> float:
    """Return when a miss passes a limit that it keeps at ``low`` [s] and not at ``high``."""
    for _ in range(ROUNDS):
        times = np.linspace(low, high, PARTS + 1)
        k = max(1, int(np.argmax(~(miss(times) <= limit))))
        low, high = float(times[k - 1]), float(times[k])
    return high


def farthest(miss: Miss, low: float, high: float) -> tuple[float, float]:
    """Return when a miss that rises and falls between two times [s] is largest, and how large."""
    for _ in range(ROUNDS):
        times = np.linspace(low, high, PARTS + 1)
        k = int(np.argmax(miss(times)))
        low, high = float(times[max(k - 1, 0)]), float(times[min(k + 1, PARTS)])
    time = 0.5 * (low + high)
    return time, float(miss(np.array([time]))[0])


class Unreachable(Exception):
    """A target that is out of reach. time, distance : since when [s], and the distance to the nearest reachable
    point there [m].
    worst_time, worst : the same where it is farthest. nearest : whether the distances are those of the
    nearest reachable point, or only of the nearest one that was found.
    """

    def __init__(
        self, time: float, distance: float, worst_time: float, worst: float, nearest: bool = True
    ) -> None:
        super().__init__("unreachable")
        self.time, self.distance = float(time), distance
        self.worst_time, self.worst = float(worst_time), worst
        self.nearest = nearest


class Singular(Exception):
    """A configuration on the way in which the point cannot move in every direction that its path may need.

    measure : the smallest singular value of the Jacobian over the largest, or |sin beta| of a 2R arm. joint : the place
    of the velocity coordinate that moves most where the target does not, None where that is not known.
    """

    def __init__(self, time: float, measure: float, joint: int | None = None) -> None:
        super().__init__("singular")
        self.time, self.measure, self.joint = float(time), measure, joint

"""Failures of following a target; the caller turns these into messages that name the point."""

from __future__ import annotations


class Unreachable(Exception):
    """A target that is out of reach. time, distance : the first such time [s] and the distance to the nearest
    reachable point there [m].
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

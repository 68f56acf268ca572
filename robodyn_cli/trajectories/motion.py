"""What a trajectory yields: joint motion, or the motion asked of a point.

A trajectory is one of two kinds, told apart by their base: ``JointSpaceTrajectory``, whose ``motion`` is that of
joints, and ``TaskSpaceTrajectory``, whose ``target`` is asked of a point, or of a frame with its axes (``solve`` finds
the joints then). Times run from 0 to its ``duration``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class JointMotion:
    """Positions, rates and accelerations of the joints at T times, columns in the order of the joints asked.

    q : (T, nq) [rad or m]. qd : (T, nv) [rad/s or m/s]. qdd : (T, nv) [rad/s^2 or m/s^2].
    All in column order, which compiled kernels read in place.
    """

    q: Array
    qd: Array
    qdd: Array


# the motion at times (T,) near positions (T, nq), None where it is not known to be that
Near = Callable[[Array, Array], "JointMotion | None"]


@record
class PointMotion:
    """Position [m], velocity [m/s] and acceleration [m/s^2] asked of a point at T times, world coordinates.

    p, pd, pdd : (T, 3), or (T, 2) where only x and y are asked for and z is left free. R : none are asked for.
    """

    R: ClassVar[None] = None

    p: Array
    pd: Array
    pdd: Array

    @property
    def values(self) -> Array:
        """What is asked for as numbers, a row for each time."""
        return self.p

    @property
    def rates(self) -> Array:
        return self.pd

    @property
    def accelerations(self) -> Array:
        return self.pdd


@record
class PoseMotion:
    """Pose asked of a frame at T times, world coordinates: the motion of its origin, and that of its axes.

    p, pd, pdd : (T, 3) as of ``PointMotion``. R : (T, 3, 3), the frame's axes as columns. w, wd : (T, 3) angular
    velocity [rad/s] and acceleration [rad/s^2].
    """

    p: Array
    pd: Array
    pdd: Array
    R: Array
    w: Array
    wd: Array

    @property
    def values(self) -> Array:
        """What is asked for as numbers, a row for each time: p, then R row by row."""
        return np.concatenate([self.p, self.R.reshape(len(self.R), 9)], axis=1)

    @property
    def rates(self) -> Array:
        """p-dot and w (T, 6)."""
        return np.concatenate([self.pd, self.w], axis=1)

    @property
    def accelerations(self) -> Array:
        """p-ddot and w-dot (T, 6)."""
        return np.concatenate([self.pdd, self.wd], axis=1)


def in_frame(motion: PointMotion | PoseMotion, origin: PointMotion, R: Array) -> PointMotion | PoseMotion:
    """Return in the world's coordinates a motion that is given in those of a frame with fixed axes R (3, 3).

    origin : the motion of the frame's origin, at the same T times or, at rest, at one.
    """
    place = (np.asfortranarray(x @ R.T) for x in (motion.p, motion.pd, motion.pdd))
    moved = PointMotion(*(x + y for x, y in zip(place, (origin.p, origin.pd, origin.pdd))))
    if isinstance(motion, PointMotion):
        return moved
    return PoseMotion(moved.p, moved.pd, moved.pdd, R @ motion.R, motion.w @ R.T, motion.wd @ R.T)


@record
class Asked:
    """What is asked at T times: values (T, k), rates and accelerations (T, m)."""

    values: Array
    rates: Array
    accelerations: Array


def column_order(columns: Sequence[Any], samples: int) -> Array:
    """Return columns (arrays of T samples, or numbers held over all of them) as an array (T, n)."""
    out = np.empty((samples, len(columns)), order="F")
    for k, column in enumerate(columns):
        out[:, k] = column
    return out

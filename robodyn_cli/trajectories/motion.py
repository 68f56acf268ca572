"""What a trajectory yields, joint motion or the motion asked of a point; which columns of q and v it leads, and
trajectories in place of the formulas of prescribed motions.

A trajectory is one of two kinds, told apart by their base: ``JointSpaceTrajectory``, whose ``motion`` is that of
joints, and ``TaskSpaceTrajectory``, whose ``target`` is asked of a point, or of a frame with its axes (``solve`` finds
the joints then). Times run from 0 to its ``duration``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr
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


FOLLOW = "trajectory"  # in place of formulas
POSITION = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
VELOCITY = ("vx", "vy", "vz", "wx", "wy", "wz")
FORMS = ("quaternion", "rpy", "rotation_vector")  # of an attitude


def led_joints(names: Iterable[str]) -> tuple[str, ...]:
    """Return columns as they are, and the joints whose attitude is given in any form (``ball.rpy``) by their names."""
    attitudes = {name.rpartition(".")[0] for name in names if name.rpartition(".")[2] in FORMS}
    joints = [(name.rpartition(".")[0], name) for name in names]
    return tuple(dict.fromkeys(joint if joint in attitudes else name for joint, name in joints))


def position_columns(names: Collection[str]) -> tuple[str, ...]:
    """Return the columns of q that are given; those of a quaternion for an attitude in any form."""
    columns: dict[str, None] = {}
    for name in names:
        joint, _, form = name.rpartition(".")
        columns |= dict.fromkeys(f"{joint}.{x}" for x in QUATERNION) if form in FORMS else {name: None}
    return tuple(columns)


def velocity_columns(names: Collection[str]) -> tuple[str, ...]:
    """Return the columns of v that are given."""
    columns: dict[str, None] = {}
    for name in led_joints(names):
        if name in names:
            columns[name] = None
        else:
            places = VELOCITY if f"{name}.x" in names else VELOCITY[3:]
            columns |= dict.fromkeys(f"{name}.{x}" for x in places)
    return tuple(columns)


def with_attitudes(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return columns with the entries of each quaternion as one list, ``ball.quaternion``."""
    found: dict[str, Any] = {}
    for name, value in columns.items():
        joint, _, coordinate = name.rpartition(".")
        if coordinate in QUATERNION:
            found[f"{joint}.quaternion"] = [columns[f"{joint}.{x}"] for x in QUATERNION]
        else:
            found[name] = value
    return found


class Followed:
    """A trajectory, and the expressions that it gives on the graph that has asked last. After its end it is held."""

    def __init__(self, trajectory: Any, until: float) -> None:
        self.trajectory, self.end = trajectory, float(trajectory.duration)
        self.held = until > self.end
        self._asked: Expr | None = None
        self._found: Mapping[str, Any] = {}

    @property
    def breakpoints(self) -> tuple[float, ...] | None:
        """Times at which the motion is not smooth, None where they are to be found from the expressions."""
        knots = self.trajectory.knots
        return None if knots is None else (*knots, *([self.end] if self.held else []))

    def expressions(self, env: Mapping[str, Any]) -> Mapping[str, Any]:
        t = env["t"]
        if self._asked is not t:
            own: Any = t
            if self.held:
                own = t.graph.piecewise(t, (0.0, self.end), ((0.0,), (1.0,)), (0.0, self.end))
            self._found = self.trajectory.expressions(own, {**env, "t": own})
            self._asked = t
        return self._found


class Follows:
    """The motion of one column of q, or of one attitude, in place of its formulas.

    followed : the trajectory; None where it is a path, before the joints' motion along it is found.
    """

    text = FOLLOW

    def __init__(self, followed: Followed | None, name: str) -> None:
        self.followed, self.name = followed, name
        self.where = f"prescribed.{name}"

    def evaluate(self, env: Mapping[str, Any]) -> Any:
        """Return the expression of t, or those of an attitude.

        Raises
        ------
        CapabilityError : the motion is not found.
        """
        if self.followed is None:
            raise CapabilityError(
                "`prescribed: trajectory` finds the joints' motion along a path for a motion in time only; allowed: "
                "simulate, deploy, inverse, kinematics"
            )
        return self.followed.expressions(env)[self.name]


def to_find(columns: Iterable[str]) -> dict[str, Follows]:
    """Return the motion of each joint with these columns of q, which is still to be found."""
    return {name: Follows(None, name) for name in with_attitudes(dict.fromkeys(columns))}


def follow_trajectory(trajectory: Any, until: float) -> dict[str, Follows]:
    """Return the motion of each joint that a trajectory leads, for a run up to the time ``until`` [s]."""
    followed = Followed(trajectory, until)
    return {name: Follows(followed, name) for name in with_attitudes(dict.fromkeys(trajectory.joints))}


def followed_by(prescribed: Mapping[str, Any]) -> Followed | None:
    """Return the trajectory that prescribed motions follow, None where they are formulas."""
    return next((x.followed for x in prescribed.values() if isinstance(x, Follows)), None)


def given_by_formulas(prescribed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the prescribed motions that do not follow a trajectory."""
    return {name: x for name, x in prescribed.items() if not isinstance(x, Follows)}

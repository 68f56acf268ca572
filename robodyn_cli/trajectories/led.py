"""Which columns of q and v a motion leads, and a trajectory in place of the formulas of a prescribed motion."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr

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
    joined: dict[str, Any] = {}
    for name, value in columns.items():
        joint, _, coordinate = name.rpartition(".")
        if coordinate in QUATERNION:
            joined[f"{joint}.quaternion"] = [columns[f"{joint}.{x}"] for x in QUATERNION]
        else:
            joined[name] = value
    return joined


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
        self.where = {"about": (f"prescribed.{name}",)}

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

"""What trajectories in joint space share: the joints' positions as functions of time, with exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.expr.graph import Expr
from robodyn_cli.spatial.algebra import Array, vector
from robodyn_cli.trajectories.base import Trajectory
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.formulas import evaluated, joint_expressions, sampled, texts, time_symbol
from robodyn_cli.trajectories.led import QUATERNION, position_columns, with_attitudes
from robodyn_cli.trajectories.motion import JointMotion


class JointSpaceTrajectory(Trajectory):
    """Base of the trajectories that give the joints' positions as expressions of t.

    Where ``knots`` are None, they are found from the expressions.
    """

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the columns of q by name, as expressions of t.

        The attitude of a joint is a list under the name of its form: ``ball.rpy``, ``ball.rotation_vector``, or
        ``ball.quaternion`` of any length. ``env`` : values for formulas, t and the scene's parameters.
        """
        raise NotImplementedError

    def described(self, column: str) -> str:
        """Return a column of q in words, for messages."""
        return column

    def motion(self, times: Array, joints: Sequence[str], parameters: Mapping[str, float]) -> JointMotion:
        """Return the motion of ``joints``, columns of q, at ``times`` (T,)."""
        t, env = time_symbol(parameters)
        motion = joint_expressions(self.expressions(t, env), joints, t)
        whose = [self.described(column) for column in joints]
        if len(motion.v) < len(motion.q):  # quasi-velocities: a column of v is none of q
            every = "; ".join(dict.fromkeys(whose))
            names = [whose, [every] * len(motion.v), [every] * len(motion.v)]
        else:
            names = [whose] * 3
        return JointMotion(*sampled([motion.q, motion.v, motion.a], np.asarray(times), names))


class CourseTrajectory(JointSpaceTrajectory):
    """Base of those that interpolate the columns of q, of ``joints``, by piecewise polynomials.

    The quaternion of an attitude is interpolated like other columns, and divided by its length.
    """

    def make_course(self) -> Course:
        """Return the columns of q over time."""
        raise NotImplementedError

    @cached_property
    def course(self) -> Course:
        return self.make_course()

    @property
    def knots(self) -> tuple[float, ...]:
        return tuple(self.course.knots[1:-1].tolist())

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        return with_attitudes(dict(zip(self.joints, self.course.expressions(t))))

    def motion(self, times: Array, joints: Sequence[str], parameters: Mapping[str, float]) -> JointMotion:
        if attitude_places(joints):
            return super().motion(times, joints, parameters)
        places = [self.joints.index(name) for name in joints]
        return JointMotion(*(np.asfortranarray(self.course(times, k)[:, places]) for k in range(3)))


class JointsTogether(JointSpaceTrajectory):
    """The motion of prescribed joints, and of those that a trajectory in joint space leads, if there is one."""

    def __init__(self, prescribed: Mapping[str, Any], trajectory: Any) -> None:
        self.prescribed, self.trajectory = prescribed, trajectory

    @property
    def joints(self) -> tuple[str, ...]:
        return (*self.prescribed, *(self.trajectory.joints if self.trajectory is not None else ()))

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        columns = {} if self.trajectory is None else self.trajectory.expressions(t, env)
        return {**columns, **evaluated(self.prescribed, env)}

    def described(self, column: str) -> str:
        if self.trajectory is None or column not in position_columns(self.trajectory.joints):
            return texts(self.prescribed, column)
        return str(self.trajectory.described(column))


def attitude_places(columns: Sequence[str]) -> dict[str, list[int]]:
    """Return the places of the quaternion of each joint that has one."""
    names = [name.rpartition(".")[0] for name in columns if name.endswith(".qw")]
    return {name: [columns.index(f"{name}.{x}") for x in QUATERNION] for name in names}


def the_shorter_way(columns: Sequence[str], q: Array) -> Array:
    """Return positions (N, n) with the signs of quaternions such that each turns into the next by the shorter way."""
    q = q.copy()
    for places in attitude_places(columns).values():
        for k in range(1, len(q)):
            if q[k, places] @ q[k - 1, places] < 0.0:
                q[k, places] *= -1.0
    return q


def column_rates(
    columns: Sequence[str], q: Array, values: Mapping[str, float], more: Array | None = None
) -> Array:
    """Return the rates (n,) of the columns of q (n,) for velocities by column of v.

    more : rates of q, where ``values`` are accelerations; the columns' second derivatives are returned then.
    """
    from robodyn_cli.spatial import quaternion

    rates = np.array([values.get(name, 0.0) for name in columns])
    for joint, places in attitude_places(columns).items():
        attitude = vector(q[places].tolist())
        w = vector([values.get(f"{joint}.{x}", 0.0) for x in ("wx", "wy", "wz")])
        rates[places] = quaternion.rate(attitude, w)
        if more is not None:
            # d/dt of q (0, w) / 2, with w = 2 q* q-dot
            before = quaternion.angular_velocity(attitude, vector(more[places].tolist()))
            rates[places] = rates[places] + quaternion.rate(vector(more[places].tolist()), before)
        if f"{joint}.x" in columns:
            R = np.array(quaternion.rotation(attitude), dtype=float)
            v = np.array([values.get(f"{joint}.{x}", 0.0) for x in ("vx", "vy", "vz")])
            along = [columns.index(f"{joint}.{x}") for x in ("x", "y", "z")]
            if more is not None:
                v = v + np.cross(np.array(before, dtype=float), R.T @ more[along])
            rates[along] = R @ v
    return rates

"""A simulation whose prescribed joints follow a path: their motion along it, found before it begins."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.record import record
from robodyn_cli.run.fastest.resolve import with_time_law
from robodyn_cli.run.fastest.search import divided
from robodyn_cli.run.mechanism.motion import by_columns, plan_motion, with_led_point
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.joint_space import CourseTrajectory
from robodyn_cli.trajectories.led import (
    follow_trajectory,
    given_by_formulas,
    position_columns,
    velocity_columns,
)
from robodyn_cli.trajectories.quintic_spline import hermite

FIRST = 32  # intervals of the first look
MOST = 20_000  # points
WITHIN = 1e-11  # rad or m: how far the joints may be from the solution of the inverse kinematics
ACCELERATION = 1e-8  # of the largest one: how far their accelerations may be
PARTS = 8  # into which an interval is divided at once
BESIDE = 1e-9  # of the duration: where accelerations are taken on both sides of a knot
SHORT = 1e-6  # of the duration: in an interval so short an acceleration may jump, but no rate


@record
class Interpolated(CourseTrajectory):
    """The motion of joints by quintics through positions, rates and accelerations."""

    joints: tuple[str, ...]
    duration: float
    through: Course

    def make_course(self) -> Course:
        return self.through


def with_motion_found(scene: Scene) -> Scene:
    """Return the scene with the motion of the joints that its path leads; positions of them are where they may start.

    Raises
    ------
    CapabilityError : the joints' rates jump on the way. Others as the inverse kinematics and ``with_time_law`` raise.
    """
    formulas = given_by_formulas(scene.prescribed)
    found = {name: x for name, x in scene.prescribed.items() if name not in formulas}
    columns = position_columns(found)
    bare = with_time_law(dataclasses.replace(scene, prescribed=formulas))
    trajectory: Any = bare.trajectory
    if not hasattr(trajectory, "expressions"):
        trajectory = _interpolated(bare, columns)
    rates = velocity_columns(found)
    initial = dataclasses.replace(
        scene.initial,
        q={name: x for name, x in scene.initial.q.items() if name not in columns},
        qd={name: x for name, x in scene.initial.qd.items() if name not in rates},
    )
    prescribed = {**formulas, **follow_trajectory(trajectory, scene.simulate.duration)}
    return dataclasses.replace(scene, trajectory=trajectory, prescribed=prescribed, initial=initial)


def _interpolated(scene: Scene, columns: tuple[str, ...]) -> Interpolated:
    """Return the motion of columns of q along the path, close to the inverse kinematics between its points too."""
    problem = Problem(with_led_point(scene))
    trajectory: Any = scene.trajectory
    places = [problem.model.q_names.index(name) for name in columns]
    T = float(trajectory.duration)
    knots = np.array([x for x in getattr(trajectory, "knots", None) or () if 0.0 < x < T])
    t = np.unique(np.concatenate([np.linspace(0.0, T, FIRST + 1), knots]))
    while True:
        h, middle = np.diff(t), 0.5 * (t[1:] + t[:-1])
        times = np.unique(np.concatenate([t, middle, knots - BESIDE * T, knots + BESIDE * T]))
        found = by_columns(problem.model, plan_motion(problem, times).motion)
        q, v, a = (x[:, places] for x in found)
        at, between = np.searchsorted(times, t), np.searchsorted(times, middle)
        jumps = np.isin(t, knots)
        course = _through(t, q[at], v[at], (a[at + jumps], a[at - jumps]))
        off = np.abs(course(middle) - q[between]).max(axis=1) / WITHIN
        rough = np.abs(course(middle, 2) - a[between]).max(axis=1) / (ACCELERATION * np.abs(a).max())
        need = np.maximum(off ** (1.0 / 6.0), np.where(h > SHORT * T, rough**0.25, 0.0))
        if need.max() <= 1.0:
            return Interpolated(columns, T, course)
        if len(t) > MOST or h[need > 1.0].min() <= SHORT * T:
            break
        t = divided(t, np.clip(np.ceil(need), 1.0, PARTS))
    where = float(middle[need > 1.0][np.argmin(h[need > 1.0])])
    raise CapabilityError(
        f"the joints' motion along the path of {trajectory.point!r} is not smooth at t = {where:.6g} s, so that no "
        "torque lets a simulation follow it; smooth the path there, or let it come to a stop",
        time=where,
    )


def _through(t: Array, q: Array, v: Array, a: tuple[Array, Array]) -> Course:
    """Return the quintics through positions and rates (N, n) at the times ``t`` (N,).

    a : accelerations (N, n) behind and before each time, where they may jump.
    """
    h = np.diff(t)[:, None]
    c = hermite(h, (q[:-1], v[:-1], a[0][:-1]), (q[1:], v[1:], a[1][1:]))
    return Course(t, c / h ** np.arange(6.0)[:, None, None])

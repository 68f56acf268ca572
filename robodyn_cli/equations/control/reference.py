"""The motion that a controller follows, as expressions of time with exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.equations.discontinuities import is_of_time, switches, switching_times
from robodyn_cli.equations.time_structure import beside, structure
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.fixed import literal
from robodyn_cli.expr.graph import Expr
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.led import Followed, position_columns, with_attitudes
from robodyn_cli.trajectories.quintic_spline import hermite

Columns = tuple[list[Any], list[Any], list[Any]]
INTERVALS = 512  # of a path that is sampled, at first, and at most
MOST_INTERVALS = 65536
MET = 1e-12  # of the size of the path: the error of the interpolation that is aimed at


class Reference:
    """Positions, rates and accelerations of joints over time; held at the end of the motion.

    Parameters
    ----------
    motion : a trajectory in joint space; None for the pose ``start`` (by column of q).
    """

    def __init__(self, motion: Any, joints: Sequence[str], start: Mapping[str, float], until: float) -> None:
        self.motion, self.joints, self.start, self.until = motion, tuple(joints), start, until

    @property
    def known(self) -> bool:
        """Whether there is a motion, or a pose of all the joints, to follow."""
        return self.motion is not None or all(name in self.start for name in self.joints)

    def at(self, t: Expr, env: Mapping[str, Any]) -> Columns:
        """Return (q, qd, qdd) of the joints, each (n,), as expressions of t; env : values for formulas."""
        n = len(self.joints)
        if self.motion is None:
            held = [literal(float(self.start.get(name, 0.0)), f"initial.q.{name}") for name in self.joints]
            return held, [0.0] * n, [0.0] * n
        given = Followed(self.motion, self.until).expressions({**env, "t": t})
        q = [given[name] for name in self.joints]
        qd = directional(q, [t], [1.0])
        return q, qd, directional(qd, [t], [1.0])

    def breakpoints(self, t: Expr, env: Mapping[str, Any]) -> list[float]:
        """Return the times at which the motion is not smooth, where steps have to end."""
        if self.motion is None:
            return []
        known = Followed(self.motion, self.until).breakpoints
        if known is not None:
            return [float(x) for x in known]
        found: set[float] = {self.motion.duration} if self.until > self.motion.duration else set()
        entries = [x for x in self.at(t, env)[0] if isinstance(x, Expr)]
        for switch in switches(entries):
            if is_of_time(switch, t):
                found.update(switching_times(switch, t, self.until))
        for x in entries:
            found.update(beside(structure(x, t, self.until), found, self.until))
        return sorted(found)


def reference_of(scene: Scene, start: Mapping[str, float]) -> Reference:
    """Return what the controller of a scene follows."""
    controller = scene.control
    own = getattr(controller, "reference", None)
    motion = own if hasattr(own, "expressions") else None
    return Reference(motion, controller.joints, start, scene.simulate.duration)


def leads(motion: Any) -> tuple[str, ...]:
    """Return the columns of q that a trajectory in joint space gives."""
    return position_columns(with_attitudes(dict.fromkeys(motion.joints)))


class Sampled:
    """A motion known at samples, as piecewise polynomials of degree 5 with its rates and accelerations at the knots.

    motion : times (T,) to values, rates and accelerations (T, n).
    """

    def __init__(self, motion: Any, duration: float) -> None:
        self.motion, self.duration = motion, duration

    @cached_property
    def course(self) -> Course:
        """Intervals are halved until the polynomials meet the motion half-way between the knots."""
        count = INTERVALS
        while True:
            times = np.linspace(0.0, self.duration, count + 1)
            x, xd, xdd = (np.asarray(a) for a in self.motion(times))
            course = _through(times, x, xd, xdd)
            middle = 0.5 * (times[1:] + times[:-1])
            off = np.abs(course(middle) - np.asarray(self.motion(middle)[0])).max(initial=0.0)
            if off <= MET * max(1.0, float(np.abs(x).max(initial=0.0))) or count >= MOST_INTERVALS:
                return course.at_rest_outside()
            count *= 2


def _through(t: Array, x: Array, xd: Array, xdd: Array) -> Course:
    h = np.diff(t)[:, None]
    c = hermite(h, (x[:-1], xd[:-1], xdd[:-1]), (x[1:], xd[1:], xdd[1:]))
    powers = h[None] ** -np.arange(6.0)[:, None, None]
    return Course(t, c * powers)

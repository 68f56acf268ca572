"""A point that runs along a circle."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Direction, ListOf, Number, Section, Text, key
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import Ik, Problems, SceneNames, TaskSpaceTrajectory, relative_key
from robodyn_cli.trajectories.motion import PointMotion


@record
class CircleTrajectory(TaskSpaceTrajectory):
    """``p = center + radius (u cos phi + v sin phi)`` in world coordinates, phi at constant rate.

    u is the world's x axis projected into the plane of the circle (the y axis where ``normal`` lies along x),
    and v = normal x u, so that u = x, v = y for the normal z. With a centre (x, y) the height z is left free.
    """

    type: str = key(Choice(("circle",)), doc="Kind of trajectory.")
    point: str = key(Text(), doc="The point that follows: a named point, or `link.end`.")
    center: tuple[float, ...] = key(
        ListOf(Number(), minimum=2, maximum=3),
        unit="m",
        doc="Centre (x, y) or (x, y, z) in the world frame; with (x, y) the height z is left free.",
    )
    radius: float = key(Number(minimum=0.0, exclusive=True), unit="m", doc="Radius.")
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Time of the whole motion.")
    start: float = key(
        Number(),
        default=0.0,
        unit="rad",
        doc="Angle phi at t = 0, from the world's x axis projected into the plane.",
    )
    turns: float = key(Number(), default=1.0, unit="1", doc="Number of turns; negative: the other way round.")
    normal: tuple[float, ...] = key(
        Direction(), default=(0.0, 0.0, 1.0), unit="1", doc="Normal of the circle's plane in the world frame."
    )
    relative_to: str | None = relative_key()
    ik: Ik = key(Section(Ik), default=Ik(), doc="Options of the inverse kinematics.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        yield from super().problems(scene)
        if len(self.center) == 2 and any(self.normal[:2]):
            yield (
                ("normal",),
                f"a circle out of the x-y plane needs a centre of three numbers (value {list(self.center)})",
            )
        if len(self.center) == 2 and self.relative_to is not None:
            yield ("center",), "z is left free, which goes with the world's axes only; allowed: three numbers"
        if self.turns == 0.0:
            yield ("turns",), "must not be zero"

    def axes(self) -> tuple[Array, Array]:
        """Return the unit vectors u and v (3,) of the circle's plane, world coordinates."""
        n = np.array(self.normal) / math.hypot(*self.normal)
        helper = np.array([1.0, 0.0, 0.0])
        if abs(n[0]) > 1.0 - 1e-12:
            helper = np.array([0.0, 1.0, 0.0])
        u = helper - (helper @ n) * n
        u /= math.hypot(*u)
        return u, np.cross(n, u)

    def target(self, times: Array, parameters: Mapping[str, float]) -> PointMotion:
        """Return what is asked of the point at ``times`` (T,)."""
        u, v = self.axes()
        rate = 2.0 * math.pi * self.turns / self.duration
        phi = self.start + rate * np.asarray(times)
        c, s = self.radius * np.cos(phi), self.radius * np.sin(phi)
        size = len(self.center)
        p, pd, pdd = (np.empty((len(phi), size), order="F") for _ in range(3))
        for k in range(size):
            radial = c * u[k] + s * v[k]
            p[:, k] = self.center[k] + radial
            pd[:, k] = rate * (c * v[k] - s * u[k])
            pdd[:, k] = -(rate * rate) * radial
        return PointMotion(p, pd, pdd)

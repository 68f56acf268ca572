"""The flight of a payload that was released: a free body in uniform gravity, up to a plane where one is asked for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.scene.nested_options import LandingPlane, Payload
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.spatial.quaternion import rate, rotation, rotations
from robodyn_cli.summaries.motion import Landing, Release

AXES = ("x", "y", "z")
ALONE = 1e-9  # part of an angular velocity across its axis that rounding leaves
BEYOND = 64  # places of a flight that goes on after the run


@record
class Flight:
    """A body in free flight from its release on, in world coordinates.

    time : of the release [s]. position, velocity : of its centre of mass there (3,). spin : its angular velocity (3,)
    [rad/s]. energy : its kinetic energy [J]. gravity (3,) [m/s^2]. R : from its own axes to the world's (3, 3). I : its
    inertia about its centre of mass in these (3, 3), None where the scene does not give what its attitude depends on.
    """

    time: float
    position: Array
    velocity: Array
    spin: Array
    energy: float
    gravity: Array
    R: Array
    I: Array | None

    def at(self, times: Array) -> tuple[Array, Array]:
        """Return places [m] and velocities [m/s] of the centre of mass (T, 3) at times (T,) after the release.

        r = r_0 + v_0 tau + g tau^2 / 2, tau the time since then.
        """
        since = (np.asarray(times) - self.time)[:, None]
        velocity = self.velocity + self.gravity * since
        return self.position + (self.velocity + 0.5 * self.gravity * since) * since, velocity

    def turning(self, times: Array) -> tuple[Array, Array] | None:
        """Return unit quaternions (T, 4) to the world, scalar first, and angular velocities (T, 3) there [rad/s].

        R-dot = R [w], with R I w constant: the angular momentum about the centre of mass, in the world. Turns about one
        axis that inertia does not leave need no more than that; None where the inertia is not known.
        """
        own = self.R.T @ self.spin
        alone = np.abs(own) > ALONE * float(np.linalg.norm(own))
        if self.I is None and alone.sum() > 1:
            return None
        I = np.eye(3) if self.I is None else self.I
        from scipy.integrate import solve_ivp
        from scipy.spatial.transform import Rotation

        inverse, momentum = np.linalg.pinv(I, rcond=1e-12), self.R @ I @ own
        since = np.asarray(times) - self.time
        start = Rotation.from_matrix(self.R).as_quat(scalar_first=True)
        if not own.any() or not I.any():
            return np.tile(start, (len(since), 1)), np.tile(self.spin, (len(since), 1))

        def rates(_: float, p: Array) -> Array:
            return np.array(rate(p, inverse @ (np.array(rotation(p)).T @ momentum)), dtype=float)

        end = max(float(since[-1]), 1e-300)
        run = solve_ivp(rates, (0.0, end), start, "DOP853", since, rtol=1e-13, atol=1e-15)
        p = (run.y / np.linalg.norm(run.y, axis=0)).T
        return p, np.array([R @ inverse @ R.T @ momentum for R in rotations(p)])

    @property
    def release(self) -> Release:
        """The figures of the release."""
        return Release(by_axis(self.position), by_axis(self.velocity), by_axis(self.spin), self.energy)

    def landing(self, plane: LandingPlane) -> Landing | None:
        """Return where the centre of mass comes down to a plane, None where it never does."""
        normal, height = self._above(plane)
        rise, bend = float(normal @ self.velocity), float(normal @ self.gravity)
        since = _comes_down(height, rise, bend)
        if since is None:
            return None
        time = self.time + since
        (position,), (velocity,) = self.at(np.array([time]))
        along = position - self.position
        apex = -rise / bend if bend < 0.0 < rise else 0.0
        return Landing(
            time=time,
            position=by_axis(position),
            velocity=by_axis(velocity),
            range=float(np.linalg.norm(along - (normal @ along) * normal)),
            highest=height + 0.5 * rise * min(apex, since),
        )

    def _above(self, plane: LandingPlane) -> tuple[Array, float]:
        """Return the unit normal of a plane, by default against gravity, and the height above it at the release."""
        given = np.array([float(x) for x in plane.normal or -self.gravity])
        normal: Array = given / np.linalg.norm(given)
        return normal, float(normal @ (self.position - np.array([float(x) for x in plane.through])))

    def times(self, samples: Array, landed: float | None) -> Array:
        """Return times of the flight: its release, the samples of a run (T,) that follow, its landing if it has one."""
        end = samples[-1] if landed is None else landed
        within = samples[(samples > self.time) & (samples < end)]
        beyond = np.linspace(samples[-1], end, BEYOND) if end > samples[-1] else np.array([end])
        return np.unique(np.concatenate([[self.time], within, beyond]))


def inertia_of(payload: Payload) -> Array | None:
    """Return the inertia of a payload about its centre of mass, in its own axes (3, 3); None where it is not whole.

    Products that are not given are zero where the moments are.
    """
    I = payload.inertia
    if None in (I.xx, I.yy, I.zz):
        return None
    xy, xz, yz = (0.0 if x is None else x for x in (I.xy, I.xz, I.yz))
    return np.array([[I.xx, xy, xz], [xy, I.yy, yz], [xz, yz, I.zz]], dtype=float)


def by_axis(x: Sequence[Any] | Array) -> dict[str, float]:
    """Return the components of a vector (3,) by axis."""
    return {axis: float(number) for axis, number in zip(AXES, x)}


def _comes_down(height: float, rise: float, bend: float) -> float | None:
    """Return the first time > 0 at which height + rise tau + bend tau^2 / 2 falls through zero, None for none.

    The roots without cancellation: q = -(b + sign(b) sqrt(b^2 - 4 a c)) / 2, tau = q / a and c / q.
    """
    a = 0.5 * bend
    square = rise * rise - 4.0 * a * height
    if square < 0.0:
        return None
    q = -0.5 * (rise + math.copysign(math.sqrt(square), rise))
    roots = [x for x in (q / a if a else None, height / q if q else None) if x is not None]
    falling = [tau for tau in roots if tau > 0.0 and rise + bend * tau < 0.0]
    return min(falling, default=None)

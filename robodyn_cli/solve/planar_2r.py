"""Inverse kinematics of a planar 2R arm in closed form, in any place and attitude.

In the plane across the two parallel axes, with phi the direction of the first link (joint 1 to joint 2,
length l1) and psi that of the second (joint 2 to the point, length l2), both turning about the first axis:

    x = l1 cos phi + l2 cos psi,    y = l1 sin phi + l2 sin psi

The bend beta = psi - phi is the lecture's theta2 where the links lie along their D-H x axes; elbow_up is
beta < 0.

Follow a path with a planar 2R arm: one branch, all samples at once, refined where the joints move fast.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.solve.reach import Singular, Unreachable, farthest, leaving
from robodyn_cli.spatial.algebra import PARALLEL, Array
from robodyn_cli.trajectories.motion import JointMotion, PointMotion

ELBOW_UP, ELBOW_DOWN = -1.0, 1.0
BRANCHES = {"elbow_up": ELBOW_UP, "elbow_down": ELBOW_DOWN}


@record
class PlaneMotion:
    """Motion of the point in the plane of the arm: x, y (T,) with rates, and its distance from the plane."""

    x: Array
    y: Array
    xd: Array
    yd: Array
    xdd: Array
    ydd: Array
    off: Array


@record
class Planar2R:
    """A planar 2R arm as found in a model.

    origin : (3,) point of the first axis in the point's plane; ex, ey : (3,) axes of that plane, the frame in
        which the first joint turns; all in world coordinates.
    l1, l2 : lengths [m]. phi0 : phi = q1 + phi0. beta0, turn : beta = beta0 + turn q2 with turn = +-1.
    first, second : places of the joints in q.
    """

    origin: Array
    ex: Array
    ey: Array
    l1: float
    l2: float
    phi0: float
    beta0: float
    turn: float
    first: int
    second: int

    @staticmethod
    def recognise(model: Model, frame: FixedFrame) -> Planar2R | None:
        """Return the arm if the model is one: two revolute joints with parallel axes, carrying the point."""
        path = model.path_to(frame.body)
        if model.nv != 2 or len(path) != 2 or frame.body == BASE:
            return None
        one, two = (model.bodies[k] for k in path)
        if one.joint.dh_variable != "theta" or two.joint.dh_variable != "theta":
            return None
        mount = one.X_tree @ model.base
        entries = [*mount.E.flat, *mount.r, *two.X_tree.E.flat, *two.X_tree.r, *frame.p]
        if any(isinstance(x, Expr) for x in entries):
            return None
        E2, r2, p = (np.array(x, dtype=float) for x in (two.X_tree.E, two.X_tree.r, frame.p))
        turn = math.copysign(1.0, E2[2, 2])
        if math.hypot(E2[2, 0], E2[2, 1]) > PARALLEL:
            return None
        l1, l2 = math.hypot(r2[0], r2[1]), math.hypot(p[0], p[1])
        if not (l1 > 0.0 and l2 > 0.0):
            return None
        E, r = np.array(mount.E, dtype=float), np.array(mount.r, dtype=float)
        along = math.atan2(r2[1], r2[0])  # of link 1, in the frame of body 1
        chi = math.atan2(E2[0, 1], E2[0, 0])  # of the x axis before joint 2, in the same frame
        own = math.atan2(p[1], p[0])  # of the point, in the frame of body 2
        height = r2[2] + turn * p[2]
        return Planar2R(
            origin=r + height * E[2],
            ex=E[0],
            ey=E[1],
            l1=l1,
            l2=l2,
            phi0=along,
            beta0=_principal(chi + turn * own - along),
            turn=turn,
            first=one.q,
            second=two.q,
        )

    def in_plane(self, target: PointMotion) -> PlaneMotion | None:
        """Return a target in coordinates of the plane; None if x and y alone do not place a point in it."""
        size = target.p.shape[1]
        B = np.stack([self.ex, self.ey], axis=1)[:size]
        if size == 2 and abs(np.linalg.det(B)) < 1e-6:
            return None
        inverse = B.T if size == 3 else np.linalg.inv(B)
        lever = target.p - self.origin[:size]
        (x, y), (xd, yd), (xdd, ydd) = (inverse @ a.T for a in (lever, target.pd, target.pdd))
        off = np.zeros(len(x)) if size == 2 else np.abs(lever @ np.cross(self.ex, self.ey))
        return PlaneMotion(x, y, xd, yd, xdd, ydd, off)

    def shortfall(self, plane: PlaneMotion) -> Array:
        """Return the distance (T,) from each target to the nearest point that the arm reaches [m]."""
        r = np.hypot(plane.x, plane.y)
        return np.hypot(
            plane.off, np.maximum(0.0, np.maximum(r - (self.l1 + self.l2), abs(self.l1 - self.l2) - r))
        )

    def angles(self, plane: PlaneMotion, branch: float) -> tuple[Array, Array]:
        """Return phi and beta (T,) of the branch with the sign ``branch`` of beta, which is a principal value."""
        beta, lean = two_bars(self.l1, self.l2, np.hypot(plane.x, plane.y))
        return np.arctan2(plane.y, plane.x) - branch * lean, branch * beta

    def rates(self, plane: PlaneMotion, phi: Array, beta: Array) -> tuple[Array, Array, Array, Array]:
        """Return phi-dot, beta-dot, phi-ddot, beta-ddot (T,); infinite in singular poses (sin beta = 0)."""
        c1, s1 = np.cos(phi), np.sin(phi)
        c2, s2 = np.cos(phi + beta), np.sin(phi + beta)
        with np.errstate(divide="ignore", invalid="ignore"):
            w = 1.0 / np.sin(beta)
            phi_d = (c2 * plane.xd + s2 * plane.yd) * w / self.l1
            psi_d = -(c1 * plane.xd + s1 * plane.yd) * w / self.l2
            # the accelerations less their centripetal parts obey the same equations
            n1, n2 = self.l1 * phi_d**2, self.l2 * psi_d**2
            ax, ay = plane.xdd + n1 * c1 + n2 * c2, plane.ydd + n1 * s1 + n2 * s2
            phi_dd = (c2 * ax + s2 * ay) * w / self.l1
            psi_dd = -(c1 * ax + s1 * ay) * w / self.l2
        return phi_d, psi_d - phi_d, phi_dd, psi_dd - phi_dd

    def joints(self, phi: Array, beta: Array) -> Array:
        """Return q (T, 2) for continuous angles phi and beta."""
        q = np.empty((len(phi), 2), order="F")
        q[:, self.first] = phi - self.phi0
        q[:, self.second] = self.turn * (beta - self.beta0)
        return q

    def joint_rates(self, phi_rate: Array, beta_rate: Array) -> Array:
        """Return qd (T, 2) for rates of phi and beta, or accelerations for accelerations."""
        qd = np.empty((len(phi_rate), 2), order="F")
        qd[:, self.first], qd[:, self.second] = phi_rate, self.turn * beta_rate
        return qd

    def bend(self, q: Array) -> float:
        """Return the principal value of beta at joint positions q (2,)."""
        return _principal(self.beta0 + self.turn * float(q[self.second]))


def two_bars(first: float, second: float, r: Array) -> tuple[Array, Array]:
    """Return the bend (T,) in [0, pi] of two bars whose free ends are ``r`` (T,) apart, and how far they lean (T,).

    That is the angle from the first bar to the line between the free ends, towards the side of the bend. Ends that
    the bars do not reach leave them stretched, or folded.
    tan^2(bend / 2) = ((l1 + l2)^2 - r^2) / (r^2 - (l1 - l2)^2), which keeps its digits near the limits.
    """
    outer, inner = first + second, abs(first - second)
    near = np.sqrt(np.maximum(0.0, (outer - r) * (outer + r)))
    far = np.sqrt(np.maximum(0.0, (r - inner) * (r + inner)))
    bend = 2.0 * np.arctan2(near, far)
    return bend, np.arctan2(second * np.sin(bend), first + second * np.cos(bend))


def _principal(angle: float) -> float:
    """Return the angle in (-pi, pi]."""
    return -((math.pi - angle) % (2.0 * math.pi) - math.pi)


LEAST_INTERVALS = 256  # at least so many: the turns of a joint must not depend on the number of samples
LEVELS = 12
MOST_POINTS = 4_000_000
RESOLVED = 0.1  # rad
SINGULAR = 1e-7  # |sin beta| below which the angles keep no digit: the square root of the rounding of r


def follow(
    arm: Planar2R,
    target: Callable[[Array], PointMotion],
    times: Array,
    branch: float,
    near: Array | None,
    tolerance: float,
) -> JointMotion:
    """Return the joint motion (T, 2) that keeps the arm's point on its target, on one branch.

    Joints are continuous, rates and accelerations exact. An interval between samples counts as resolved when
    the rates at its ends explain the step of the joints and lead to no singularity within it; others are
    divided.

    Parameters
    ----------
    branch : sign of beta. near : (2,) joint positions that choose the turns at the start; default (-pi, pi].
    tolerance : distance from the target that is accepted [m].

    Raises
    ------
    Unreachable, Singular : with times.
    """
    grid, places = _grid(times)
    for _ in range(LEVELS):
        plane = arm.in_plane(target(grid))
        assert plane is not None
        _check_reach(arm, target, plane, grid, tolerance)
        phi, beta = arm.angles(plane, branch)
        _check_regular(beta, grid)
        phi_d, beta_d, phi_dd, beta_dd = arm.rates(plane, phi, beta)
        phi = np.unwrap(phi)
        open_intervals = _unresolved(grid, phi, beta, phi_d, beta_d)
        if not open_intervals.size:
            break
        if len(grid) + 3 * len(open_intervals) > MOST_POINTS:
            break
        grid, places = _divide(grid, places, open_intervals)
    if open_intervals.size:
        k = open_intervals[0]
        raise Singular(0.5 * (grid[k] + grid[k + 1]), float(np.abs(np.sin(beta[k : k + 2])).min()))
    take = slice(None) if len(places) == len(grid) else places
    q = arm.joints(phi[take], beta[take])
    if near is None:
        q -= 2.0 * np.pi * np.ceil((q[0] - np.pi) / (2.0 * np.pi))
    else:
        q += 2.0 * np.pi * np.round((near - q[0]) / (2.0 * np.pi))
    return JointMotion(
        q, arm.joint_rates(phi_d[take], beta_d[take]), arm.joint_rates(phi_dd[take], beta_dd[take])
    )


def _grid(times: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return times to solve at, and where the requested ones are among them."""
    intervals = len(times) - 1
    if intervals < 1 or intervals >= LEAST_INTERVALS:
        return times, np.arange(len(times))
    divide = -(-LEAST_INTERVALS // intervals)
    share = np.arange(divide) / divide
    inner = times[:-1, None] + np.diff(times)[:, None] * share
    return np.append(inner.ravel(), times[-1]), np.arange(len(times)) * divide


def _divide(
    grid: Array, places: NDArray[np.intp], intervals: NDArray[np.intp]
) -> tuple[Array, NDArray[np.intp]]:
    """Return the grid with three more points in each of some intervals."""
    step = (grid[intervals + 1] - grid[intervals])[:, None]
    added = grid[intervals][:, None] + step * np.array([0.25, 0.5, 0.75])
    finer = np.insert(grid, np.repeat(intervals + 1, 3), added.ravel())
    return finer, places + 3 * np.searchsorted(intervals, places)


def _check_reach(
    arm: Planar2R, target: Callable[[Array], PointMotion], plane: PlaneMotion, grid: Array, tolerance: float
) -> None:
    """Raise if a target is out of reach, with the time since when."""
    short = arm.shortfall(plane)
    limit = max(tolerance, 4.0 * np.finfo(float).eps * (arm.l1 + arm.l2))
    bad = np.flatnonzero(~(short <= limit))
    if not bad.size:
        return

    def miss(times: Array) -> Array:
        plane = arm.in_plane(target(times))
        assert plane is not None
        return arm.shortfall(plane)

    first, worst = int(bad[0]), int(np.argmax(short))
    time = leaving(miss, grid[first - 1], grid[first], limit) if first else grid[0]
    far = farthest(miss, grid[max(worst - 1, 0)], grid[min(worst + 1, len(grid) - 1)])
    raise Unreachable(time, float(miss(np.array([time]))[0]), *far)


def _check_regular(beta: Array, grid: Array) -> None:
    sine = np.abs(np.sin(beta))
    k = int(np.argmin(sine))
    if sine[k] < SINGULAR:
        k = int(np.flatnonzero(sine < SINGULAR)[0])
        raise Singular(grid[k], float(sine[k]))


def _unresolved(grid: Array, phi: Array, beta: Array, phi_d: Array, beta_d: Array) -> NDArray[np.intp]:
    """Return the intervals in which the motion may not be smooth and regular."""
    h = np.diff(grid)
    bad = np.zeros(len(h), dtype=bool)
    for x, xd in ((phi, phi_d), (beta, beta_d)):
        bad |= ~(np.abs(np.diff(x) - 0.5 * h * (xd[:-1] + xd[1:])) < RESOLVED)
    # does the bend reach 0 or pi within the step, as far as its rate at either end tells?
    bend, rate = np.abs(beta), np.sign(beta) * beta_d
    for ahead in (bend[:-1] + h * rate[:-1], bend[1:] - h * rate[1:]):
        bad |= ~((ahead > 0.0) & (ahead < np.pi))
    return np.flatnonzero(bad)

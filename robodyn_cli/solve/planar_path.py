"""Follow a path with a planar 2R arm: one branch, all samples at once, refined where the joints move fast."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.solve.planar_2r import Planar2R, PlaneMotion
from robodyn_cli.solve.reach import Singular, Unreachable
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import JointMotion, PointMotion

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
        _check_reach(arm, plane, grid, places, tolerance)
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
    arm: Planar2R, plane: PlaneMotion, grid: Array, places: NDArray[np.intp], tolerance: float
) -> None:
    """Raise if a target is out of reach, with the first such sample (or time between samples)."""
    short = arm.shortfall(plane)
    limit = max(tolerance, 4.0 * np.finfo(float).eps * (arm.l1 + arm.l2))
    bad = np.flatnonzero(~(short <= limit))
    if bad.size:
        worst = int(np.argmax(short))
        at_samples = np.intersect1d(bad, places)
        first = int(at_samples[0] if at_samples.size else bad[0])
        raise Unreachable(grid[first], float(short[first]), grid[worst], float(short[worst]))


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

"""The fastest time law of a path: profile, then what the limits ask between grid points, then where it switches."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.fastest.law import time_law
from robodyn_cli.solve.fastest.profile import Passes, Profile
from robodyn_cli.solve.fastest.rows import PLACES, Rows
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course

ROUNDS = 6
BESIDE = 1e-6  # of the path: as near as grid points may lie to one that there has to be
PASSED = (
    2e-7  # of a limit, what may be passed between grid points before the motion is slowed down as a whole
)
SWITCHES = 1  # rounds that put grid points where the motion switches
NEAR = 1e-6  # of a range of u, at its border


class Limits(Protocol):
    """The rows of a path on a grid (K + 1,); for forces that are not linear in x their tangents at x (K, 5).

    ``linear`` : whether the rows do not depend on x, once they have been asked for.
    """

    linear: bool

    def __call__(self, s: Array, x: Array | None) -> Rows: ...


@record
class Fastest:
    """The fastest motion on a path: grid ``s`` (K + 1,), profile, time law s(t), and the slowing-down at the end."""

    s: Array
    profile: Profile
    law: Course
    slowed: float


def fastest(length: float, intervals: int, fixed: Array, limits: Limits) -> Fastest:
    """Return the fastest motion from rest to rest along a path, s from 0 to ``length``.

    Parameters
    ----------
    intervals : of the grid, which is as fine in time as in s; where the motion switches it gets points of its own.
    fixed : grid points that there have to be. limits : the rows on a grid.

    Raises
    ------
    NoProfile : there is none.
    """
    s = merged(np.linspace(0.0, length, max(intervals // 2, 4) + 1), fixed)
    s = merged(_even_in_time(s, _unmargined(s, limits), intervals), fixed)
    for _ in range(SWITCHES):
        s = merged(s, np.append(fixed, _switches(s, limits(s, None), _unmargined(s, limits))))
    rows = limits(s, None)
    profile = _within(s, rows, limits)
    law = time_law(s, profile)
    slowed = _slower(s, profile, rows if limits.linear else None, limits)
    return Fastest(s, profile, law.stretched(law.duration * slowed), slowed)


def merged(s: Array, more: Array) -> Array:
    """Return grid points with more of them; those that lie beside a new one give way to it."""
    near = BESIDE * (s[-1] - s[0])
    new = np.unique(more)
    new = new[(new > s[0] + near) & (new < s[-1] - near)]
    if not new.size:
        return s
    place = np.clip(np.searchsorted(new, s), 1, len(new) - 1) if len(new) > 1 else np.ones(len(s), int)
    distance = np.minimum(np.abs(s - new[place - 1]), np.abs(s - new[np.minimum(place, len(new) - 1)]))
    keep = distance > near
    keep[[0, -1]] = True
    return np.unique(np.concatenate([s[keep], new]))


def _unmargined(s: Array, limits: Limits) -> Profile:
    rows = limits(s, None)
    zero = np.zeros((len(s) - 1, rows.A.shape[2]))
    return Passes(s, rows, (zero, zero)).run()


def _even_in_time(s: Array, profile: Profile, intervals: int) -> Array:
    """Return a grid whose intervals are equal in the mean of s and time, in parts of the whole."""
    D, v = np.diff(s), np.sqrt(profile.x)
    # within a segment x is taken as linear: time goes as the change of the speed
    parts = np.linspace(0.0, 1.0, 9)
    fine = (s[:-1, None] + D[:, None] * parts[:-1]).ravel()
    x = profile.x[:-1, None] + np.diff(profile.x)[:, None] * parts
    speed = np.sqrt(np.maximum(x, 0.0))
    steps = (2.0 * D[:, None] / 8.0 / (speed[:, 1:] + speed[:, :-1] + 1e-9 * v.max())).ravel()
    time = np.concatenate([[0.0], np.cumsum(steps)])
    fine = np.append(fine, s[-1])
    measure = time / time[-1] + fine / fine[-1]
    found = np.interp(np.linspace(0.0, measure[-1], intervals + 1), measure, fine)
    found[0], found[-1] = s[0], s[-1]
    # the drive brakes alone in the last segment (see ``Rows.rest``), so that it is a short one
    last = s[-1] - (s[-1] - found[-2]) * 4.0 ** -np.arange(1.0, 6.0)
    return np.concatenate([found[:-1], last, found[-1:]])


def _within(s: Array, rows: Rows, limits: Limits) -> Profile:
    """Return the profile whose values keep to the limits between grid points too."""
    shape = (len(s) - 1, rows.A.shape[2])
    above, below, most = np.zeros(shape), np.zeros(shape), rows.most
    for _ in range(ROUNDS):
        profile = Passes(s, dataclasses.replace(rows, most=most), (above, below)).run()
        u, x = between(s, profile)
        if not limits.linear:
            rows = limits(s, x)
        over, under, fast = rows.passed(u, x)
        if max(over.max(), under.max(), fast.max()) <= PASSED:
            break
        above, below = np.maximum(above + over, 0.0), np.maximum(below + under, 0.0)
        most = np.minimum(most / (1.0 + np.maximum(fast, -0.5)[:, None]), rows.most)
    return profile


def between(s: Array, profile: Profile) -> tuple[Array, Array]:
    """Return u and x (K, 5) at the ``PLACES`` of each segment."""
    w = np.array(PLACES)
    u = profile.u0[:, None] + w * (profile.u1 - profile.u0)[:, None]
    x = profile.x[:-1, None] + (np.diff(s)[:, None] * w) * (profile.u0[:, None] + u)
    return u, np.maximum(x, 0.0)


def _switches(s: Array, rows: Rows, profile: Profile) -> Array:
    """Return where, inside of segments, the motion goes over from one limit to another."""
    zero = np.zeros((len(s) - 1, rows.A.shape[2]))
    passes = Passes(s, rows, (zero, zero))
    (a0, b0), (a1, b1) = passes.first.range(profile.x[:-1]), passes.last.range(profile.x[1:])
    wide0, wide1 = NEAR * (b0 - a0), NEAR * (b1 - a1)
    up = (profile.u0 >= b0 - wide0) & (profile.u1 >= b1 - wide1)
    down = (profile.u0 <= a0 + wide0) & (profile.u1 <= a1 + wide1)
    before, after = np.append(False, up[:-1]), np.append(down[1:], False)
    inside = np.flatnonzero(before & after & ~up & ~down)
    # speeding up from the left meets braking from the right
    D, x = np.diff(s)[inside], profile.x
    with np.errstate(all="ignore"):
        way = (x[inside + 1] - x[inside] - 2.0 * a1[inside] * D) / (2.0 * (b0[inside] - a1[inside]))
    good = (way > 1e-6 * D) & (way < (1.0 - 1e-6) * D)
    return np.asarray((s[inside] + way)[good])


def _slower(s: Array, profile: Profile, rows: Rows | None, limits: Limits) -> float:
    """Return the factor of all times with which no limit is passed any more."""
    u, x = between(s, profile)

    def worst(factor: float) -> float:
        scaled = x / factor**2
        here = limits(s, scaled) if rows is None else rows
        return max(float(part.max(initial=-1.0)) for part in here.passed(u / factor**2, scaled))

    high = 1.0
    while worst(high) > PASSED:
        high = 1.0 + 2.0 * max(high - 1.0, 1e-9)
        if high > 2.0:
            break
    low = 1.0 if high == 1.0 else 1.0 + 0.5 * (high - 1.0)
    for _ in range(12 if high > 1.0 else 0):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if worst(middle) <= PASSED else (middle, high)
    return high

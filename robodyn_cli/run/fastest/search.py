"""The fastest time law of a path: where grid points are needed, the profile, and what the limits ask between them."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.run.fastest.law import time_law
from robodyn_cli.run.fastest.profile import Passes, Profile
from robodyn_cli.run.fastest.rows import FINE, PLACES, Rows
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.interpolation import divided

# of the grid's intervals: in the first look, on the grid that is even in time, and after each refinement
FIRST, EVEN, REFINED = 0.25, 0.35, (0.7, 1.0)
LEAST = 8
LAST = 5  # points besides, ever nearer to the end: the drive brakes alone in the last segment (see ``Rows.rest``)
PARTS = 4  # into which a segment is divided in one refinement at most
ROUNDS = 10  # of what limits ask between grid points,
YIELDING = 2  # rounds in which margins may become smaller again
GOOD = (
    0.4  # until this, divided by the square of the intervals, is passed; the rest slows the whole motion down
)
BESIDE = 1e-6  # of the path: as near as grid points may lie to one that there has to be
PASSED = 1e-7  # of a limit, what may be passed between grid points in the end
NEAR = 1e-6  # of a range of u, at its border


class Limits(Protocol):
    """The rows of a path on a grid (K + 1,); for forces that are not linear in x their tangents at x (K, 5).

    ``linear`` : whether the rows do not depend on x, once they have been asked for.
    ``largest_use`` : of any limit, 1 on it, for u and x at the ``FINE`` places of each segment.
    """

    linear: bool

    def __call__(self, s: Array, x: Array | None) -> Rows: ...

    def largest_use(self, s: Array, u: Array, x: Array) -> float: ...


@record
class Fastest:
    """The fastest motion on a path: grid ``s`` (K + 1,), profile, time law s(t), and the slowing-down at the end."""

    s: Array
    profile: Profile
    law: Course
    slowed: float


@record
class _Found:
    """A profile on a grid ``s`` (K + 1,), with the rows, and the passes over them, that it was found by."""

    s: Array
    rows: Rows
    passes: Passes
    profile: Profile


def fastest(length: float, intervals: int, fixed: Array, limits: Limits) -> Fastest:
    """Return the fastest motion from rest to rest along a path, s from 0 to ``length``.

    Parameters
    ----------
    intervals : of the grid, which is finest where a coarser one makes least use of the limits.
    fixed : grid points that there have to be. limits : the rows on a grid.

    Raises
    ------
    NoProfile : there is none.
    """
    s = merged(np.linspace(0.0, length, max(int(FIRST * intervals), LEAST) + 1), fixed)
    found = _on(s, limits, None)
    s = merged(_even_in_time(s, found.profile, max(int(EVEN * intervals), LEAST)), fixed)
    found = _on(s, limits, found)
    for part in REFINED:
        s = merged(_refined(found, int(part * intervals) + LAST), np.append(fixed, _switches(found)))
        found = _on(s, limits, found)
    found = _within(found, limits)
    law = time_law(found.s, found.profile)
    slowed = _slower(found, limits)
    return Fastest(found.s, found.profile, law.stretched(law.duration * slowed), slowed)


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


def _on(s: Array, limits: Limits, before: _Found | None) -> _Found:
    """Return the profile that keeps to the limits at the points of a grid; ``before`` : found on a coarser one."""
    if before is None:
        found = _under(s, limits(s, None))
        return found if limits.linear else _under(s, limits(s, between(s, found.profile)[1]))
    places = s[:-1, None] + np.diff(s)[:, None] * np.array(PLACES)
    return _under(s, limits(s, np.interp(places, before.s, before.profile.x)))


def _under(s: Array, rows: Rows) -> _Found:
    zero = np.zeros((len(s) - 1, rows.A.shape[2]))
    passes = Passes(s, rows, (zero, zero))
    return _Found(s, rows, passes, passes.run())


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
    last = s[-1] - (s[-1] - found[-2]) * 4.0 ** -np.arange(1.0, LAST + 1.0)
    return np.concatenate([found[:-1], last, found[-1:]])


def _refined(found: _Found, intervals: int) -> Array:
    """Return the grid with as many intervals, more of them where the time lost is largest.

    On the fastest motion one of the limits binds everywhere. What the use of the limits is off by inside of a segment
    grows with the square of its length, so the time lost with the cube of it.
    """
    s, rows = found.s, found.rows
    u, x = between(s, found.profile)
    use = np.maximum(np.abs(rows.values(u, x)).max(axis=2), x / rows.most)
    off = np.minimum(np.abs(use - 1.0)[:, 1:-1].max(axis=1), 1.0)
    D, v = np.diff(s), np.sqrt(found.profile.x)
    size = np.cbrt(off * 2.0 * D / (v[1:] + v[:-1]))
    low, high = 0.0, float(size.max())
    parts = np.ones(len(D))
    for _ in range(30):  # the largest loss that a part may have, by bisection
        middle = 0.5 * (low + high)
        more = np.clip(np.ceil(size / middle), 1.0, PARTS) if middle > 0.0 else parts
        if more.sum() > intervals:
            low = middle
        else:
            high, parts = middle, more
    return divided(s, parts)


def _within(found: _Found, limits: Limits) -> _Found:
    """Return the profile whose values keep to the limits between grid points too."""
    s, rows = found.s, found.rows
    shape = (len(s) - 1, rows.A.shape[2])
    above, below, most = np.zeros(shape), np.zeros(shape), rows.most
    profile, enough = found.profile, GOOD / len(above) ** 2
    for k in range(ROUNDS):
        u, x = between(s, profile)
        if not limits.linear:
            rows = limits(s, x)
        over, under, fast = rows.passed(u, x)
        if max(over.max(), under.max(), fast.max()) <= enough:
            break
        if k >= YIELDING:
            over, under, fast = (np.maximum(part, 0.0) for part in (over, under, fast))
        above, below = np.maximum(above + over, 0.0), np.maximum(below + under, 0.0)
        most = np.minimum(most / (1.0 + np.maximum(fast, -0.5)[:, None]), rows.most)
        profile = Passes(s, dataclasses.replace(rows, most=most), (above, below)).run()
    return dataclasses.replace(found, rows=rows, profile=profile)


def between(s: Array, profile: Profile, places: tuple[float, ...] = PLACES) -> tuple[Array, Array]:
    """Return u and x (K, places) at places in each segment."""
    w = np.array(places)
    u = profile.u0[:, None] + w * (profile.u1 - profile.u0)[:, None]
    x = profile.x[:-1, None] + (np.diff(s)[:, None] * w) * (profile.u0[:, None] + u)
    return u, np.maximum(x, 0.0)


def _switches(found: _Found) -> Array:
    """Return where, inside of segments, speeding up goes over into braking."""
    s, passes, profile = found.s, found.passes, found.profile
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


def _slower(found: _Found, limits: Limits) -> float:
    """Return the factor of all times with which no limit is passed any more."""
    u, x = between(found.s, found.profile, FINE)
    factor = 1.0
    while factor < 2.0:
        passed = limits.largest_use(found.s, u / factor**2, x / factor**2) - 1.0
        if passed <= PASSED:
            break
        factor = 1.0 + max(2.0 * (factor - 1.0), passed)
    return factor

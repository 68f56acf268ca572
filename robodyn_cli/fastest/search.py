"""Grids along a path: where points are needed.

Margins from the limits, so that they are kept between the points of a grid too.

The fastest time law of a path: the profile on ever finer grids, until the duration is known well enough.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from robodyn_cli.fastest.limits import FINE, PLACES, Passed, Rows
from robodyn_cli.fastest.profile import NoProfile, Passes, Profile, durations, time_law
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course, divided

LAST = 5  # points besides, ever nearer to the end: the drive brakes alone in the last segment (see ``Rows.rest``)
PARTS = 4  # into which a segment is divided in one refinement at most
SHORT = 1e-4  # of the path: segments of constant acceleration are divided down to this at least
BESIDE = 1e-6  # of the path: as near as grid points may lie to one that there has to be


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


def even_in_time(s: Array, profile: Profile, intervals: int) -> Array:
    """Return a grid whose intervals are equal in the mean of s and time, in parts of the whole."""
    v = np.sqrt(profile.x)
    # within a segment x is taken as linear: time goes as the change of the speed
    time = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (v[1:] + v[:-1] + 1e-9 * v.max()))])
    measure = time / time[-1] + s / s[-1]
    even = np.interp(np.linspace(0.0, measure[-1], intervals + 1), measure, s)
    even[0], even[-1] = s[0], s[-1]
    last = s[-1] - (s[-1] - even[-2]) * 4.0 ** -np.arange(1.0, LAST + 1.0)
    return np.concatenate([even[:-1], last, even[-1:]])


def refined(s: Array, rows: Rows, profile: Profile, count: int, even: Array) -> Array:
    """Return the grid divided into so many intervals, more of them where the time lost is largest.

    On the fastest motion one of the limits binds everywhere. What the use of the limits is off by inside of a segment
    grows with the square of its length, so the time lost with the cube of it. Segments of constant acceleration,
    ``even`` (K,), are less exact, and what x lacks there is lacking all along the arcs beside them: they are always
    divided.
    """
    u, x = profile.between(s)
    use = np.maximum(np.abs(rows.values(u, x)).max(axis=2), x / rows.most)
    off = np.minimum(np.abs(use - 1.0).max(axis=1), 1.0)
    D, v = np.diff(s), np.sqrt(profile.x)
    size = np.cbrt(off * 2.0 * D / (v[1:] + v[:-1]))
    low, high = 0.0, float(size.max())
    parts = np.ones(len(D))
    for _ in range(30):  # the largest loss that a part may have, by bisection
        middle = 0.5 * (low + high)
        more = np.clip(np.ceil(size / middle), 1.0, PARTS) if middle > 0.0 else parts
        if more.sum() > count:
            low = middle
        else:
            high, parts = middle, more
    long = np.diff(s) > SHORT * (s[-1] - s[0])
    return divided(s, np.where(even & long, PARTS, parts))


ROUNDS = 5  # of what the rows ask for,
YIELDING = 2  # in which margins may become smaller again,
TANGENTS = 2  # in which forces are made linear anew
GOOD = 0.4  # until this, divided by the square of the segments, is passed
CHECKS = 8  # rounds of what the limits themselves ask for


class GridLimits(Protocol):
    """The rows of a path on a grid (K + 1,); for forces that are not linear in x their tangents at x (K, 3).

    ``linear`` : whether the rows do not depend on x, once they have been asked for.
    ``passed`` : for u and x at the ``FINE`` places of each segment.
    """

    linear: bool

    def __call__(self, s: Array, x: Array | None) -> Rows: ...

    def passed(self, s: Array, u: Array, x: Array) -> Passed: ...


class Margins:
    """What is kept free of each limit in each segment, so that none is passed between the grid points."""

    def __init__(self, s: Array, rows: Rows, profile: Profile, limits: GridLimits) -> None:
        self.s, self.rows, self.profile, self.limits = s, rows, profile, limits
        shape = (len(s) - 1, rows.A.shape[2])
        self.above, self.below, self.most = np.zeros(shape), np.zeros(shape), rows.most

    def take(self, passed: Passed) -> None:
        """Keep as much more free as is passed, and find the profile again."""
        self.above = np.maximum(self.above + passed.over, 0.0)
        self.below = np.maximum(self.below + passed.under, 0.0)
        slower = self.most / (1.0 + np.maximum(passed.fast, -0.5)[:, None])
        self.most = np.minimum(slower, self.rows.most)
        rows, x = dataclasses.replace(self.rows, most=self.most), self.profile.between(self.s)[1]
        self.profile = Passes(self.s, rows, (self.above, self.below), x).run()

    def by_rows(self) -> None:
        """Find margins as the rows ask for them."""
        for k in range(ROUNDS):
            u, x = self.profile.between(self.s)
            if k < TANGENTS and not self.limits.linear:
                self.rows = self.limits(self.s, x)
            passed = self.rows.passed(u, x)
            if passed.largest <= GOOD / len(u) ** 2:
                return
            self.take(passed if k < YIELDING else passed.positive())

    def by_limits(self, enough: float) -> float:
        """Find margins as the limits themselves ask for them, until ``enough`` is passed; return what is."""
        for _ in range(CHECKS):
            passed = self.limits.passed(self.s, *self.profile.between(self.s, FINE))
            if passed.largest <= enough:
                break
            self.take(passed.positive())
        return passed.largest


FIRST, EVEN = 50, 100  # intervals of the first look, and of the grid that is even in time
GROWTH = (1.3, 2.0)  # of the number of intervals from one grid to the next
MOST = 50_000  # intervals
ORDER = 1.2  # at which the error falls with the intervals at least: so that the estimate is seldom below the error
LEFT = 0.02  # of the tolerance: what may be passed in the end, by which the whole motion is slowed down
PASSED = 5e-8  # of a limit, what may be passed between grid points then
NEAR = 1e-6  # of a range of u, at its border


@record
class Fastest:
    """The fastest motion on a path.

    s : grid (K + 1,). law : the time law s(t). error : estimated error of its duration [s]. slowed : the factor of all
    times in the end.
    """

    s: Array
    law: Course
    error: float
    slowed: float


@record
class LeastTime:
    """A profile on a grid ``s`` (K + 1,), with the rows, and the passes over them, that it was found by."""

    s: Array
    rows: Rows
    passes: Passes
    profile: Profile


def fastest(
    length: float, intervals: int | None, tolerance: float, fixed: Array, limits: GridLimits
) -> Fastest:
    """Return the fastest motion from rest to rest along a path, s from 0 to ``length``.

    Parameters
    ----------
    intervals : of the grid; None for as many as the tolerance asks for. tolerance : of the duration, in parts of it.
    fixed : grid points that there have to be. limits : the rows on a grid.

    Raises
    ------
    NoProfile : there is none.
    """
    most = intervals or MOST
    least = _on(merged(np.linspace(0.0, length, min(FIRST, most // 2) + 1), fixed), limits, None)
    count, before, growth = min(EVEN, most // 2), np.inf, GROWTH[1]
    s = even_in_time(least.s, least.profile, count)
    while True:
        s = merged(s, np.append(fixed, switches(least)))
        least = _on(s, limits, least)
        margins = Margins(s, least.rows, least.profile, limits)
        margins.by_rows()
        duration = float(durations(s, margins.profile).sum())
        error = abs(before - duration) / (growth**ORDER - 1.0)
        enough = intervals is None and error <= tolerance * duration
        if enough or count >= most:
            return _finished(margins, error, max(LEFT * tolerance, PASSED))
        if intervals is None:
            wanted = 1.1 * (error / (tolerance * duration)) ** (1.0 / ORDER)
            growth = float(np.clip(wanted, *GROWTH))
        finer = min(int(np.ceil(growth * count)), most)
        count, before, growth = finer, duration, finer / count
        s = refined(s, margins.rows, margins.profile, count + LAST, least.passes.even)


def _finished(margins: Margins, error: float, left: float) -> Fastest:
    """Return the motion that passes no limit.

    error : of the duration that rows alone lead to [s]. left : what margins may leave to be passed.
    """
    s, duration = margins.s, float(durations(margins.s, margins.profile).sum())
    passed = margins.by_limits(left)
    u, x = margins.profile.between(s, FINE)
    slowed = 1.0
    while passed > PASSED and slowed < 2.0:
        slowed = 1.0 + max(2.0 * (slowed - 1.0), passed)
        passed = margins.limits.passed(s, u / slowed**2, x / slowed**2).largest
    law = time_law(s, margins.profile)
    law = law.stretched(law.duration * slowed)
    return Fastest(s, law, error + max(law.duration - duration, 0.0), slowed)


def _on(s: Array, limits: GridLimits, before: LeastTime | None) -> LeastTime:
    """Return the profile that keeps to the limits at the points of a grid; ``before`` : found on a coarser one."""
    if before is None:
        trial = _under(s, limits(s, None), np.full((len(s) - 1, len(PLACES)), np.inf))
        x = trial.profile.between(s)[1]
        return _under(s, trial.rows if limits.linear else limits(s, x), x)
    places = s[:-1, None] + np.diff(s)[:, None] * np.array(PLACES)
    x = np.interp(places, before.s, before.profile.x)
    return _under(s, limits(s, x), x)


def _under(s: Array, rows: Rows, x: Array) -> LeastTime:
    """Return the profile under rows; ``x`` (K, 3) : about what it will be."""
    zero = np.zeros((len(s) - 1, rows.A.shape[2]))
    passes = Passes(s, rows, (zero, zero), x)
    profile = passes.run()
    if not np.isfinite(
        durations(s, profile)
    ).all():  # squares of the speed are too small for double precision
        raise NoProfile(1 + int(np.argmin(profile.x[1:-1])))
    return LeastTime(s, rows, passes, profile)


def switches(least: LeastTime) -> Array:
    """Return where, inside of segments, speeding up goes over into braking."""
    s, passes, profile = least.s, least.passes, least.profile
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

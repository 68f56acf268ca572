"""The fastest time law of a path: the profile on ever finer grids, until the duration is known well enough."""

from __future__ import annotations

import numpy as np

from robodyn_cli.fastest.grid import LAST, even_in_time, merged, refined
from robodyn_cli.fastest.law import durations, time_law
from robodyn_cli.fastest.margins import Limits, Margins
from robodyn_cli.fastest.profile import Passes, Profile
from robodyn_cli.fastest.rows import FINE, PLACES, Rows
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course

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
class Found:
    """A profile on a grid ``s`` (K + 1,), with the rows, and the passes over them, that it was found by."""

    s: Array
    rows: Rows
    passes: Passes
    profile: Profile


def fastest(length: float, intervals: int | None, tolerance: float, fixed: Array, limits: Limits) -> Fastest:
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
    found = _on(merged(np.linspace(0.0, length, min(FIRST, most // 2) + 1), fixed), limits, None)
    count, before, growth = min(EVEN, most // 2), np.inf, GROWTH[1]
    s = even_in_time(found.s, found.profile, count)
    while True:
        s = merged(s, np.append(fixed, switches(found)))
        found = _on(s, limits, found)
        margins = Margins(s, found.rows, found.profile, limits)
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
        s = refined(s, margins.rows, margins.profile, count + LAST, found.passes.even)


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


def _on(s: Array, limits: Limits, before: Found | None) -> Found:
    """Return the profile that keeps to the limits at the points of a grid; ``before`` : found on a coarser one."""
    if before is None:
        found = _under(s, limits(s, None), np.full((len(s) - 1, len(PLACES)), np.inf))
        x = found.profile.between(s)[1]
        return _under(s, found.rows if limits.linear else limits(s, x), x)
    places = s[:-1, None] + np.diff(s)[:, None] * np.array(PLACES)
    x = np.interp(places, before.s, before.profile.x)
    return _under(s, limits(s, x), x)


def _under(s: Array, rows: Rows, x: Array) -> Found:
    """Return the profile under rows; ``x`` (K, 3) : about what it will be."""
    zero = np.zeros((len(s) - 1, rows.A.shape[2]))
    passes = Passes(s, rows, (zero, zero), x)
    return Found(s, rows, passes, passes.run())


def switches(found: Found) -> Array:
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

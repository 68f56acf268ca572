"""Grids along a path: where points are needed."""

from __future__ import annotations

import numpy as np

from robodyn_cli.fastest.profile import Profile
from robodyn_cli.fastest.rows import Rows
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.interpolation import divided

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

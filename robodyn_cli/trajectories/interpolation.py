"""A motion that is known instant by instant, as a course close to it everywhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.quintic_spline import course_through

FIRST = 32  # intervals of the first look
MOST = 20_000  # points
WITHIN = 1e-11  # rad or m: how far the course may be from the motion
ACCELERATION = 1e-8  # of the largest one: how far its accelerations may be
PARTS = 8  # into which an interval is divided at once
ROUNDING = 256 * np.finfo(float).eps  # of a position: over h^2, what it may make of an acceleration
BESIDE = 1e-9  # of the duration: where accelerations are taken on both sides of a knot
SHORT = 1e-6  # of the duration: in an interval so short an acceleration may jump, but no rate

Motion = Callable[[Array], tuple[Array, Array, Array]]


def interpolated(motion: Motion, duration: float, knots: Sequence[float] | None, what: str) -> Course:
    """Return quintics through positions, rates and accelerations, which are close to the motion between them too.

    Intervals are divided until the course meets the motion half-way: positions to 1e-11, accelerations to 1e-8 of the
    largest, or to what the rounding of positions makes of them in a short interval.

    Parameters
    ----------
    motion : times (T,), increasing, to positions, rates and accelerations (T, n). knots : times at which accelerations
    may jump, None where there are none known. what : the motion in words, for the error.

    Raises
    ------
    CapabilityError : rates jump on the way.
    """
    T = duration
    inside = np.array([x for x in knots or () if 0.0 < x < T])
    t = np.unique(np.concatenate([np.linspace(0.0, T, FIRST + 1), inside]))
    while True:
        h, middle = np.diff(t), 0.5 * (t[1:] + t[:-1])
        times = np.unique(np.concatenate([t, middle, inside - BESIDE * T, inside + BESIDE * T]))
        q, v, a = motion(times)
        at, between = np.searchsorted(times, t), np.searchsorted(times, middle)
        jumps = np.isin(t, inside)
        course = course_through(t, q[at], v[at], (a[at + jumps], a[at - jumps]))
        off = np.abs(course(middle) - q[between]).max(axis=1) / WITHIN
        largest = max(float(np.abs(a).max()), 1e-300)
        rough = np.abs(course(middle, 2) - a[between]).max(axis=1)
        rough /= ACCELERATION * largest + ROUNDING * np.abs(q).max() / (h * h)
        need = np.maximum(off ** (1.0 / 6.0), np.where(h > SHORT * T, rough**0.25, 0.0))
        if need.max() <= 1.0:
            return course
        if len(t) > MOST or h[need > 1.0].min() <= SHORT * T:
            break
        t = divided(t, np.clip(np.ceil(need), 1.0, PARTS))
    where = float(middle[need > 1.0][np.argmin(h[need > 1.0])])
    raise CapabilityError(
        f"{what} is not smooth at t = {where:.6g} s, so that no torque lets a simulation follow it; smooth the path "
        "there, or let it come to a stop",
        time=where,
    )


def divided(s: Array, parts: Array) -> Array:
    """Return a grid (K + 1,) with each interval divided into so many equal ``parts`` (K,)."""
    count = parts.astype(int)
    place = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)) / count[place]
    return np.append(s[place] + np.diff(s)[place] * share, s[-1])

"""The time law s(t) of a profile: in each segment s-double-dot = u0 + kappa (s - s0)."""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.run.fastest.profile import Profile
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course

ROUNDING = 1e-17  # of s, what the series may lack
DEGREES = range(3, 40, 2)
NEWTON = 6


def time_law(s: Array, profile: Profile) -> Course:
    """Return s(t) from t = 0 over a grid ``s`` (K + 1,), as polynomials of the time since each grid point.

    The solution of s'' = u0 + kappa (s - s0) is the series with c_{i+2} = kappa c_i / ((i + 1)(i + 2)).
    """
    D, v = np.diff(s), np.sqrt(profile.x)
    kappa = (profile.u1 - profile.u0) / D
    bend = 1.5 * float(np.abs(kappa).max() * np.max(2.0 * D / (v[:-1] + v[1:])) ** 2)
    degree = next((n for n in DEGREES if bend ** ((n - 1) // 2) / math.factorial(n) < ROUNDING), DEGREES[-1])
    c = _series(v[:-1], profile.u0, kappa, degree)
    # the time of a segment is well determined from its slower end, where the motion may begin or come to rest
    faster = v[1:] >= v[:-1]
    slow = _series(np.minimum(v[:-1], v[1:]), np.where(faster, profile.u0, -profile.u1), kappa, degree)
    h = 2.0 * D / (v[:-1] + v[1:])
    for _ in range(NEWTON):
        way, speed = np.zeros_like(h), np.zeros_like(h)
        for i in range(degree, 0, -1):
            way, speed = (way + slow[i]) * h, speed * h + i * slow[i]
        h = h + np.clip((D - way) / speed, -0.5 * h, h)
    c[0] = s[:-1]
    return Course(np.concatenate([[0.0], np.cumsum(h)]), c[:, :, None])


def _series(v: Array, u: Array, kappa: Array, degree: int) -> Array:
    """Return the coefficients (degree + 1, K) of the way from a point with speed v and acceleration u."""
    c = np.zeros((degree + 1, len(v)))
    c[1], c[2] = v, 0.5 * u
    for i in range(3, degree + 1):
        c[i] = kappa * c[i - 2] / (i * (i - 1))
    return c

"""The time law s(t) of a profile: in each segment s-double-dot = u0 + kappa (s - s0)."""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.fastest.profile import Profile
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course

ROUNDING = 1e-17  # of s, what the series may lack
DEGREES = range(3, 40, 2)
SMALL = 1e-4  # y up to which artanh(sqrt y) / sqrt y is 1 + y / 3 + y^2 / 5 + y^3 / 7 to rounding


def durations(s: Array, profile: Profile) -> Array:
    """Return the times (K,) of the segments of a grid ``s`` (K + 1,).

    With the speed v in the middle of the time h of a segment v0 + v1 = 2 v cosh(r h / 2) and D = 2 v sinh(r h / 2) / r,
    r^2 = kappa, so that h = 2 artanh(r D / (v0 + v1)) / r, with arctan where kappa is negative.
    """
    D, v = np.diff(s), np.sqrt(profile.x)
    half = D / (v[:-1] + v[1:])
    y = (profile.u1 - profile.u0) / D * half * half
    r = np.sqrt(np.abs(y))
    small = np.abs(y) < SMALL
    with np.errstate(all="ignore"):
        large = np.where(y > 0.0, np.arctanh(r), np.arctan(r)) / r
    return 2.0 * half * np.where(small, 1.0 + y * (1.0 / 3.0 + y * (0.2 + y / 7.0)), large)


def time_law(s: Array, profile: Profile) -> Course:
    """Return s(t) from t = 0 over a grid ``s`` (K + 1,), as polynomials of the time since each grid point.

    The solution of s'' = u0 + kappa (s - s0) is the series with c_{i+2} = kappa c_i / ((i + 1)(i + 2)).
    """
    h = durations(s, profile)
    kappa = (profile.u1 - profile.u0) / np.diff(s)
    bend = float(np.abs(kappa * h * h).max())
    degree = next((n for n in DEGREES if bend ** ((n - 1) // 2) / math.factorial(n) < ROUNDING), DEGREES[-1])
    c = np.zeros((degree + 1, len(h)))
    c[0], c[1], c[2] = s[:-1], np.sqrt(profile.x[:-1]), 0.5 * profile.u0
    for i in range(3, degree + 1):
        c[i] = kappa * c[i - 2] / (i * (i - 1))
    return Course(np.concatenate([[0.0], np.cumsum(h)]), c[:, :, None])

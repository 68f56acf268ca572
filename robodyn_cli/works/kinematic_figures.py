"""Figures of motions without forces, as functions of columns: of joints, points and angles of one run or of many."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.extremes import integral, largest, largest_magnitude, smallest
from robodyn_cli.spatial.algebra import Array

PLACES = (
    "points",
    "point_velocities",
    "point_accelerations",
)  # datasets of a point's motion, from positions on
MEETING = (
    1e-9  # part of their distance from the origin, within which points are at one place: loops close as well
)
AT_SAMPLE = 1e-9  # part of an interval: a time so near to a sample is the sample's
# values and errors (n,) of columns of one run, or of many, by figure
Figures = dict[str, tuple[Array, Array]]


def range_figures(
    times: Array, motion: tuple[Array, Array, Array], breaks: Sequence[float], closed: float
) -> Figures:
    """Return where joints go, and how fast.

    motion : columns of positions, rates and accelerations (T, n). closed : how far positions may be off at the samples
    [rad or m].
    """
    low, high = (extreme(times, motion[0], breaks) for extreme in (smallest, largest))
    speed, acceleration = (largest_magnitude(times, x, breaks) for x in motion[1:])
    return {
        "smallest": (low.value, low.error + closed),
        "largest": (high.value, high.error + closed),
        "peak_speed": (speed.value, speed.error),
        "peak_acceleration": (acceleration.value, acceleration.error),
    }


def path_figures(times: Array, v: Array, a: Array, breaks: Sequence[float]) -> Figures:
    """Return the figures of paths of points with velocities and accelerations (T, n, 3)."""
    speed, size = (np.linalg.norm(x, axis=2) for x in (v, a))
    fastest, most = (largest(times, x, breaks) for x in (speed, size))
    return {
        "path_length": integral(times, speed, breaks),
        "peak_speed": (fastest.value, fastest.error),
        "peak_acceleration": (most.value, most.error),
    }


def ratio_figures(
    times: Array, passive: Array, psi: Array, breaks: Sequence[float], closed: float
) -> Figures:
    """Return how near dead points are, from singular values (T, n, k) of the passive block and of all of Psi."""
    least = smallest(times, passive[:, :, -1] / psi[:, :, 0], breaks)
    # singular values are no less than 0, where they have kinks that a polynomial cuts off
    return {
        "smallest": (np.maximum(least.value, 0.0), least.error + closed),
        "time": (least.time, least.time_error),
    }


def transmission_figures(times: Array, angle: Array, breaks: Sequence[float], closed: float) -> Figures:
    """Return the extremes of transmission angles (T, n) [rad]."""
    figures: Figures = {}
    for name, extreme in (("smallest", smallest), ("largest", largest)):
        end = extreme(times, np.degrees(angle), breaks)
        figures[f"{name}_deg"] = end.value, end.error + math.degrees(closed)
        figures[f"{name}_time"] = end.time, end.time_error
    return figures


def of_one(figures: Figures, k: int = 0) -> tuple[dict[str, float], dict[str, float]]:
    """Return the values and the errors of figures of one column, the k-th."""
    own, off = ({name: float(x[part][k]) for name, x in figures.items()} for part in (0, 1))
    return own, off


def refuse_meeting(scene: Scene, ways: Mapping[str, Array], pair: Sequence[str], key: str) -> None:
    """Refuse two points between which a figure needs a line, where they are at one place; ways : as of the angle.

    Raises
    ------
    CapabilityError
    """
    a, b = (ways[f"points/{name}"] for name in pair)
    size = max(float(np.linalg.norm(x, axis=-1).max()) for x in (a, b))
    if not np.linalg.norm(b - a, axis=-1).min() > MEETING * size:
        one, other = pair
        raise CapabilityError(
            f"{one!r} and {other!r} are at one place, where no line leads from one to the other; "
            "allowed: points that keep apart",
            (scene.path, key),
            key=key,
        )


def transmission_angle(ways: Mapping[str, Array], points: Sequence[str]) -> Array:
    """Return the angle at the second of three points (...,) [rad], from 0 to pi; ways : of the points (..., 3)."""
    a, b, c = (ways[f"points/{name}"] for name in points)
    u, w = a - b, c - b
    across = np.linalg.norm(np.cross(u, w), axis=-1)
    angle: Array = np.arctan2(across, np.einsum("...i,...i->...", u, w))
    return angle


def between_samples(time: float, times: Array) -> tuple[int, float, float]:
    """Return between which samples a time is: the number of the first one, the interval [s], the part of it."""
    k = int(np.clip(np.searchsorted(times, time) - 1, 0, len(times) - 2))
    h = float(times[k + 1] - times[k])
    s = (time - float(times[k])) / h
    return k, h, 1.0 if abs(s - 1.0) < AT_SAMPLE else 0.0 if abs(s) < AT_SAMPLE else s

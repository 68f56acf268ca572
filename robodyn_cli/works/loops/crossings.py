"""Where a response meets the unit circle and the negative real axis, and where it is largest: all such frequencies.

Candidates are eigenvalues: of Hamiltonian matrices (Boyd, Balakrishnan and Kabamba 1989; Bruinsma and Steinbuch 1990)
and of the pencil whose zeros are those of L(s) - L(-s). They only refine a grid, on which changes of sign are bracketed
and closed by Brent's method, so that no tolerance decides whether an eigenvalue is imaginary.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from robodyn_cli.spatial.algebra import Array
from robodyn_cli.works.loops.systems import StateSpace

POINTS = 300  # of the grid
BEYOND = 1e3  # how far it goes beyond the slowest and the fastest pole
NEARNESS = np.geomspace(1e-9, 0.5, 14)  # how near points lie around a pole and a candidate, relative
REAL = 1e-12  # a response with so small an imaginary part, relative, counts as real
NOTHING = 1e-12  # a response this small is none
LEVELS = 6  # times that a peak is looked for above the highest found


def grid(system: StateSpace, more: Array) -> Array:
    """Return angular frequencies (F,) [rad/s] that show what a system does, around its poles, and ``more``, closer."""
    poles = system.poles
    if system.period is not None:
        with np.errstate(all="ignore"):
            poles = np.log(np.where(poles == 0.0, 1.0, poles).astype(complex)) / system.period
    sizes = np.abs(poles)
    size = float(sizes.max(initial=0.0)) or 1.0
    known = sizes[sizes > 1e-9 * size]
    ends = known if len(known) else np.array([1.0])
    top = system.last_frequency
    low, high = float(ends.min()) / BEYOND, min(float(ends.max()) * BEYOND, top)
    if math.isfinite(top):
        low = min(low, 1e-3 * top)
    points = [np.geomspace(low, high, POINTS)]
    if math.isfinite(top):
        points.append(np.linspace(0.0, top, POINTS // 2)[1:])
    centres = np.concatenate([np.abs(poles.imag), sizes, more])
    centres = centres[(centres > 0.0) & np.isfinite(centres)]
    near = centres[:, None] * np.concatenate([1.0 - NEARNESS, 1.0 + NEARNESS])
    found = np.unique(np.concatenate([*points, near.ravel()]))
    return found[(found > 0.0) & (found <= top)]


def circle_candidates(system: StateSpace, level: float = 1.0) -> Array:
    """Return frequencies of which some are all those where a singular value of the response is ``level``."""
    plain = system.continuous
    if plain is None:
        return np.zeros(0)
    A, B, C, D = plain.A, plain.B, plain.C, plain.D
    R = level**2 * np.eye(D.shape[1]) - D.T @ D
    if abs(np.linalg.det(R)) < 1e-14:
        R = R + 1e-9 * np.eye(len(R))
    inner = np.linalg.solve(R, D.T @ C)
    H = np.block(
        [
            [A + B @ inner, B @ np.linalg.solve(R, B.T)],
            [-C.T @ (C + D @ inner), -(A + B @ inner).T],
        ]
    )
    return _imaginary(system, np.linalg.eigvals(H))


def axis_candidates(system: StateSpace) -> Array:
    """Return frequencies of which some are all those where a single response is real."""
    from scipy.linalg import eigvals

    plain = system.continuous
    if plain is None:
        return np.zeros(0)
    n = len(plain.A)
    pencil = np.zeros((2 * n + 1, 2 * n + 1))
    pencil[:n, :n], pencil[n : 2 * n, n : 2 * n] = plain.A, -plain.A
    pencil[:n, -1:], pencil[n : 2 * n, -1:] = plain.B, plain.B
    pencil[-1, :n], pencil[-1, n : 2 * n] = plain.C[0], plain.C[0]
    found = eigvals(pencil, np.diag([*np.ones(2 * n), 0.0]))
    return _imaginary(system, found[np.isfinite(found)])


def _imaginary(system: StateSpace, values: Array) -> Array:
    found: Array = system.frequency_of(np.unique(np.abs(values.imag)))
    return found


def roots(f: Callable[[float], float], points: Array, values: Array) -> list[float]:
    """Return the roots of a function in the gaps between points (F,) where its values (F,) change sign."""
    from scipy.optimize import brentq

    found = [float(w) for w, y in zip(points, values) if y == 0.0]
    changes = np.flatnonzero(values[1:] * values[:-1] < 0.0)
    for k in changes.tolist():
        found.append(brentq(f, points[k], points[k + 1], xtol=1e-300, rtol=4.0 * np.finfo(float).eps))
    return sorted(found)


def circle_crossings(loop: StateSpace) -> list[float]:
    """Return the frequencies [rad/s] at which |L| = 1."""
    points = grid(loop, circle_candidates(loop))
    values = np.log(np.maximum(np.abs(loop.at(points)[:, 0, 0]), 1e-300))
    if loop.period is None:  # on to where it is surely below, and to where its limit at 0 shows
        points, values = _outward(loop, points, values)
    return roots(lambda w: float(np.log(abs(loop.at(np.array([w]))[0, 0, 0]))), points, values)


def _outward(loop: StateSpace, points: Array, values: Array) -> tuple[Array, Array]:
    more = np.concatenate([points[0] * np.geomspace(1e-6, 0.1, 6), points[-1] * np.geomspace(10.0, 1e9, 9)])
    every = np.concatenate([points, more])
    found = np.log(np.maximum(np.abs(loop.at(more)[:, 0, 0]), 1e-300))
    order = np.argsort(every)
    return every[order], np.concatenate([values, found])[order]


def axis_crossings(loop: StateSpace) -> list[float]:
    """Return the frequencies [rad/s] at which L is real and negative, the ends 0 and pi / T among them."""
    points = grid(loop, axis_candidates(loop))
    values = _turned(loop, points)
    if np.mean(np.abs(values) < REAL) > 0.5:  # it is real everywhere, or nothing
        return []
    values = np.where(np.abs(values) < REAL, 0.0, values)
    # where rounding hides the sign between two points of other signs, that is one change
    seen = values != 0.0
    found = roots(lambda w: float(_turned(loop, np.array([w]))[0]), points[seen], values[seen])
    ends = [0.0] if loop.period is None else [0.0, loop.last_frequency]
    return [w for w in [*ends, *found] if _is_negative(loop, w)]


def _turned(loop: StateSpace, points: Array) -> Array:
    """Return the sines of the angles of a response."""
    y = loop.at(points)[:, 0, 0]
    found: Array = np.where(np.abs(y) > NOTHING, y.imag / np.maximum(np.abs(y), 1e-300), 0.0)
    return found


def _is_negative(loop: StateSpace, frequency: float) -> bool:
    """Tell whether a response is finite, real and negative; at a pole it is not."""
    y = complex(loop.at(np.array([frequency]))[0, 0, 0])
    finite = math.isfinite(abs(y)) and NOTHING < abs(y) < 1.0 / NOTHING
    return finite and y.real < 0.0 and abs(y.imag) < 1e-6 * abs(y)


def peak(system: StateSpace) -> tuple[float, float]:
    """Return the largest singular value of a response that decays (H-infinity norm) and its frequency [rad/s].

    The frequency is infinite where nothing is as large as the limit there.
    """
    top = system.last_frequency
    points = grid(system, np.zeros(0))
    best, where = _end(system, top)
    for _ in range(LEVELS):
        points, heights = _with_summits(system, points)
        k = int(np.argmax(heights))
        if heights[k] > best * (1.0 + 1e-13):
            best, where = float(heights[k]), float(points[k])
        above = circle_candidates(system, best * (1.0 + 1e-10))
        above = above[above > 0.0]
        middle = np.concatenate([above, 0.5 * (above[1:] + above[:-1])]) if len(above) else above
        higher = middle[_sizes(system, middle) > best * (1.0 + 1e-10)] if len(middle) else middle
        if not len(higher):
            break
        points = np.union1d(points, higher)
    return best, where


def _end(system: StateSpace, top: float) -> tuple[float, float]:
    """Return the larger of the limits at the frequencies 0 and ``top``, and which."""
    last = (
        float(np.linalg.norm(system.D, 2)) if math.isinf(top) else float(_sizes(system, np.array([top]))[0])
    )
    first = float(_sizes(system, np.zeros(1))[0])
    return (first, 0.0) if math.isfinite(first) and first > last else (last, top)


def _sizes(system: StateSpace, points: Array) -> Array:
    """Return the largest singular values of a response, 0 at a pole itself, which a mode beside the loop may have."""
    y = system.at(points)
    finite = np.isfinite(y).all(axis=(1, 2))
    found = np.zeros(len(points))
    found[finite] = np.linalg.norm(y[finite], 2, axis=(1, 2))
    return found


def _with_summits(system: StateSpace, points: Array) -> tuple[Array, Array]:
    """Return points with the summits between them, by the roots of the slope around the highest, and their heights."""
    heights = _sizes(system, points)
    inner = (heights[1:-1] >= heights[:-2]) & (heights[1:-1] >= heights[2:])
    summits = np.flatnonzero(inner) + 1
    highest = summits[np.argsort(-heights[summits])[:5]]
    found = []
    for k in highest.tolist():
        around = points[k - 1 : k + 2]
        slopes = np.array([slope_of_size(system, w) for w in around])
        found += roots(lambda w: slope_of_size(system, w), around, slopes)
    more = np.array(found)
    if not len(more):
        return points, heights
    every = np.concatenate([points, more])
    order = np.argsort(every)
    return every[order], np.concatenate([heights, _sizes(system, more)])[order]


def slope_of_size(system: StateSpace, frequency: float) -> float:
    """Return the derivative of the largest singular value of a response by the frequency."""
    y, slope = system.with_slope(np.array([frequency]))
    if not (np.isfinite(y).all() and np.isfinite(slope).all()):
        return 0.0
    left, _, right = np.linalg.svd(y[0])
    return float((left[:, 0].conj() @ slope[0] @ right[0].conj()).real)

"""How much later the torque of a sampled loop may come: until the exact model under the hold has a pole on the circle.

A delay changes the response under a hold by more than its phase: what acts in a period is shared by two samples. So the
margin is the least delay at which L = -1 at some frequency, of models with that delay, not phase over frequency.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from robodyn_cli.spatial.algebra import Array
from robodyn_cli.works.loops.crossings import circle_crossings, roots
from robodyn_cli.works.loops.margins import ROUNDED, SAFETY, Margin
from robodyn_cli.works.loops.systems import StateSpace

# loops with one input that comes later by less than a period [s]: the loop, and its neighbours within rounding
Later = Callable[[float], Iterator[StateSpace]]
STARTS = 4  # parts of a period from which crossings are followed
POINTS = 17  # of a period between which a pole at -1 is looked for
CLOSED = 1e-9  # so far may L be from -1 at a root
STEP = 1e-6  # of differences, relative


def delay_margin(later: Later, period: float) -> Margin:
    """Return the least further delay [s] with a pole on the unit circle, and the frequency of that pole."""
    found = [*_pairs(later, period), *_at_minus_one(later, period)]
    if not found:
        return Margin(math.inf)
    delay, w = min(found)
    error, shift = _errors(later, period, delay, w)
    return Margin(delay, w, error, shift)


def _responses(later: Later, period: float, delay: float, w: float, all_: bool = False) -> list[complex]:
    """Return -L of the loop, and of its neighbours if ``all_``, late by a delay."""
    whole = math.floor(delay / period)
    turn = -cmath.exp(-1j * w * whole * period)
    loops = later(max(delay - whole * period, 0.0))
    return [turn * complex(one.at(np.array([w]))[0, 0, 0]) for one in (loops if all_ else [next(loops)])]


def _pairs(later: Later, period: float) -> list[tuple[float, float]]:
    """Return delays and frequencies of pairs of poles on the circle, followed from where |L| = 1 at parts of a period;
    those that begin well beyond the least do not come before it."""
    starts = []
    for part in (np.arange(STARTS) * (period / STARTS)).tolist():
        loop = next(later(part))
        for w in circle_crossings(loop):
            late = cmath.phase(-complex(loop.at(np.array([w]))[0, 0, 0])) % math.tau / w
            starts += [(x, w) for x in (part + late, part + late - math.tau / w) if x > 0.0]
    most = min((x for x, _ in starts), default=0.0) + 2.0 * period
    followed = (_followed(later, period, x, w) for x, w in starts if x <= most)
    found = [one for one in followed if one is not None]
    if not found and starts:
        return [one for one in (_followed(later, period, x, w) for x, w in starts) if one is not None]
    return found


def _followed(later: Later, period: float, start: float, w: float) -> tuple[float, float] | None:
    """Return the root L = -1 by delay and frequency that is reached from nearby; None without one."""
    from scipy.optimize import root

    def off(x: Array) -> list[float]:
        y = cmath.log(_responses(later, period, abs(float(x[0])) * start, float(x[1]) * w)[0])
        return [y.real, y.imag]

    end: Any = root(off, [1.0, 1.0], tol=1e-14)
    delay, frequency = abs(float(end.x[0])) * start, abs(float(end.x[1])) * w
    inside = frequency <= math.pi / period * (1.0 + 1e-9)
    return (delay, frequency) if np.abs(end.fun).max() < CLOSED and inside else None


def _at_minus_one(later: Later, period: float) -> list[tuple[float, float]]:
    """Return delays with a pole at -1, and its frequency: half of that of the samples."""
    w = math.pi / period

    def real(delay: float) -> float:
        return _responses(later, period, delay, w)[0].real

    points = np.linspace(0.0, 2.0 * period, 2 * POINTS - 1)
    values = np.array([real(float(x)) for x in points]) - 1.0
    return [(x, w) for x in roots(lambda x: real(x) - 1.0, points, values) if x > 0.0]


def _errors(later: Later, period: float, delay: float, w: float) -> tuple[float, float]:
    """Return the errors of delay and frequency: how far the root moves with neighbouring loops, and what is left."""

    def logs(delay: float, w: float, all_: bool = False) -> Array:
        y = np.log(np.array(_responses(later, period, delay, w, all_)))
        return np.array([y.real, y.imag])

    here = logs(delay, w, True)
    by_delay = (logs(delay * (1.0 + STEP), w) - here[:, :1]) / (delay * STEP)
    by_w = (logs(delay, w * (1.0 - STEP)) - here[:, :1]) / (-w * STEP)
    off = np.concatenate([here[:, :1], here[:, 1:] - here[:, :1]], axis=1)
    if w >= math.pi / period * (1.0 - STEP):  # real there, whatever moves
        shift = float(np.abs(off[0]).max() / abs(by_delay[0, 0])) if by_delay[0, 0] else math.inf
        return SAFETY * shift + ROUNDED * delay, 0.0
    try:
        moved = np.abs(np.linalg.solve(np.hstack([by_delay, by_w]), off)).max(axis=1)
    except np.linalg.LinAlgError:
        return math.inf, math.inf
    return SAFETY * float(moved[0]) + ROUNDED * delay, SAFETY * float(moved[1]) + ROUNDED * w

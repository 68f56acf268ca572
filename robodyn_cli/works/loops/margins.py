"""What a loop may bear until it is not stable: of its gain, of its phase, and how late it may come."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.works.loops.crossings import axis_crossings, circle_crossings, peak, slope_of_size
from robodyn_cli.works.loops.systems import StateSpace

SAFETY = 4.0
ROUNDED = 1e-14  # of a figure


@record
class Margin:
    """A margin, the angular frequency [rad/s] where it is taken, and their errors.

    Infinite at nan where the loop never comes there; infinite as a frequency where it is that of a limit.
    """

    value: float
    frequency: float = math.nan
    error: float = 0.0
    frequency_error: float = 0.0


@record
class StabilityMargins:
    """The margins of a loop of one input: gain upward and downward, phase [rad], delay [s], peak of 1 / |1 + L|."""

    gain: Margin
    reduction: Margin
    phase: Margin
    delay: Margin
    sensitivity: Margin


@np.errstate(all="ignore")  # at a pole a response is not finite, and passed over
def margins(loop: StateSpace, others: Sequence[StateSpace]) -> StabilityMargins:
    """Return the margins of a loop L with one input that is stable when closed by u = -L u.

    gain : least factor above 1 with which L meets -1, reduction : largest below 1, 0 without one. phase : the turn of
    least size with which L meets -1, later is positive; delay : the least time that is late by such a turn.

    others : neighbouring loops, apart by as much as rounding may be.
    """
    gains = [_gain(loop, others, w) for w in axis_crossings(loop)]
    up = min((x for x in gains if x.value >= 1.0), key=lambda x: x.value, default=Margin(math.inf))
    down = max((x for x in gains if x.value < 1.0), key=lambda x: x.value, default=Margin(0.0))
    turns = [_phase(loop, others, w) for w in circle_crossings(loop)]
    phase = min(turns, key=lambda x: abs(x.value), default=Margin(math.inf))
    delay = min((_delay(x) for x in turns), key=lambda x: x.value, default=Margin(math.inf))
    return StabilityMargins(up, down, phase, delay, sensitivity(loop, others))


def _moved(loop: StateSpace, others: Sequence[StateSpace], w: float) -> tuple[complex, complex, Array]:
    """Return a response, its slope, and by how much those of neighbouring loops differ (N,)."""
    at = np.array([w])
    y, slope = (complex(x[0, 0, 0]) for x in loop.with_slope(at))
    return y, slope, np.array([complex(other.at(at)[0, 0, 0]) - y for other in others])


def _gain(loop: StateSpace, others: Sequence[StateSpace], w: float) -> Margin:
    y, slope, off = _moved(loop, others, w)
    shift = _over(np.abs(off.imag).max(initial=0.0), abs(slope.imag)) if w else 0.0
    if w == loop.last_frequency:
        shift = 0.0
    moved = float(np.abs(off.real).max(initial=0.0)) + abs(slope.real) * shift
    value = -1.0 / y.real
    error = SAFETY * value * moved / abs(y.real) + ROUNDED * value
    return Margin(value, w, error, SAFETY * shift + ROUNDED * w * (0.0 < w < loop.last_frequency))


def _phase(loop: StateSpace, others: Sequence[StateSpace], w: float) -> Margin:
    y, slope, off = _moved(loop, others, w)
    growth = (slope / y).real
    shift = _over(float(np.abs((off / y).real).max(initial=0.0)), abs(growth))
    moved = float(np.abs((off / y).imag).max(initial=0.0)) + abs((slope / y).imag) * shift
    return Margin(cmath.phase(-y), w, SAFETY * moved + ROUNDED, SAFETY * shift + ROUNDED * w)


def _delay(phase: Margin) -> Margin:
    late, w = phase.value % math.tau, phase.frequency
    error = (phase.error + late * phase.frequency_error / w) / w
    return Margin(late / w, w, error, phase.frequency_error)


def sensitivity(loop: StateSpace, others: Sequence[StateSpace]) -> Margin:
    """Return the largest singular value of (E + L)^-1 over all frequencies."""
    own = loop.sensitivity
    value, w = peak(own)
    if math.isinf(w):
        return Margin(value, w, ROUNDED * value, 0.0)
    moved = [float(np.linalg.norm(other.sensitivity.at(np.array([w]))[0], 2)) - value for other in others]
    error = SAFETY * max(map(abs, moved), default=0.0) + ROUNDED * value
    if w in (0.0, loop.last_frequency):
        return Margin(value, w, error, 0.0)
    step = 1e-4 * w
    step = min(step, 0.5 * (loop.last_frequency - w))
    bend = (slope_of_size(own, w + step) - slope_of_size(own, w - step)) / (2.0 * step)
    tilt = max((abs(slope_of_size(other.sensitivity, w)) for other in others), default=0.0)
    return Margin(value, w, error, SAFETY * _over(tilt, abs(bend)) + ROUNDED * w)


def _over(moved: float, slope: float) -> float:
    """Return how far a root moves, infinite where it is not crossed but touched."""
    return 0.0 if moved == 0.0 else moved / slope if slope else math.inf

"""How a small change of the start grows along a motion: as a power of time, or exponentially, as in chaos.

Errors of an integration grow in the same way. Two motions that start close together tell the ways apart: their
distance d(t) rises by p ln 2 over each doubling of the time where it grows as t^p, and by lambda T
over each equal stretch T where it grows as e^(lambda t) (Lichtenberg and Lieberman 1992, section 5.2). An instability
that passes, such as the fall of a pendulum that stood upright, lifts it once.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.errors import RobodynError
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.work_precision.entries import LONGEST, SECONDS, driver_of, positions_and_rates
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

CHANGE = 1e-7  # of the start, relative
TOLERANCE = 1e-12  # of the runs: their own errors stay small beside the change
SATURATED = 0.01  # of the range of the motion: beyond this distance the two no longer follow each other
MOST = 40  # times that they are brought together again
WINDOWS = 12  # of equal length, of whose distances the medians are taken: spikes count for little
SKIPPED = 3  # windows at the start
LEAST = 4.0  # rise of ln d over the others, below which nothing is called exponential: t^p would need p > 2.5
CLEAR = 6.5  # rise that no motion has that grows as a power of time: t^p would need p > 4
STEADY = 0.1  # of the whole rise: the least of either half


@record
class Sensitivity:
    """How a small change of the start has grown.

    kind : ``exponential``, ``polynomial`` (or not at all), or ``unknown`` where the changed motion does not get
    through. growth : times by which it has grown at the end. e_folding : time in which it grows e times [s].
    """

    kind: str
    growth: float
    e_folding: float | None = None


def motion_at(motion: Motion, method: str, start: Array, grid: Grid, options: Options) -> Array:
    """Return q and v (T, nq + nv) on a grid."""
    return positions_and_rates(motion.system, _states(motion, method, start, grid, options))


def _states(motion: Motion, method: str, start: Array, grid: Grid, options: Options) -> Array:
    """Return the states (T, nx) on a grid, from its first instant on."""
    driver = driver_of(motion, method, options, 3.0 * SECONDS)
    driver.start(grid.start, start)
    end = grid.start + (grid.count - 1) * grid.step
    return driver.samples(end, grid, watch=bool(motion.watchers))


def sensitivity(motion: Motion, until: float, method: str, samples: int) -> Sensitivity:
    """Return how a small change of the start has grown at ``until`` [s]."""
    try:
        times, logarithms, growth = _distances(motion, Grid.over(until, samples), method)
    except RobodynError:
        return Sensitivity("unknown", float("nan"))
    rate = exponential_rate(times, logarithms)
    if rate is None:
        return Sensitivity("polynomial", growth)
    return Sensitivity("exponential", growth, 1.0 / rate)


def _distances(motion: Motion, grid: Grid, method: str) -> tuple[Array, Array, float]:
    """Return times (T,), ln d there (T,), and by how much the first change had grown at the end of its own growth.

    d is the largest distance of any quantity over its range. Where it has saturated, the second motion is brought close
    to the first again, along the same direction (Benettin et al. 1980), unless there are contact states to follow.
    """
    options = Options(TOLERANCE, TOLERANCE, max_steps=5 * LONGEST)
    places = [*motion.system.q_places, *motion.system.v_places]
    start = motion.start
    step = np.zeros_like(start)
    step[places] = CHANGE * (1.0 + np.abs(start[places]))
    size, offset, first = float(step.max()), 0.0, 0
    pieces: list[Array] = []
    scale: Array | None = None
    growth = 1.0
    for _ in range(MOST):
        rest = Grid(grid.start + first * grid.step, grid.step, grid.count - first)
        a, b = (_states(motion, method, x, rest, options) for x in (start, start + step))
        count = min(len(a), len(b))
        a, b = a[:count], b[:count]
        if scale is None:
            scale = np.maximum(np.ptp(a, axis=0), 1e-12)
            growth = float(np.abs(a[-1] - b[-1]).max()) / size
        apart = np.max(np.abs(a - b) / scale, axis=1)
        beyond = np.flatnonzero(apart > SATURATED)
        last = int(beyond[0]) if len(beyond) else count - 1
        pieces.append(np.log(np.maximum(apart[: last + 1], 1e-300))[bool(first) :] + offset)
        first += last
        if motion.watchers or last < 2 or first >= grid.count - 2 or not len(beyond):
            break
        start, step = a[last], (b[last] - a[last]) * (apart[0] / apart[last])
        offset += float(np.log(apart[last] / apart[0]))
    logarithms = np.concatenate(pieces)
    return grid.times(0, len(logarithms)), logarithms, growth


def exponential_rate(times: Array, logarithms: Array) -> float | None:
    """Return lambda [1/s] of a distance d that grows as e^(lambda t), from ln d (T,); None for other growth.

    Growth is exponential where ln d rises more than powers of time explain, or a line in t fits it better than one in
    ln t, and where either half of the time has a part of the rise.
    """
    if len(times) < 4 * WINDOWS:
        return None
    middles = np.array([part.mean() for part in np.array_split(times, WINDOWS)])[SKIPPED:]
    medians = np.array([np.median(part) for part in np.array_split(logarithms, WINDOWS)])[SKIPPED:]
    half = len(medians) // 2
    total, early = float(medians[-1] - medians[0]), float(medians[half] - medians[0])
    if total < LEAST or min(early, total - early) < STEADY * total:
        return None
    in_time, in_log = (
        float(np.polyfit(x, medians, 1, full=True)[1].sum()) for x in (middles, np.log(middles))
    )
    if total < CLEAR and in_time > in_log:
        return None
    return total / float(middles[-1] - middles[0])

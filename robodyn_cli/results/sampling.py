"""Whether the samples of a run are near enough to show what is between them: by rates that are stored with them, and
by how far joints turn from one sample to the next."""

from __future__ import annotations

import numpy as np

from robodyn_cli.commands import COMMANDS
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.results.stated_errors import meaningful_error
from robodyn_cli.spatial.algebra import Array

# of the range of a curve, by which a straight line between two samples may miss it: 6 samples a period miss by 0.067
PART = 0.05
TURN = 1.0  # rad between two samples, beyond which directions and what follows from them are not shown
LEAST = 1e-6  # of the largest value of its unit: what varies by less is not seen
FEWEST = 10  # intervals in a row that a line is drawn through
MOST_LINES = 400  # so many of them at most
# datasets with their rates of change
RATES = {"q": "qd", "qd": "qdd", "points": "point_velocities", "point_velocities": "point_accelerations"}
STATE = "q"
MUCH = 0.1  # of the intervals between samples


def too_far_apart(result: Result, path: str = "") -> Array:
    """Tell of each interval between samples and each column of a dataset (T - 1, n) whether a straight line would hide
    how the column goes there; (T - 1, 1) of all columns alike where no rates of them are stored, and of anything that
    follows from the state where no path is given.

    The cubic polynomial that has values and rates of both samples says how it goes. What follows from the state has no
    rates: it may go twice as often as a coordinate, as squares do, and round as often as a joint. Of kinetic energy
    rates tell, where accelerations are stored: a crank that turns evenly keeps its own. Where something happens, curves
    jump and bend.
    """
    if "time" not in result or len(result.time) < 2:
        return np.zeros((0, 1), dtype=bool)
    group, _, name = path.partition("/")
    rates = f"{RATES[group]}/{name}" if name and group in RATES else RATES.get(group, "")
    if path in result and rates in result:
        missed = _missed(result, path, rates)
    elif path == "energy/kinetic" and "qd" in result and "qdd" in result:
        missed = _any(_missed(result, "qd", "qdd") | _missed(result, "qd", "qdd", squared=True))
    elif STATE in result and RATES[STATE] in result:
        pair = STATE, RATES[STATE]
        missed = _any(_missed(result, *pair) | _missed(result, *pair, squared=True))
        missed |= _any(_turned(result)) & (path != "energy/kinetic")
    else:
        return np.zeros((len(result.time) - 1, 1), dtype=bool)
    missed[_happened(result)] = False
    return np.column_stack([_together(column) for column in missed.T]) if missed.shape[1] else missed


def _missed(result: Result, path: str, rates: str, squared: bool = False) -> Array:
    """Tell where lines between samples miss the columns (T - 1, n) of a dataset, or their squares about the middle of
    their range."""
    y, yd, known = result[path], result[rates], _rates_of(result, path, rates)
    missed = np.zeros((len(y) - 1, y.shape[1]), dtype=bool)
    with np.errstate(all="ignore"):
        low, high = np.nanmin(y, axis=0, initial=np.inf), np.nanmax(y, axis=0, initial=-np.inf)
        least = np.fmax(_seen(result, path), 2.0 * meaningful_error(result, path))
        for k, j in known.items():
            x, v = y[:, k] - 0.5 * (low[k] + high[k]), yd[:, j]
            if squared:
                missed[:, k] = _strays(result.time, x * x, 2.0 * x * v, float(least[k] ** 2))
            else:
                missed[:, k] = _strays(result.time, x, v, float(least[k]))
    if path == STATE and not squared:  # attitudes, whose rates are those of angles
        others = [k for k in range(y.shape[1]) if k not in known]
        missed[:, others] |= _any(_turned(result, tuple(known.values())))
    return missed


def _strays(time: Array, x: Array, v: Array, least: float) -> Array:
    """Tell in which intervals (T - 1,) the cubic with values and rates (T,) leaves the straight line by too much of the
    range of the values, or of ``least``."""
    way, h = np.diff(x), np.diff(time)
    first, last = h * v[:-1] - way, h * v[1:] - way
    off = [abs(s * (1.0 - s) * ((1.0 - s) * first - s * last)) for s in (0.25, 0.5, 0.75)]
    reach = np.nanmax(x, initial=-np.inf) - np.nanmin(x, initial=np.inf)
    return np.asarray(np.max(off, axis=0) > PART * np.fmax(reach, least))


def is_sparse(result: Result) -> bool:
    """Tell whether samples are too far apart in so much of a run that whoever started it is told."""
    missed = _any(too_far_apart(result, STATE))
    if STATE in result and RATES[STATE] in result:
        missed |= _any(_turned(result))
    return bool(missed.size and missed.mean() > MUCH)


def sparse_words(result: Result) -> str:
    """Return the line that says that samples are too far apart."""
    row = COMMANDS.get(result.command)
    key = f" ({row.samples})" if row is not None and row.samples else ""
    steps, apart = (result.summary.get("counters") or {}).get("steps", 0), max(1, len(result.time) - 1)
    taken = f": the integrator took {steps / apart:.0f} steps between two" if steps >= 2 * apart else ""
    return f"Samples are too far apart to show the motion{taken}{key}"


def _rates_of(result: Result, path: str, rates: str) -> dict[int, int]:
    """Return which column of rates each column of a dataset has, by its name; vectors of points have theirs in turn."""
    names, of_rates = (column_names(result.variables[x]) for x in (path, rates))
    if path.partition("/")[0] not in (STATE, RATES[STATE]):
        return dict(zip(range(len(names)), range(len(of_rates))))
    return {k: of_rates.index(name) for k, name in enumerate(names) if name in of_rates}


def _seen(result: Result, path: str) -> Array:
    """Return the least range (n,) that is a motion: beside the largest value of the unit, and beside rounding."""
    variable = result.variables[path]
    units, top = units_of(variable), np.nanmax(np.abs(variable.data), axis=0, initial=0.0)
    largest = {one: max(float(x) for x, u in zip(top, units) if u == one) for one in units}
    return np.array([LEAST * max(LEAST, largest[one]) for one in units])


def _turned(result: Result, but: tuple[int, ...] = ()) -> Array:
    """Tell between which samples joints turn too far (T - 1, n); but : columns that do not count."""
    rates = result.variables["qd"]
    kept = [k for k, one in enumerate(units_of(rates)) if one == "rad/s" and k not in but]
    with np.errstate(all="ignore"):
        speed = np.abs(rates.data[:, kept])
        turns = 0.5 * np.diff(result.time)[:, None] * (speed[1:] + speed[:-1])
        return np.asarray(turns > TURN)


def _any(missed: Array) -> Array:
    """Return (T - 1, 1) of the intervals in which a line misses any column."""
    return np.asarray(missed.any(axis=1, keepdims=True))


def _happened(result: Result) -> Array:
    """Return the intervals in which something happens."""
    times = [float(event["time"]) for event in result.events if isinstance(event.get("time"), int | float)]
    at = {int(k) for side in ("left", "right") for k in np.searchsorted(result.time, times, side)}
    return np.array(sorted(k - 1 for k in at if 0 < k < len(result.time)), dtype=int)


def _together(missed: Array) -> Array:
    """Return the intervals (T - 1,) that are missed, and those beside them that are so few that a line would be a
    splinter."""
    least = max(FEWEST, len(missed) // MOST_LINES)
    turns = np.flatnonzero(np.diff(missed.astype(int))) + 1
    starts, ends = np.array([0, *turns]), np.array([*turns, len(missed)])
    joined = missed.copy()
    for a, b in zip(starts, ends):
        if not missed[a] and b - a < least and missed.any():
            joined[a:b] = True
    return joined

"""The largest values of functions that are known at samples, between the samples too, with their errors.

Near the largest samples the polynomial of degree 5 through the six nearest ones takes the place of the function. The
sixth differences D of the samples bound what that leaves out,

    |error| < max |D| / 10 of a value,        h (sum |D|) / 2^6 of an integral,

which covers smooth functions many times, and those that jump by J between two samples, where D = J, -5 J, 10 J, ...:
off by no more than J and h J / 2. With fewer than seven samples the differences are of the highest order there is.
Functions that jump at known places are taken in pieces, as in ``quadrature``. Samples need not be uniform (see
``quadrature``).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.polynomials import derivative, to_powers
from robodyn_cli.algorithms.polynomials import value as value_of
from robodyn_cli.record import record
from robodyn_cli.solve.quadrature import (
    BLOCK,
    OUTSIDE,
    POINTS,
    Breaks,
    Figure,
    Hidden,
    hidden_jumps,
    integrate,
    integrate_positive,
    pieces,
    roughness,
    sampling_error,
    steps_beside,
    summed,
)
from robodyn_cli.spatial.algebra import Array

TRIES = 3  # places of the largest samples that are looked at
SMOOTH = 1e-2  # of the second difference: a smaller bound says that a function is smooth
BETWEEN = np.linspace(0.0, 1.0, 17)[:, None]  # between neighbours, where a polynomial is evaluated first
ROUNDED = 1e-12  # part of a value by which rounding makes equal ones differ
NOISE = 4e-15  # part of a value, rounding that moves the place of a flat top
FLAT = 1e-13  # part of the values that a polynomial goes through, by which its rounding changes it
BESIDE = 2  # samples from a peak, of which those are its own
ALIKE = 1e-9  # part of a value by which peaks that count as equal differ: the first one is told


@record
class Extreme:
    """Largest values (n,) of columns, their errors, their times [s], the errors of these, their places in samples."""

    value: Array
    error: Array
    time: Array
    time_error: Array
    at: Array

    def or_larger(self, other: Extreme) -> Extreme:
        """Return the larger ones of two; of equal ones the first in time; errors cover which one is larger."""
        gap, equal = other.value - self.value, ALIKE * np.abs(self.value)
        alike = np.abs(gap) <= equal + self.error + other.error
        takes = (gap > equal) | (np.abs(gap) <= equal) & (other.time < self.time)
        first, second = (
            {
                f.name: np.where(takes == swap, getattr(other, f.name), getattr(self, f.name))
                for f in dataclasses.fields(self)
            }
            for swap in (True, False)
        )
        beyond = np.maximum(second["value"] + second["error"] - first["value"], 0.0)
        away = np.abs(second["time"] - first["time"]) + second["time_error"]
        first["error"] = np.maximum(first["error"], beyond)
        first["time_error"] = np.maximum(first["time_error"], np.where(alike & (gap != 0.0), away, 0.0))
        return Extreme(**first)


def largest(times: Array, y: Array, breaks: Breaks = ()) -> Extreme:
    """Return the largest values of y (T, n) at times (T,), which are best uniform; breaks : see ``quadrature``."""
    n = y.shape[1]
    if not n:
        return Extreme(*np.zeros((5, 0)))
    alike = list(_pieces_alike(times, n, breaks, hidden_jumps(times, y, breaks)))
    found = _joined([_of_pieces(times, y, *own) for own in alike])
    column, first = (np.concatenate([own[1][k] for own in alike]).astype(int) for k in (COLUMN, FIRST))
    found = _over_pieces(found, column, first, n)
    # samples that follow no smooth function say no more than their range, no polynomial says more than its rounding
    most = 2.0 * np.ptp(y, axis=0)
    error = np.minimum(np.maximum(found.error, FLAT * np.abs(y).max(axis=0)), most)
    return dataclasses.replace(found, error=error)


# what is known of pieces of columns: the column, the first sample of the piece, and the first and the last one of its
# stretch, the step between samples [s], how far functions reach beyond the ends, in steps, and whether they jump there
COLUMN, FIRST = 0, 1


def _pieces_alike(
    times: Array, n: int, breaks: Breaks, jumps: Sequence[tuple[Any, Hidden]]
) -> Iterator[tuple[int, Array]]:
    """Yield all pieces of n columns (9, P), those with as many samples each at once, as far as they fit a block;
    jumps : see ``hidden_jumps``."""
    alike: dict[int, list[Array]] = {}
    for own, hidden in jumps:
        columns, jumps_behind = np.arange(n)[own], np.zeros(len(times), dtype=bool)
        jumps_behind[list(hidden)] = True
        for part in pieces(times, [*breaks, *hidden], len(columns)):
            sides = [jumps_behind[k] for k in (part.first - 1, part.first + part.samples - 1)]
            reach = [np.where(side, 0.0, x) for side, x in zip(sides, (part.low, part.high))]
            rows = np.array([part.first, part.start, part.end, part.step, *reach, *sides])
            each = np.concatenate(
                [np.tile(columns, len(part.first))[None], np.repeat(rows, len(columns), axis=1)]
            )
            alike.setdefault(part.samples, []).append(each)
    for samples, parts in alike.items():
        places, most = np.concatenate(parts, axis=1), max(1, BLOCK // samples)
        for k in range(0, places.shape[1], most):
            yield samples, places[:, k : k + most]


def _of_pieces(times: Array, y: Array, samples: int, places: Array) -> Extreme:
    """Return the largest values of pieces with as many samples each; places (9, P) : see ``COLUMN``."""
    column, first, start, end = places[:4].astype(int)
    step, low, high, *sides = places[4:]
    block = y[first + np.arange(samples)[:, None], column]
    found = _largest_of_piece(block, low, high)
    if samples == 1:  # of a single sample between two jumps it is not known where it leads
        reach = np.minimum(1.0, low + high)
        near = y[np.clip(first + np.arange(-2, 3)[:, None], start, end), column]
        found = dataclasses.replace(found, error=reach * steps_beside(near), time_error=reach)
    found = _beyond(found, block, [side > 0.0 for side in sides])
    time = times[start] + step * (found.at + (first - start))
    return dataclasses.replace(found, at=found.at + first, time=time, time_error=step * found.time_error)


def _over_pieces(found: Extreme, column: NDArray[np.int_], first: NDArray[np.int_], n: int) -> Extreme:
    """Return the extremes of n columns from those of all their pieces (P,), which begin with samples ``first``: of
    equal ones the first in time; errors cover which one is larger."""
    order, count = np.lexsort((first, column)), np.bincount(column, minlength=n)
    # (pieces, n); the last of a column, over again, adds nothing to it
    each = order[np.cumsum(count) - count + np.minimum(np.arange(count.max())[:, None], count - 1)]
    fields = [getattr(found, f.name)[each] for f in dataclasses.fields(Extreme)]
    value, error, time, time_error, _ = fields
    top = value.max(axis=0)
    k = np.argmax(np.where(value >= top - ALIKE * np.abs(top), -time, -np.inf), axis=0)
    own = Extreme(*(x[k, np.arange(n)] for x in fields))
    beyond = (value + error).max(axis=0) - own.value
    least = (value - error).max(axis=0) - ALIKE * np.abs(own.value)  # that the largest value has
    rivals = (value + error >= least) & (value != own.value)
    away = np.where(rivals, np.abs(time - own.time) + time_error, 0.0).max(axis=0)
    return dataclasses.replace(
        own, error=np.maximum(own.error, beyond), time_error=np.maximum(own.time_error, away)
    )


def _beyond(found: Extreme, y: Array, sides: Sequence[Array]) -> Extreme:
    """Return the extremes of a piece with errors for how far its functions go on until a jump that nobody stated, in
    the columns that have one at either of its sides."""
    for here, end, last in zip(sides, (y[::-1], y), (0, len(y) - 1)):
        if here.any():
            steps = [np.diff(end[-4:], k, axis=0)[-1] for k in range(min(len(end), 4))]
            more = sum(steps[:3]) + abs(steps[3] if len(steps) > 3 else 0.0) - found.value
            away = np.where(more > 0.0, np.abs(found.at - last) + 1.0, 0.0)
            found = dataclasses.replace(
                found,
                error=np.where(here, np.maximum(found.error, more), found.error),
                time_error=np.where(here, np.maximum(found.time_error, away), found.time_error),
            )
    return found


def _joined(parts: Sequence[Extreme]) -> Extreme:
    """Return the extremes of several as those of one."""
    if len(parts) == 1:
        return parts[0]
    fields = {
        f.name: np.concatenate([getattr(x, f.name) for x in parts]) for f in dataclasses.fields(Extreme)
    }
    return Extreme(**fields)


def largest_magnitude(times: Array, y: Array, breaks: Breaks = ()) -> Extreme:
    """Return the largest magnitudes of y (T, n), see ``largest``."""
    most, least = largest_of_each(times, [y, -y], breaks)
    return most.or_larger(least)


def largest_of_each(times: Array, each: Sequence[Array], breaks: Breaks = ()) -> list[Extreme]:
    """Return the largest values of several y (T, n), looked for all at once, which takes a fraction of the time."""
    found = largest(times, np.concatenate(each, axis=1), breaks)
    ends = np.cumsum([0, *(y.shape[1] for y in each)]).tolist()
    names = [f.name for f in dataclasses.fields(Extreme)]
    return [
        Extreme(**{name: getattr(found, name)[a:b] for name in names}) for a, b in itertools.pairwise(ends)
    ]


def smallest(times: Array, y: Array, breaks: Breaks = ()) -> Extreme:
    """Return the smallest values of y (T, n), see ``largest``."""
    found = largest(times, -y, breaks)
    return dataclasses.replace(found, value=0.0 - found.value)  # no -0.0


def rivals(times: Array, y: Array, time: float, least: float) -> NDArray[np.int_]:
    """Return the samples of other peaks of y (T,) than that at a time, which may be as large as ``least``: what errors
    of values leave open of where the largest one is, see ``Extreme.time_error`` for those of samples."""
    beside = np.concatenate([[-np.inf], y, [-np.inf]])
    peak = (y >= beside[:-2]) & (y >= beside[2:])
    nothing = np.zeros(1)
    found = np.flatnonzero(peak & (_tops(y[:, None], nothing, nothing)[:, 0] >= least))
    near = np.searchsorted(times, time)
    return found[np.abs(found - near) > BESIDE]


def integral(times: Array, y: Array, breaks: Breaks = ()) -> tuple[Array, Array]:
    """Return the integrals (n,) of y (T, n) and their errors, see ``integrate``."""
    return _summed(integrate, times, y, breaks)


def positive_integral(times: Array, y: Array, breaks: Breaks = ()) -> tuple[Array, Array]:
    """Return the integrals (n,) of max(y, 0) of y (T, n) and their errors, see ``integrate_positive``."""
    return _summed(integrate_positive, times, y, breaks)


def root_mean_square(times: Array, y: Array, breaks: Breaks = ()) -> tuple[Array, Array]:
    """Return the roots (n,) of the time averages of y^2 of y (T, n), and their errors; of columns that are not finite
    everywhere from where they are."""
    known = np.isfinite(y)
    if not known.all():
        each = [root_mean_square(times[k], y[k, j : j + 1]) for j, k in enumerate(known.T) if k.any()]
        values = np.zeros((2, y.shape[1]))
        values[:, known.any(axis=0)] = np.transpose([(root[0], off[0]) for root, off in each])
        return values[0], values[1]
    duration = float(times[-1] - times[0])
    if not duration > 0.0:
        return np.abs(y[0]), np.zeros(y.shape[1])
    square, off = (x / duration for x in integral(times, y * y, breaks))
    square = np.maximum(square, 0.0)
    root = np.sqrt(square)
    return root, np.maximum(np.sqrt(square + off) - root, root - np.sqrt(np.maximum(square - off, 0.0)))


def _summed(figure: Figure, times: Array, y: Array, breaks: Breaks) -> tuple[Array, Array]:
    """Return the sum of a figure (n,) over the stretches of time in which samples are uniform, and its error."""
    values, errors = np.zeros_like(y[0]), np.zeros_like(y[0])
    for own, hidden in hidden_jumps(times, y, breaks):
        # where the jump is between its two samples is not known: in the middle
        places = [*breaks, *(k + 0.5 for k in hidden)]
        values[own] = summed(figure, times, y[:, own], places)
        errors[own] = summed(sampling_error, times, y[:, own], places)
        for k in hidden:
            gap = np.abs(y[k + 1, own] - y[k, own]) + np.abs(y[k, own] - y[k - 1, own])
            errors[own] += 0.5 * (times[k + 1] - times[k]) * gap
    return values, errors


def tops(times: Array, y: Array, breaks: Breaks = ()) -> tuple[Array, Array]:
    """Return the largest values (n,) of many columns y (T, n), and their times, without their errors; breaks : see
    ``quadrature``."""
    n = y.shape[1]
    value, time = np.full(n, -np.inf), np.zeros(n)
    for part in pieces(times, breaks, n):
        top, at = (x.reshape(len(part.first), n) for x in _uniform_tops(part.of(y), *part.reach(n)))
        k = np.argmax(top, axis=0)
        own, place = (x[k, np.arange(n)] for x in (top, at))
        better = own > value
        value = np.where(better, own, value)
        time = np.where(better, times[part.first[k]] + part.step[k] * place, time)
    return value, time


def _uniform_tops(y: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the largest values (n,) of many columns y (T, n), and their places in samples, without their errors."""
    columns, window = np.arange(y.shape[1]), min(len(y), 2 * POINTS + 1)
    j = np.argmax(_tops(y, low, high), axis=0)
    first = np.clip(j - POINTS, 0, len(y) - window)
    near = y[first + np.arange(window)[:, None], columns]
    rough = roughness(near)
    k = np.arange(len(rough))[:, None] + first
    error = np.where((k <= j) & (k >= j - POINTS), rough, 0.0).max(axis=0)
    error = np.where((j < 2) | (j > len(y) - 3), OUTSIDE * error, error)
    top, at, bend = _refined(y, (j, columns), low, high)
    trusted = (top - y[j, columns] > error) | (error < SMOOTH * bend)
    return np.where(trusted, top, y[j, columns]), np.where(trusted, at, j)


def _largest_of_piece(y: Array, low: Array, high: Array) -> Extreme:
    """Return the largest values of a piece, with times in samples; low, high (n,) : how far it goes beyond its ends."""
    near = _near(roughness(y), len(y))
    places = _highest(_tops(y, low, high))
    tries, n = places.shape
    j, columns = places.ravel(), np.tile(np.arange(n), tries)
    top, at, bend = _refined(y, (j, columns), np.tile(low, tries), np.tile(high, tries))
    error, there = near[j, columns], y[j, columns]
    # a polynomial is not believed where what it leaves out is more than it adds
    trusted = (top - there > error) | (error < SMOOTH * bend)
    # differences that are continued beyond the samples are not divided any more
    outside = trusted & ((at < 0.0) | (at > len(y) - 1.0))
    error = np.where(outside, OUTSIDE * error, np.maximum(error, top - there) * ~trusted + error * trusted)
    at = np.where(trusted, at, j)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(error > 0.0, np.minimum(1.0, 4.0 * (error + NOISE * np.abs(top)) / bend), 0.0)
    off = np.where(trusted | (error == 0.0), off, 1.0)
    fields = [x.reshape(tries, n) for x in (np.where(trusted, top, there), error, at, off, at)]
    return _anywhere(reduce(Extreme.or_larger, map(Extreme, *fields)), y, near)


def _highest(bound: Array) -> Array:
    """Return the places (TRIES, n) of the largest of bounds (T, n), none beside another; the bounds are used up."""
    columns = np.arange(bound.shape[1])
    places = []
    for _ in range(min(TRIES, len(bound))):
        places.append(np.argmax(bound, axis=0))
        for k in (-1, 0, 1):
            bound[np.clip(places[-1] + k, 0, len(bound) - 1), columns] = -np.inf
    return np.stack(places)


def _anywhere(found: Extreme, y: Array, near: Array) -> Extreme:
    """Return extremes with what is not known of other samples: how large, and where, the function may be there."""
    error = np.maximum(found.error, (y + near).max(axis=0) - found.value)
    rivals = y + near >= found.value - error
    places = np.arange(len(y), dtype=float)[:, None]
    away = np.where(rivals & (near > 0.0), np.abs(places - found.at) + 1.0, 0.0).max(axis=0)
    # of samples that differ by rounding it decides which one is the largest
    equal = y >= found.value - ROUNDED * np.abs(found.value)
    away = np.maximum(away, np.where(equal, np.abs(places - found.at), 0.0).max(axis=0))
    return dataclasses.replace(found, error=error, time_error=np.maximum(found.time_error, away))


def _near(rough: Array, samples: int) -> Array:
    """Return the largest of the differences in which a sample takes part (T, n)."""
    order = samples - len(rough)
    none = np.zeros((order, rough.shape[1]))
    padded = np.concatenate([none, rough, none]) if order else rough
    found: Array = reduce(np.maximum, [padded[k : k + samples] for k in range(order + 1)])
    # a jump beside the first or the last sample appears in one difference alone
    outside = np.ones((samples, 1))
    outside[:2] *= OUTSIDE
    outside[-2:] *= OUTSIDE
    return found * outside


def _tops(y: Array, low: Array, high: Array) -> Array:
    """Return the tops (T, n) of parabolas through samples that are larger than their neighbours; else the samples."""
    found = y.copy()
    if len(y) > 2:
        left, middle, right = y[:-2], y[1:-1], y[2:]
        bend = left - 2.0 * middle + right
        with np.errstate(divide="ignore", invalid="ignore"):
            top = middle - (right - left) ** 2 / (8.0 * bend)
        found[1:-1] = np.where((middle >= left) & (middle >= right) & (bend < 0.0), top, middle)
    if len(y) > 1:
        found[0] += np.maximum(0.0, low * (y[0] - y[1]))
        found[-1] += np.maximum(0.0, high * (y[-1] - y[-2]))
    return found


def _refined(y: Array, samples: tuple[Array, Array], low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Return the largest values (m,) between the neighbours of samples, their rows j and columns (m,), their places,
    and |y''| there."""
    j, columns = samples
    points, last = min(POINTS, len(y)), len(y) - 1
    ahead = y[np.minimum(j + 1, last), columns] > y[np.maximum(j - 1, 0), columns]
    first = np.clip(j - points // 2 + (points % 2 == 0) * ahead, 0, len(y) - points)
    near = y[first + np.arange(points)[:, None], columns]
    c = to_powers(points) @ near
    begin = np.where(j == 0, -low, np.maximum(j - 1, 0)) - first
    end = np.where(j == last, last + high, np.minimum(j + 1, last)) - first
    x = begin + (end - begin) * BETWEEN
    x = x[np.argmax(value_of(c, x), axis=0), np.arange(len(j))]
    slope, bend = derivative(c), derivative(derivative(c))
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(3):
            curved = value_of(bend, x)
            step = np.where(curved < 0.0, -value_of(slope, x) / curved, 0.0)
            x = np.clip(x + step, begin, end)
    top, there = value_of(c, x), y[j, columns]
    # what the polynomial adds by its own rounding is nothing
    flat = np.abs(top - there) <= FLAT * np.abs(near).max(axis=0)
    return np.where(flat, there, top), np.where(flat, j, x + first), np.abs(value_of(bend, x))

"""Integrals of sampled functions, and of their positive part.

Over each interval the polynomial of degree 5 through the six nearest samples is integrated exactly (error
h^7 y^(6) an interval); where the samples change sign, the positive part is taken of that polynomial, cut at
its root. With fewer than six samples the degree is that of all of them.

Functions that jump are integrated in pieces: to the jump and from it the polynomials of both sides are continued.
``breaks`` says where, in steps from the first sample; a sample at a break is that of before. Errors are explained in
``extremes``.

Samples that are not uniform come in uniform stretches: one ends where the next begins. Two samples that lie much closer
than those around them stand for both sides of a jump: a stretch ends at the first, the next begins at the second, and
each reaches half of the way to the other.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.polynomials import real_roots, to_powers, value
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

POINTS = 6
Breaks = Sequence[float]
Hidden = Sequence[int]
SPACED = 3  # samples between breaks, at least
ALONE = 6.0  # steps between switches that are cut at
AT = 1e-9  # samples from a break that a sample is at
BESIDE = 1e-15  # of its place: as near to that sample pieces end
ALIKE = 1e-9  # of the longest step, by which equal ones differ
GAP = 1e-3  # of the steps around it: a step no longer stands for a jump
OUTSIDE = 10.0  # times the bound of errors: beyond samples, and for a jump beside the first or the last one
FEW = 64  # jumps of a function that are looked for
HIDDEN = 1e-3  # of the range of a function, above which its differences may show a jump
APART = 0.2  # of the largest difference of a jump, below which those beside it do not take part in it
DIFFERED = 3e-13  # part of a value, of which rounding alone makes sixth differences
INTEGRAL = 10.0 / 64.0  # of an integral over that of values


BLOCK = 2**17  # numbers that are worked on at once


def of_any_arrays(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that arrays of other kinds than numpy's answer themselves, as they answer those of numpy
    (``__array_function__``): what is recorded (``over/live/rules.py``) cannot branch on values."""

    @wraps(function)
    def asked(*args: Any) -> Any:
        for x in args:
            if isinstance(x, np.lib.mixins.NDArrayOperatorsMixin):
                return x.__array_function__(asked, (type(x),), args, {})  # type: ignore[attr-defined]
        return function(*args)

    return asked


@record
class Pieces:
    """Pieces of as many uniform samples each, between which functions jump, or times are uniform otherwise.

    first : their first samples (P,). step : between their samples (P,) [s]. low, high : how far functions reach beyond
    the first and the last sample (P,), in steps. start, end : the first and the last sample (P,) of the stretches of
    uniform samples that they are of.
    """

    samples: int
    first: NDArray[np.int_]
    step: Array
    low: Array
    high: Array
    start: NDArray[np.int_]
    end: NDArray[np.int_]

    def of(self, y: Array) -> Array:
        """Return the samples of functions y (T, n) as columns (samples, P n)."""
        block: Array = y[self.first + np.arange(self.samples)[:, None]].reshape(self.samples, -1)
        return block

    def reach(self, n: int) -> tuple[Array, Array]:
        """Return how far n functions reach beyond their first and last samples (P n,), in steps."""
        return np.repeat(self.low, n), np.repeat(self.high, n)

    def beside(self, y: Array) -> Array:
        """Return the first samples of pieces with two on both sides (5, P n), as far as their stretches go."""
        block: Array = y[np.clip(self.first + np.arange(-2, 3)[:, None], self.start, self.end)]
        return block.reshape(5, -1)


Figure = Callable[[Array, Pieces], Array]


def pieces(times: Array, breaks: Breaks = (), columns: int = 1) -> Iterator[Pieces]:
    """Yield the pieces of samples at times (T,): those with as many samples each at once, but no more than fit a block
    of so many columns. Of breaks between the same two samples the first counts."""
    first, last, step, low, high = stretches(times)
    places = np.sort(np.asarray(breaks, dtype=float))
    own = np.searchsorted(first, places, side="right") - 1
    inside = (own >= 0) & (places < last[own])
    behind, chosen = np.unique(np.floor(places[inside]).astype(int), return_index=True)
    places, own = places[inside][chosen], own[inside][chosen]
    of = np.concatenate([np.arange(len(first)), own])
    begins, ends = np.concatenate([first, behind + 1]), np.concatenate([last, behind])
    order, until = np.lexsort((begins, of)), np.lexsort((ends, of))
    begins, ends, of = begins[order], ends[until], of[order]
    low = np.concatenate([low, behind + 1 - places])[order]
    high = np.concatenate([high, places - behind])[until]
    counts = ends - begins + 1
    for samples in np.unique(counts).tolist():
        alike, most = np.flatnonzero(counts == samples), max(1, BLOCK // (samples * max(columns, 1)))
        for k in range(0, len(alike), most):
            part = alike[k : k + most]
            one = of[part]
            yield Pieces(samples, begins[part], step[one], low[part], high[part], first[one], last[one])


def integrate(y: Array, part: Pieces) -> Array:
    """Return the integrals (P n,) of y (T, n) over pieces, in steps."""
    block = part.of(y)
    total = _increments(block).sum(axis=0)
    for near, reach in zip(_ends(block), part.reach(y.shape[1])):
        if reach.any():
            total = total + (_reaching(len(near), reach) * near).sum(axis=0)
    return total


def integrate_positive(y: Array, part: Pieces) -> Array:
    """Return the integrals (P n,) of max(y, 0) for y (T, n) over pieces, in steps."""
    block = part.of(y)
    total = _positive_part(block)
    for near, reach in zip(_ends(block), part.reach(y.shape[1])):
        if reach.any():
            total = total + positive_parts(near, -reach[None], np.zeros((1, 1)), reach[None] > 0.0)[0]
    return total


def _positive_part(y: Array) -> Array:
    """Return the integrals (n,) of max(y, 0) over all intervals between samples (T, n), in steps."""
    whole = np.where((y[:-1] > 0.0) & (y[1:] > 0.0), _increments(y), 0.0)
    mixed = (y[:-1] > 0.0) != (y[1:] > 0.0)
    first = np.arange(len(y) - 1.0)[:, None]
    return (whole + positive_parts(y, first, first + 1.0, mixed)).sum(axis=0)


def spaced(places: Iterable[float], samples: int, known: Breaks = ()) -> list[float]:
    """Return breaks, in steps from the first of some samples: known ones, and those places that lie a few samples from
    others. What functions do at the rest is part of the errors of figures.
    """
    found = list(known)
    taken = {math.floor(x) for x in found}  # intervals
    for x in places:
        inside = SPACED < x < samples - 1 - SPACED
        if inside and taken.isdisjoint(range(math.floor(x) - SPACED + 1, math.floor(x) + SPACED)):
            # a sample at a break may be that of either side, or of none: it stands alone
            new = [round(x) * (1.0 - BESIDE), round(x) * (1.0 + BESIDE)] if abs(x - round(x)) < AT else [x]
            found += new
            taken.update(math.floor(y) for y in new)
    return sorted(found)


def breaks_at(times: Array, events: Iterable[float], switches: Iterable[float] = ()) -> list[float]:
    """Return breaks from the times [s] of what makes functions jump, for samples at times (T,), see ``spaced``.

    switches : times at which they may bend too, as at knots; where such times lie close to each other, as the rows of a
    table that follows a smooth function, samples across them tell more than the few between two of them.
    """
    places = np.array([-np.inf, *sorted(set(places_of(switches, times))), np.inf])
    gaps = np.diff(places)
    alone = places[1:-1][np.minimum(gaps[:-1], gaps[1:]) >= ALONE]
    return spaced([*places_of(events, times), *alone.tolist()], len(times))


def places_of(instants: Iterable[float], times: Array) -> list[float]:
    """Return where instants [s] lie among samples at times (T,), in steps from the first; -1 beyond them."""
    steps = np.arange(float(len(times)))
    places: list[float] = np.interp(list(instants), times, steps, left=-1.0, right=-1.0).tolist()
    return places


def sampling_error(y: Array, part: Pieces) -> Array:
    """Return how far integrals (P n,) over pieces of y (T, n), or of its positive part, may be off, in steps."""
    low, high = part.reach(y.shape[1])
    rough = roughness(part.of(y))
    # a jump in the first or the last interval appears in one difference alone
    found: Array = rough.sum(axis=0) * INTEGRAL + (rough[0] + rough[-1]) * OUTSIDE * (1.0 + low + high)
    if part.samples == 1:
        near = part.beside(y)
        # of a sample at a break it is not known of which side it is
        sides = np.where(low + high < 3.0 * AT, low + high, 0.0)
        found = found + 0.5 * (low**2 + high**2) * steps_beside(near)
        found = found + sides * (np.abs(near[2] - near[1]) + np.abs(near[3] - near[2]))
    return found


def steps_beside(near: Array) -> Array:
    """Return twice the larger change (m,) from sample to sample on both sides of the middle one of five (5, m): where
    a function goes from there until its jump is taken to be of this size."""
    found: Array = 2.0 * np.maximum(np.abs(near[1] - near[0]), np.abs(near[4] - near[3]))
    return found


def roughness(y: Array) -> Array:
    """Return |D| (T - order, n), over its largest part in a jump; a row of zeros for one sample."""
    order = min(POINTS, len(y) - 1)
    if not order:
        return np.zeros_like(y)
    found: Array = np.abs(np.diff(y, order, axis=0)) / math.comb(order - 1, (order - 1) // 2)
    return found


def gaps_between(times: Array) -> NDArray[np.int_]:
    """Return the samples behind which a step stands for a jump."""
    steps = np.diff(times)
    return 1 + np.flatnonzero(steps[1:-1] < GAP * np.minimum(steps[:-2], steps[2:]))


def stretches(times: Array) -> tuple[NDArray[np.int_], NDArray[np.int_], Array, Array, Array]:
    """Return the stretches of uniform samples (S,), of which one ends where the next begins, or at a jump before it:
    their first and last samples, the step between these [s], and how far functions reach beyond them, in steps."""
    steps = np.diff(times)
    if not len(steps):
        return (np.zeros(1, dtype=int), np.zeros(1, dtype=int), *np.zeros((3, 1)))
    gaps = gaps_between(times)
    cuts = np.flatnonzero(np.abs(np.diff(steps)) > ALIKE * float(np.abs(steps).max())) + 1
    ends, jumps = np.zeros((2, len(times)), dtype=bool)
    jumps[gaps] = True
    for places in (0, cuts, gaps, gaps + 1, len(steps)):
        ends[places] = True
    bounds = np.flatnonzero(ends)
    first, last = bounds[:-1][~jumps[bounds[:-1]]], bounds[1:][~jumps[bounds[1:] - 1]]
    step = (times[last] - times[first]) / (last - first)
    beyond = np.zeros(len(times) + 1)  # half of each gap, at the samples on both sides of it
    beyond[gaps] = beyond[gaps + 1] = 0.5 * steps[gaps]
    return first, last, step, beyond[first] / step, beyond[last] / step


def summed(figure: Figure, times: Array, y: Array, breaks: Breaks = ()) -> Array:
    """Return the sum of a figure (n,) of y (T, n), such as ``integrate``, over its pieces."""
    total = np.zeros(y.shape[1])
    for part in pieces(times, breaks, y.shape[1]):
        own = figure(y, part).reshape(len(part.step), -1)
        total = total + (part.step[:, None] * own).sum(axis=0)
    return total


def running(times: Array, y: Array, breaks: Breaks = ()) -> tuple[Array, float]:
    """Return the integral of y (T,) from the first sample to each (T,), and how far differences of it may be off."""
    steps, column = np.diff(times), y[:, None]
    parts, jumps, error = 0.5 * steps * (y[1:] + y[:-1]), np.ones(len(steps), dtype=bool), 0.0
    for part in pieces(times, breaks):
        inside = part.first + np.arange(part.samples - 1)[:, None]
        parts[inside], jumps[inside] = part.step * _increments(part.of(column)), False
        within = dataclasses.replace(part, low=0.0 * part.low, high=0.0 * part.high)
        error += float((part.step * sampling_error(column, within)).sum())
    error += float((steps * np.abs(np.diff(y)))[jumps].sum())
    return np.concatenate([[0.0], np.cumsum(parts)]), error


@of_any_arrays
def hidden_jumps(times: Array, y: Array, breaks: Breaks) -> Sequence[tuple[Any, Hidden]]:
    """Return columns of y (T, n) with the samples behind which they jump or bend where nobody stated it: those with the
    same ones together."""
    if len(y) < 2 * POINTS:
        return [(slice(None), ())]
    rough, doubtful = doubts(times, y, breaks)
    places = np.flatnonzero(doubtful)
    jumps = dict(zip(places.tolist(), _jumps(rough[:, places], np.ptp(y[:, places], axis=0))))
    alike: dict[Hidden, list[int]] = {}
    for k in range(y.shape[1]):
        alike.setdefault(tuple(jumps.get(k, ())), []).append(k)
    if len(alike) == 1:
        return [(slice(None), next(iter(alike)))]
    return [(np.array(own), hidden) for hidden, own in alike.items()]


def doubts(times: Array, y: Array, breaks: Breaks) -> tuple[Array, Array]:
    """Return the sixth differences of y (T, n) away from breaks, and which columns they may show a jump of (n,)."""
    away = np.ones((len(y) - POINTS, 1), dtype=bool)
    jumps = np.floor([*breaks, *gaps_between(times)]).astype(int)
    jumps = jumps[(jumps >= 0) & (jumps < len(y) - 1), None]
    away[np.clip(jumps - np.arange(POINTS), 0, len(away) - 1)] = False
    rough = np.where(away, np.abs(np.diff(y, POINTS, axis=0)), 0.0)
    least = np.maximum(HIDDEN * np.ptp(y, axis=0), DIFFERED * np.abs(y).max(axis=0))
    return rough, rough.max(axis=0) > least


def _jumps(rough: Array, size: Array) -> list[list[int]]:
    """Return the samples behind which functions jump or bend, from the magnitudes of their sixth differences (R, n).

    A jump behind sample k shows in the six differences from k - 5 to k, most in the middle two, and in no other. The
    largest differences count first; those that lie apart do not change each other.
    """
    least = np.maximum(HIDDEN * size, APART * rough.max(axis=0, initial=0.0))
    none = np.zeros((2 * POINTS, len(size)))
    rough = np.concatenate([none, rough, none])
    ways = np.arange(1, POINTS + 3)[:, None]
    rows, columns = np.nonzero(rough > least)
    found: list[list[tuple[float, int]]] = [[] for _ in size]
    while len(rows):
        own = rough[rows, columns]
        first = (own > rough[rows - ways, columns]) & (own >= rough[rows + ways, columns])
        i, column, largest = rows[first.all(axis=0)], columns[first.all(axis=0)], own[first.all(axis=0)]
        k = i + POINTS // 2 - (rough[i - 1, column] > rough[i + 1, column])
        around = np.maximum(rough[k - POINTS, column], rough[k + 1, column])
        for j in np.flatnonzero(around < APART * largest).tolist():
            found[column[j]].append((-float(largest[j]), int(k[j]) - 2 * POINTS))
        rough[k - np.arange(POINTS)[:, None], column] = 0.0
        left = rough[rows, columns] > least[columns]
        rows, columns = rows[left], columns[left]
    return [sorted(k for _, k in sorted(own)[:FEW]) for own in found]


def _ends(y: Array) -> tuple[Array, Array]:
    """Return the samples nearest to the first and to the last of some (T, n), counted from there."""
    return y[:POINTS], y[::-1][:POINTS]


def _stencil(samples: int, k: int) -> tuple[int, int]:
    """Return the first sample of the polynomial over interval k, and the interval's place in it."""
    points = min(POINTS, samples)
    first = min(max(k - points // 2 + 1, 0), samples - points)
    return first, k - first


@lru_cache(maxsize=64)
def _weights(points: int, place: int) -> Array:
    """Return the weights (points,) of the integral from ``place`` to the next of the interpolant at 0, 1, ..."""
    powers = np.arange(points)
    nodes = np.arange(points, dtype=float)[None, :] - place
    return np.asarray(np.linalg.solve(nodes ** powers[:, None], 1.0 / (powers + 1.0)))


def _reaching(points: int, reach: Array) -> Array:
    """Return the weights (points, m) of integrals from ``-reach`` (m,) to 0 of the interpolant at 0, 1, ..."""
    powers = np.arange(1.0, points + 1.0)[:, None]
    found: Array = to_powers(points).T @ (-((-reach) ** powers) / powers)
    return found


def _increments(y: Array) -> Array:
    """Return the integrals (T - 1, n) over each interval, in steps."""
    samples = len(y)
    if samples == 1:
        return y[:0]
    points = min(POINTS, samples)
    middle = points // 2 - 1
    inner = samples - points + 1  # intervals whose stencil is centred
    w = _weights(points, middle)
    own = sum(w[j] * y[j : j + inner] for j in range(1, points)) + w[0] * y[:inner]
    ends = [
        [_of_interval(y, k)[None] for k in places]
        for places in (range(middle), range(middle + inner, samples - 1))
    ]
    out: Array = np.concatenate([*ends[0], own, *ends[1]])
    return out


def _of_interval(y: Array, k: int) -> Array:
    """Return the integrals (n,) over interval k, in steps."""
    points = min(POINTS, len(y))
    first, place = _stencil(len(y), k)
    found: Array = _weights(points, place) @ y[first : first + points]
    return found


@of_any_arrays
def positive_parts(y: Array, first: Array, last: Array, chosen: NDArray[np.bool_]) -> Array:
    """Return the integrals (R, n) of max(y, 0) from places ``first`` to ``last`` (R, n) or (R, 1), in steps, of the
    polynomials through the nearest samples of y (T, n), cut at their roots; zero where they are not chosen (R, n)."""
    found = np.zeros(chosen.shape)
    rows, columns = np.nonzero(chosen)
    begin, end = (np.broadcast_to(x, chosen.shape)[rows, columns] for x in (first, last))
    points, length = min(POINTS, len(y)), end - begin
    front = np.clip(np.floor(begin).astype(int) - points // 2 + 1, 0, len(y) - points)
    nodes = np.arange(points) + (front - begin)[:, None]
    near = y[front[:, None] + np.arange(points), columns[:, None]]
    c = np.linalg.solve(nodes[:, :, None] ** np.arange(points), near[:, :, None])[:, :, 0].T
    cuts = np.sort(np.vstack([0.0 * length, real_roots(c, length), length]), axis=0)
    primitive = np.vstack([0.0 * length, c / np.arange(1.0, points + 1.0)[:, None]])
    parts = np.diff(value(primitive[:, None], cuts), axis=0)
    middles = 0.5 * (cuts[1:] + cuts[:-1])
    found[rows, columns] = np.where(value(c[:, None], middles) > 0.0, parts, 0.0).sum(axis=0)
    return found

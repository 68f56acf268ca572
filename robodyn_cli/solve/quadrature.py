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

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

POINTS = 6
Breaks = Sequence[float]
Hidden = Sequence[int]
Figure = Callable[[Array, float, Breaks], Array]
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


def integrate(y: Array, h: float, breaks: Breaks = ()) -> Array:
    """Return the integrals (n,) of y (T, n), samples a time h apart."""
    integrals = np.zeros(y.shape[1])
    for piece, low, high in pieces(len(y), breaks):
        own = y[piece]
        if len(own) > 1:
            integrals += _increments(own, h).sum(axis=0)
        for (first, last), near in _ends(len(own), low, high):
            integrals += h * (_weights(len(own[near]), first, last) @ own[near])
    return integrals


def integrate_positive(y: Array, h: float, breaks: Breaks = ()) -> Array:
    """Return the integrals (n,) of max(y, 0) for y (T, n), samples a time h apart."""
    integrals = np.zeros(y.shape[1])
    for piece, low, high in pieces(len(y), breaks):
        own = y[piece]
        if len(own) > 1:
            integrals += _positive_part(own, h)
        for (first, last), near in _ends(len(own), low, high):
            near_it = own[near]
            every = np.ones((1, y.shape[1]), dtype=bool)
            integrals += h * positive_parts(near_it, np.array([first]), np.array([last]), every)[0]
    return integrals


def _positive_part(y: Array, h: float) -> Array:
    """Return the integrals (n,) of max(y, 0) over all intervals between samples (T, n)."""
    whole = np.where((y[:-1] > 0.0) & (y[1:] > 0.0), _increments(y, h), 0.0)
    mixed = (y[:-1] > 0.0) != (y[1:] > 0.0)
    first = np.arange(len(y) - 1.0)
    return (whole + h * positive_parts(y, first, first + 1.0, mixed)).sum(axis=0)


def pieces(samples: int, breaks: Breaks) -> Iterator[tuple[slice, float, float]]:
    """Yield the samples between breaks, and how far their functions reach beyond the first and the last of them, in
    steps. Of breaks between the same two samples the first counts."""
    inside = sorted(
        {math.floor(x): x for x in sorted(breaks, reverse=True) if 0.0 <= x < samples - 1}.values()
    )
    cuts = [0, *(math.floor(x) + 1 for x in inside), samples]
    for k, (first, end) in enumerate(itertools.pairwise(cuts)):
        low = first - inside[k - 1] if k else 0.0
        high = inside[k] - (end - 1) if k < len(inside) else 0.0
        yield slice(first, end), low, high


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


def sampling_error(y: Array, h: float, breaks: Breaks = ()) -> Array:
    """Return how far integrals (n,) of y (T, n), or of its positive part, may be off; samples a time h apart."""
    found = np.zeros(y.shape[1])
    for piece, low, high in pieces(len(y), breaks):
        rough = roughness(y[piece])
        if piece.stop - piece.start == 1:
            found += 0.5 * h * (low**2 + high**2) * steps_beside(y, piece)
            if low + high < 3.0 * AT:  # of a sample at a break it is not known of which side it is
                sides = np.abs(np.diff(y[max(piece.start - 1, 0) : piece.stop + 1], axis=0))
                found += h * (low + high) * sides.sum(axis=0)
        found += h * rough.sum(axis=0) * INTEGRAL
        # a jump in the first or the last interval appears in one difference alone
        found += h * (rough[0] + rough[-1]) * OUTSIDE * (1.0 + low + high)
    return found


def steps_beside(y: Array, piece: slice) -> Array:
    """Return twice the larger change (n,) from sample to sample on both sides of a piece of one sample: where a
    function goes from there until its jump is taken to be of this size."""
    found = np.zeros(y.shape[1])
    for first in (piece.start - 2, piece.stop):
        if 0 <= first < len(y) - 1:
            found = np.maximum(found, 2.0 * np.abs(y[first + 1] - y[first]))
    return found


def roughness(y: Array) -> Array:
    """Return |D| (T - order, n), over its largest part in a jump; a row of zeros for one sample."""
    order = min(POINTS, len(y) - 1)
    if not order:
        return np.zeros_like(y)
    found: Array = np.abs(np.diff(y, order, axis=0)) / math.comb(order - 1, (order - 1) // 2)
    return found


@record
class Stretches:
    """Stretches of as many uniform samples each.

    first : their first samples (P,). step : between their samples (P,) [s]. low, high : how far functions reach beyond
    the first and the last sample (P,), in steps. breaks : inside a single stretch, in steps from its first sample.
    """

    first: NDArray[np.int_]
    samples: int
    step: Array
    low: Array
    high: Array
    breaks: Breaks = ()

    def of(self, y: Array) -> Array:
        """Return the samples of functions y (T, n) as columns (samples, P n)."""
        block: Array = y[self.first + np.arange(self.samples)[:, None]].reshape(self.samples, -1)
        return block

    def reach(self, piece: slice, low: float, high: float) -> tuple[Array, Array]:
        """Return how far functions reach beyond a piece of each stretch (P,), in steps."""
        before = self.low if piece.start == 0 else np.full_like(self.low, low)
        return before, self.high if piece.stop == self.samples else np.full_like(self.high, high)


def gaps_between(times: Array) -> NDArray[np.int_]:
    """Return the samples behind which a step stands for a jump."""
    steps = np.diff(times)
    return 1 + np.flatnonzero(steps[1:-1] < GAP * np.minimum(steps[:-2], steps[2:]))


def stretches(times: Array, breaks: Breaks = ()) -> list[Stretches]:
    """Return the stretches of uniform samples, of which one ends where the next begins, or at a jump before it: those
    with breaks one by one, others with all that have as many samples."""
    steps = np.diff(times)
    if not len(steps):
        return [Stretches(np.zeros(1, dtype=int), 1, *np.zeros((3, 1)))]
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
    low, high = beyond[first] / step, beyond[last] / step
    inside: dict[int, list[float]] = {}
    for x in breaks:
        k = int(np.searchsorted(first, x, side="right")) - 1
        if k >= 0 and x < last[k]:
            inside.setdefault(k, []).append(x - int(first[k]))
    alike: dict[Any, list[int]] = {}
    for k, count in enumerate((last - first + 1).tolist()):
        alike.setdefault((count, k if k in inside else None), []).append(k)
    return [
        Stretches(first[own], count, step[own], low[own], high[own], inside.get(own[0], ()))
        for (count, _), own in alike.items()
    ]


def summed(figure: Figure, times: Array, y: Array, breaks: Breaks = ()) -> Array:
    """Return the sum of a figure (n,) of y (T, n), such as ``integrate``, over the stretches of uniform samples."""
    total = np.zeros(y.shape[1])
    for part in stretches(times, breaks):
        block = part.of(y)
        own = figure(block, 1.0, part.breaks)
        for end, reach in ((block[:2], part.low), (block[:-3:-1], part.high)):
            if reach.any():
                far = np.repeat(reach, y.shape[1])
                middle = end[0] + 0.5 * far * (end[0] - end[1])
                own = own + far * figure(np.stack([middle, middle]), 1.0, ())
        total += (part.step[:, None] * own.reshape(len(part.step), -1)).sum(axis=0)
    return total


def running(times: Array, y: Array, breaks: Breaks = ()) -> tuple[Array, float]:
    """Return the integral of y (T,) from the first sample to each (T,), and how far differences of it may be off."""
    steps = np.diff(times)
    jumps = {int(k) for k in gaps_between(times)} | {math.floor(x) for x in breaks if 0.0 <= x < len(steps)}
    parts, error = 0.5 * steps * (y[1:] + y[:-1]), 0.0
    for k in jumps:
        error += float(steps[k] * abs(y[k + 1] - y[k]))
    uneven = np.abs(np.diff(steps)) > ALIKE * float(steps.max())
    ends = sorted({0, len(steps), *jumps, *(k + 1 for k in jumps), *(np.flatnonzero(uneven) + 1).tolist()})
    for first, last in itertools.pairwise(ends):
        if first not in jumps:
            own, h = y[first : last + 1, None], float(times[last] - times[first]) / (last - first)
            parts[first:last] = _increments(own, h)[:, 0]
            error += float(sampling_error(own, h)[0])
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
    for x in [*breaks, *gaps_between(times)]:
        away[max(math.floor(x) - POINTS + 1, 0) : math.floor(x) + 1] = False
    rough = np.where(away, np.abs(np.diff(y, POINTS, axis=0)), 0.0)
    least = np.maximum(HIDDEN * np.ptp(y, axis=0), DIFFERED * np.abs(y).max(axis=0))
    return rough, rough.max(axis=0) > least


def _jumps(rough: Array, size: Array) -> list[list[int]]:
    """Return the samples behind which functions jump or bend, from the magnitudes of their sixth differences (R, n).

    A jump behind sample k shows in the six differences from k - 5 to k, most in the middle two, and in no other.
    """
    found: list[list[int]] = [[] for _ in size]
    least = np.maximum(HIDDEN * size, APART * rough.max(axis=0, initial=0.0))
    none = np.zeros((POINTS, len(size)))
    rough = np.concatenate([none, rough, none])
    columns = np.arange(len(size))
    while len(columns := columns[rough[:, columns].max(axis=0) > least[columns]]):
        i = rough[:, columns].argmax(axis=0)
        k = i + POINTS // 2 - (rough[i - 1, columns] > rough[i + 1, columns])
        around = np.maximum(rough[k - POINTS, columns], rough[k + 1, columns])
        for j in np.flatnonzero(around < APART * rough[i, columns]).tolist():
            found[columns[j]].append(int(k[j]) - POINTS)
        rough[k - np.arange(POINTS)[:, None], columns] = 0.0
        columns = columns[[len(found[j]) < FEW for j in columns]]
    return [sorted(own) for own in found]


def _ends(samples: int, low: float, high: float) -> Iterator[tuple[tuple[float, float], slice]]:
    """Yield the stretches before the first and behind the last of some samples, each from and to places that count
    from the first of the samples that are nearest to it, and these samples."""
    points = min(POINTS, samples)
    if low > 0.0:
        yield (-low, 0.0), slice(0, points)
    if high > 0.0:
        yield (points - 1.0, points - 1.0 + high), slice(samples - points, samples)


def _stencil(samples: int, k: int) -> tuple[int, int]:
    """Return the first sample of the polynomial over interval k, and the interval's place in it."""
    points = min(POINTS, samples)
    first = min(max(k - points // 2 + 1, 0), samples - points)
    return first, k - first


@lru_cache(maxsize=64)
def _weights(points: int, first: float, last: float) -> Array:
    """Return the weights (points,) of the integral from ``first`` to ``last`` of the interpolant at 0, 1, ..."""
    powers = np.arange(points)
    nodes = np.arange(points, dtype=float)[None, :] - first
    moments = (last - first) ** (powers + 1.0) / (powers + 1.0)
    return np.asarray(np.linalg.solve(nodes ** powers[:, None], moments))


def _increments(y: Array, h: float) -> Array:
    """Return the integrals (T - 1, n) over each interval."""
    samples = len(y)
    points = min(POINTS, samples)
    middle = points // 2 - 1
    inner = samples - points + 1  # intervals whose stencil is centred
    w = _weights(points, middle, middle + 1)
    own = sum(w[j] * y[j : j + inner] for j in range(1, points)) + w[0] * y[:inner]
    ends = [
        [_of_interval(y, k)[None] for k in places]
        for places in (range(middle), range(middle + inner, samples - 1))
    ]
    out: Array = np.concatenate([*ends[0], own, *ends[1]])
    return h * out


def _of_interval(y: Array, k: int) -> Array:
    """Return the integrals (n,) over interval k, in steps."""
    points = min(POINTS, len(y))
    first, place = _stencil(len(y), k)
    found: Array = _weights(points, place, place + 1) @ y[first : first + points]
    return found


@of_any_arrays
def positive_parts(y: Array, first: Array, last: Array, chosen: NDArray[np.bool_]) -> Array:
    """Return the integrals (R, n) of max(y, 0) from places ``first`` to ``last`` (R,), in steps, of the polynomials
    through the nearest samples of y (T, n); zero where they are not chosen (R, n)."""
    found = np.zeros((len(first), y.shape[1]))
    for row, column in np.argwhere(chosen):
        begin, _ = _stencil(len(y), math.floor(first[row]))
        near = y[begin : begin + POINTS, column]
        found[row, column] = _positive_piece(near, first[row] - begin, last[row] - begin)
    return found


def _positive_piece(y: Array, first: float, last: float) -> float:
    """Return the integral from ``first`` to ``last`` of the interpolant of y at 0, 1, ... where positive."""
    x = np.arange(len(y), dtype=float) - first
    p = np.linalg.solve(np.vander(x), y)
    roots = np.roots(p).astype(complex)
    inside = [float(r.real) for r in roots if abs(r.imag) < 1e-9 and 0.0 < r.real < last - first]
    cuts = [0.0, *sorted(inside), last - first]
    primitive = np.polyint(p)
    total = 0.0
    for a, b in itertools.pairwise(cuts):
        if np.polyval(p, 0.5 * (a + b)) > 0.0:
            total += float(np.polyval(primitive, b) - np.polyval(primitive, a))
    return total

"""Samples of integrated motions between the samples that scenes ask for, and the smooth pieces that they make."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.algorithms.polynomials import derivative, to_powers, value
from robodyn_cli.drives.directions import AT_REST
from robodyn_cli.drives.report import Moved
from robodyn_cli.formulations.events import Jumped
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.integrators.stepping.stepper import SLACK
from robodyn_cli.motion.second_run import FirstRun
from robodyn_cli.observe.columns import Block, ChosenColumn, values_of
from robodyn_cli.observe.observe import Observer
from robodyn_cli.record import record
from robodyn_cli.solve.peaks import ROUNDED, Cut, Piece, pieces
from robodyn_cli.solve.quadrature import GAP, POINTS, stretches
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.extremes import Extremes
from robodyn_cli.torques.checks import settled, turns_of

NEAR = 6  # samples that a piece goes on by to its ends
BESIDE = 0.2 * GAP  # of the time between samples: so far from a turn are those on both of its sides
MOVES = 8.0  # times the rate of rest: rates on both sides of a turn
SURE = 0.1 * BESIDE  # of the time between samples, by which two ways of telling a turn agree
KNOWN = 1e-12  # of the time: sides of a turn are known as such if they are this far apart


@record
class TurningTimes:
    """When joints turn back (n,) [s], in order; side : how far from there they move so fast that it is known which way
    (n,) [s]."""

    times: Array
    side: Array


@record
class Steps:
    """The steps of an integration: ends of some of them [s], those times at which what is integrated may jump or begins
    or ends (fixed), and how many steps there are."""

    ended: Array
    fixed: Array
    count: int

    @property
    def knots(self) -> Array:
        """All these times (P + 1,) [s]."""
        return np.unique(np.concatenate([self.ended, self.fixed]))

    def beside(self, turns: TurningTimes, inside: int) -> tuple[Array, Array]:
        """Return knots with times (2, n) on both sides of turns for so many samples from knot to knot, and these.

        Steps that end so near to a turn that it is not known on which side are joined there.
        """
        least = np.maximum(turns.side, KNOWN * float(np.abs(self.fixed).max())) * inside / BESIDE
        apart = np.diff(turns.times, prepend=-np.inf)
        sure = (_distance(turns.times, self.fixed) > least) & (apart > least)
        times, least = turns.times[sure], np.concatenate([[0.0], least[sure], [0.0]])
        known = np.concatenate([[-np.inf], times, [np.inf]])
        k = np.searchsorted(known, self.ended)
        away = (self.ended - known[k - 1] > least[k - 1]) & (known[k] - self.ended > least[k])
        others = np.concatenate([self.ended[away], self.fixed])
        apart = np.diff(known)
        near = np.minimum(_distance(times, others), np.minimum(apart[1:], apart[:-1]))
        sides = times + np.multiply.outer([-1.0, 1.0], BESIDE / inside * near)
        return np.unique(np.concatenate([others, sides.ravel()])), sides


def _distance(times: Array, others: Array) -> Array:
    """Return how far times (n,) are from the nearest of others, infinity where there are none."""
    known = np.concatenate([[-np.inf], np.sort(others), [np.inf]])
    k = np.searchsorted(known, times)
    found: Array = np.minimum(times - known[k - 1], known[k] - times)
    return found


@record
class CloseSamples:
    """Samples between the steps of an integration, and both sides of its events.

    blocks : times, states and parameters. met : what changed at events. cuts : times [s] at which functions of time may
    jump, of which no side is known. ends : of the motion [s]; stopped : by an event.
    sparse : whether these are too many to be looked into: nothing tells what is between the samples. of : what was
    integrated.
    """

    observer: Observer
    blocks: Sequence[Block]
    met: Sequence[Jumped]
    cuts: Sequence[float]
    ends: tuple[float, float]
    stopped: bool
    sparse: bool
    of: tuple[FirstRun, Options, Steps]

    def at_samples(self, columns: Sequence[ChosenColumn]) -> dict[str, Extremes]:
        """Return the extremes of columns at the samples by name, with errors that are not known."""
        parts, final = self.pieces(columns)
        t, y = (np.concatenate([part[k] for part in parts]) for k in (0, 1))

        def at(row: int, k: int) -> tuple[float, float, float, float]:
            return float(y[row, k]), 0.0, float(t[row]), 0.0

        low, high = y.argmin(axis=0), y.argmax(axis=0)
        return {
            column.name: unsure(column.extremes(at(low[k], k), at(high[k], k), float(final[k])))
            for k, column in enumerate(columns)
        }

    def pieces(self, columns: Sequence[ChosenColumn]) -> tuple[list[Piece], Array]:
        """Return the smooth pieces of columns, and their values at the end (n,)."""
        values = values_of(self.observer, columns, self.blocks)
        times = np.concatenate([t for t, _, _ in self.blocks])
        final = values[-1]
        known: list[Cut] = []
        if self.met:
            before = [(np.array([x.time]), x.before[None], x.parameters_before) for x in self.met]
            behind = [(np.array([x.time]), x.behind[None], x.parameters_behind) for x in self.met]
            sides = [values_of(self.observer, columns, side) for side in (before, behind)]
            apart = np.array([*self.hidden, np.inf])
            known = [
                (one.time, *pair)
                for one, *pair in zip(self.met, *sides)
                if np.abs(apart - one.time).min() > ROUNDED * max(map(abs, self.ends))
            ]
        if self.stopped:  # of a sample there it is not known of which side it is
            final = sides[1][-1]
            inside = times < self.ends[1] - SLACK * max(map(abs, self.ends))
            times, values = times[inside], values[inside]
        cuts = sorted([*known, *((time, None, None) for time in self.hidden)], key=lambda cut: cut[0])
        return list(pieces(times, values, cuts, self.ends)), final

    @cached_property
    def hidden(self) -> list[float]:
        """Times [s] of jumps of which no side is known: what depends on time, or on a state that does not jump."""
        return [*self.cuts, *(one.time for one in self.met if one.hidden)]

    def moved(self, widths: Mapping[str, int]) -> Moved:
        """Return the motion of the joints, whose datasets have so many columns; both sides of jumps are samples, but of
        a sparse motion, whose samples do not tell what is beside them."""
        columns = [ChosenColumn(path, path, (k,), "") for path, width in widths.items() for k in range(width)]
        parts, _ = self.pieces(columns)
        parts = [part for part in parts if part[3] > part[2]] or parts  # nothing moves from event to event
        both = [part[:2] if self.sparse else to_its_ends(*part) for part in parts if len(part[0])]
        t, y = (np.concatenate([part[k] for part in both]) for k in (0, 1))
        own = dict(zip(widths, np.split(y, np.cumsum(list(widths.values()))[:-1], axis=1)))
        moved = Moved.of({"time": t, **own}.__getitem__, ())
        return moved.at_samples() if self.sparse else moved

    def turns(self, widths: Mapping[str, int], columns: Iterable[int]) -> TurningTimes:
        """Return when joints turn back, by places among the velocities; widths : see ``moved``."""
        moved = self.moved(widths)
        rates = settled(moved.qd)
        found = [sure_turns(moved.times, rates[:, k], moved.qdd[:, k]) for k in columns]
        times, side = (np.concatenate([getattr(one, name) for one in found]) for name in ("times", "side"))
        order = np.argsort(times)
        return TurningTimes(times[order], side[order])


def sure_turns(times: Array, v: Array, a: Array) -> TurningTimes:
    """Return when rates v (T,) with slopes a (T,) change their sign, where the rates alone say so too: not where slopes
    jump within a step."""
    places = np.array(turns_of(times, v, a))
    first, last, step, *_ = stretches(times)
    n = np.minimum(np.floor(places).astype(int), len(times) - 2)
    own = np.searchsorted(first, n, side="right") - 1
    known = (n < last[own]) & (
        last[own] - first[own] >= POINTS - 1
    )  # the others are between both sides of a jump
    places, n, own = places[known], n[known], own[known]
    front = np.clip(n - POINTS // 2 + 1, first[own], last[own] - POINTS + 1)
    c = to_powers(POINTS) @ v[front + np.arange(POINTS)[:, None]]
    x = places - front
    with np.errstate(divide="ignore", invalid="ignore"):
        agrees = np.abs(value(c, x) / value(derivative(c), x)) < SURE
        side = MOVES * AT_REST * np.abs(v).max(initial=0.0) / np.abs(a[n])
    return TurningTimes(times[front[agrees]] + step[own[agrees]] * x[agrees], side[agrees])


def to_its_ends(t: Array, y: Array, begin: float, end: float) -> tuple[Array, Array]:
    """Return a smooth piece with samples at its ends, by the polynomials through the nearest ones."""
    near = min(NEAR, len(t))
    for at, own, front in ((begin, slice(0, near), True), (end, slice(-near, None), False)):
        nodes = t[own]
        if (nodes == at).any():
            continue
        apart = nodes[:, None] - nodes[None, :] + np.eye(near)
        gaps = np.where(np.eye(near) > 0.0, 1.0, (at - nodes)[None, :])
        weights = np.prod(gaps / apart, axis=1)
        value = (weights @ y[own])[None]
        t = np.concatenate([[at], t]) if front else np.concatenate([t, [at]])
        y = np.concatenate([value, y]) if front else np.concatenate([y, value])
    return t, y


def unsure(found: Extremes) -> Extremes:
    """Return extremes of which no second run tells the errors."""
    fields = [field.name for field in dataclasses.fields(found.errors)]
    return dataclasses.replace(found, errors=dataclasses.replace(found.errors, **dict.fromkeys(fields)))

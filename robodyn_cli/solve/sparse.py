"""Motions that are followed in steps as long as the path lets them be, and solved at all samples from these at once.

What is solved at few samples is interpolated by quintics; Newton's method corrects the others side by side. A sample
counts where it came close to the interpolation, so that it is on the same branch; all behind the first that does not
is followed anew, in shorter strides, in the end one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import hermite

NEAR = 0.01  # rad, or part of the mechanism's size, by which the interpolation may miss
SETTLED = 1e-8  # a shorter step of Newton's method leaves rounding
ROUNDS = 6  # of Newton's method
FEWEST = 8  # samples from which on it pays
MOST = 12  # strides, between which samples are solved together


class Strides:
    """Samples to go to: strides grow as long as each is made in one step, and begin anew behind what did not count.

    over : whether the motion ends ahead, so that the rest is followed sample by sample.
    """

    def __init__(self, over: bool) -> None:
        self.length, self.over = 1, over

    def go(self, first: int, last: int, go_to: Callable[[int], int]) -> None:
        """Go on from sample ``first`` towards the last one, some strides far.

        go_to : goes on to a sample; returns the steps that it took.
        """
        at = first
        for _ in range(MOST):
            if at == last:
                return
            at = min(at + self.length, last)
            self.length = 2 * self.length if go_to(at) == 1 else max(1, self.length // 2)


def interpolated(times: Array, places: Sequence[int], states: Sequence[tuple[Array, Array, Array]]) -> Array:
    """Return positions (T, n) at times (T,) by the quintics through positions, rates and accelerations at samples
    ``places``, the first and the last among them."""
    knots = times[list(places)]
    q, v, a = (np.array(x) for x in zip(*states))
    h = np.diff(knots)[:, None]
    c = hermite(h, (q[:-1], v[:-1], a[:-1]), (q[1:], v[1:], a[1:]))
    piece = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(h) - 1)
    s, c = (times - knots[piece])[:, None] / h[piece], c[:, piece]
    positions: Array = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * (c[4] + s * c[5]))))
    positions[list(places)] = q
    return positions


def together(guess: Array, step: Callable[[Array], Array]) -> Array:
    """Return positions (T, n) moved from a guess by Newton's method, all at once; step : of positions (T, n)."""
    q = guess.copy()
    for _ in range(ROUNDS):
        move = step(q)
        q += move
        if not np.abs(move).max(initial=0.0) > SETTLED:
            break
    return q


def counted(good: Array, places: Sequence[int]) -> int:
    """Return which of the samples ``places`` is the last with nothing bad up to it; good : (T,), of all samples."""
    bad = np.flatnonzero(~good)
    first = int(bad[0]) if len(bad) else len(good)
    return max((k for k, place in enumerate(places) if place < first), default=0)

"""Derivatives of outputs by runs on both sides of a point, with their errors, and how far outputs jump there.

    slope = y' + O(h^2),   |y(x + h) - 2 y(x) + y(x - h)| = h^2 |y''|

Over wider steps second differences of smooth functions grow with the square of the step, and those of a corner with
the step. Those of outputs that jump from run to run, as what a controller with encoders does, stay as they are: there
differences over wide steps alone tell anything.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.over.search.asked import EDGE
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

WIDEST, NARROWEST = 1e-2, 1e-5  # part of the way between bounds, by which differences change a key
ROUGH = 0.1  # part of that way, where outputs jump
ROUNDING = 1e-15  # of outputs
BENT = 0.1  # of a slope: if those to both sides differ by more, outputs may jump
NOISE = 4.0  # times the errors of runs, that second differences may come to
STAYS = 2.0  # times as much as at a corner, by which second differences over wide steps exceed those of jumps


@record
class RunsBeside:
    """Runs at a point, ``y`` and ``error`` (n,), and at steps (m,) of one key from it: changes, errors (m, n). span :
    the way between the bounds."""

    y: Array
    error: Array
    steps: Array
    changes: Array
    errors: Array
    span: float

    @property
    def step(self) -> float:
        return float(np.abs(self.steps).min())

    @property
    def noise(self) -> Array:
        """What the errors of runs leave in differences (n,)."""
        off = np.nan_to_num(self.error) + np.nan_to_num(self.errors).max(axis=0)
        return np.asarray(off + ROUNDING * np.abs(self.y))

    @property
    def powers(self) -> Array:
        """Coefficients (m, n) of the polynomial through all runs, from the first power on."""
        powers = np.vander(self.steps, len(self.steps) + 1, increasing=True)[:, 1:]
        return np.asarray(np.linalg.solve(powers, self.changes))

    @property
    def bend(self) -> Array:
        """Second differences (n,), where there are runs for them."""
        return np.asarray(2.0 * np.abs(self.powers[1]) * self.step**2)

    def slope(self) -> tuple[Array, Array]:
        """Return the derivatives (n,) of the polynomial, and their errors: what the errors of the runs leave, and what
        the next power would change."""
        slope = self.powers[0]
        bent = np.abs(slope - self.changes[0] / self.steps[0]) * 3.0 * np.abs(self.steps).max() / self.span
        left = bent if len(self.steps) > 1 else np.abs(slope)
        return slope, self.noise / self.step + left

    def may_jump(self) -> NDArray[np.bool_]:
        """Tell which outputs (n,) bend by more than a smooth function mostly does over a short way."""
        if len(self.steps) < 2:
            return np.zeros(len(self.y), dtype=bool)
        return np.asarray(
            (self.bend > BENT * np.abs(self.powers[0]) * self.step) & (self.bend > NOISE * self.noise)
        )

    def jumps(self, wider: RunsBeside, known: NDArray[np.bool_] | None) -> Array:
        """Return how far outputs jump from run to run (n,), zero of those that do not, from runs over wider steps;
        known : which ones do so elsewhere."""
        if len(self.steps) < 2 or len(wider.steps) < 2:
            return np.zeros(len(self.y))
        stays = self.may_jump() & (self.bend > STAYS * self.step / wider.step * wider.bend)
        jump = stays if known is None else stays | known
        return np.where(jump, np.maximum(self.bend, wider.bend), 0.0)

    def rough_slope(self, jumps: Array) -> tuple[Array, Array]:
        """Return the derivatives (n,) of outputs that jump by so much, and their errors."""
        slope, error = self.slope()
        return slope, error + jumps / self.step


def step_beside(y: Array, error: Array) -> float:
    """Return the step, as a part of the way between bounds, at which the errors of runs and what differences leave out
    are about alike."""
    noise = float(np.nanmax(np.append(error / np.maximum(np.abs(y), 1e-300), 0.0)))
    return float(np.clip(max(noise, 1e-14) ** (1.0 / 3.0), NARROWEST, WIDEST))


def places_beside(x: Array, k: int, bounds: Sequence[float], step: float) -> list[Array]:
    """Return the values of keys on both sides of x along key k, at a bound on one side twice as far too."""
    low, high = bounds
    room = EDGE * (high - low)
    ways = [(1.0, -1.0), (1.0, 2.0), (-1.0, -2.0)]
    inside = [way for way in ways if all(low - room <= x[k] + s * step <= high + room for s in way)]
    sides = []
    for s in (inside or ways)[0]:
        side = x.copy()
        side[k] += s * step
        sides.append(side)
    return sides

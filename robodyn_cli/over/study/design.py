"""The points of a study: a grid of values, samples of distributions, or samples at each point of the grid."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.statements import Variation
from robodyn_cli.over.study.samples import Correlated, Repeated, Saltelli, Samples, inside, make_samples
from robodyn_cli.record import record
from robodyn_cli.scene.types import StudyOptions
from robodyn_cli.spatial.algebra import Array

MOST_RUNS = 10_000_000


@record
class Design:
    """What is run: keys, and a row of values for each run, made block by block.

    grid : the values of keys that form one, in their order. drawn : distributions. columns : where the key k stands
    among those of the grid and the drawn ones. samples : n of the unit cube for each point of the grid. indices : they
    are Saltelli's, blocks A, B and one AB for each key.
    """

    keys: tuple[str, ...]
    grid: tuple[Array, ...]
    drawn: tuple[Variation, ...]
    columns: tuple[int, ...]
    samples: Samples
    indices: bool = False

    def __len__(self) -> int:
        """Number of runs."""
        return math.prod(len(x) for x in self.grid) * self.samples.n

    def rows(self, first: int = 0, last: int | None = None) -> Array:
        """Return the values (runs, keys) of the runs from ``first`` up to, and without, ``last``."""
        last = len(self) if last is None else last
        point = np.arange(first, last) // self.samples.n
        places = np.unravel_index(point, [len(x) for x in self.grid]) if self.grid else ()
        unit = Repeated(self.samples).rows(first, last)
        parts = [
            *(values[place] for values, place in zip(self.grid, places)),
            *(quantile(v, u) for v, u in zip(self.drawn, unit.T)),
        ]
        return np.column_stack([parts[k] for k in self.columns])


def make_design(options: StudyOptions, indices: bool = False) -> Design:
    """Return the points of a study: all combinations of the grid, the last key fastest, with samples at each.

    Parameters
    ----------
    options : what varies and how; checked against each other here. indices : whether Sobol indices are asked for,
        which takes n (k + 2) runs of k distributions.

    Raises
    ------
    SceneError : nothing varies; n without distributions, or the other way round; too many runs; correlations that
        no distribution has.

    Notes
    -----
    The first rows of ``random`` and ``sobol`` samples are the same for every n, so a study can grow.
    """
    vary = options.vary
    grid = {name: v for name, v in vary.items() if v.is_grid}
    drawn = {name: v for name, v in vary.items() if not v.is_grid}
    _check(options, grid, drawn, indices)
    n, size = options.n or 1, len(drawn)
    samples = make_samples(options.sampler, n, 2 * size if indices else size, options.seed)
    if indices:
        samples = Saltelli(samples, size)
    if options.correlation:
        samples = Correlated(samples, list(drawn), options.correlation)
    given = [*grid, *drawn]
    values = tuple(np.array(v.values) for v in grid.values())
    columns = tuple(given.index(name) for name in vary)
    return Design(tuple(vary), values, tuple(drawn.values()), columns, samples, indices)


def _check(
    options: StudyOptions, grid: Mapping[str, Variation], drawn: Mapping[str, Variation], indices: bool
) -> None:
    if not options.vary:
        raise SceneError("nothing varies; give --vary KEY=SPEC, or study.vary in the scene")
    if drawn and options.n is None:
        raise SceneError(
            f"{', '.join(drawn)} {'is' if len(drawn) == 1 else 'are'} drawn from a distribution, so the number of "
            "samples is needed: -n N, or study.n"
        )
    if not drawn and options.n is not None:
        raise SceneError(
            f"n is {options.n}, but nothing is drawn from a distribution: a grid runs each point once"
        )
    if indices and (grid or options.correlation):
        raise SceneError(
            "Sobol indices need independent distributions alone; leave the grid and the correlation out"
        )
    if indices and options.n is not None and (options.n < 2 or options.n & (options.n - 1)):
        raise SceneError(
            f"-n {options.n}: Sobol indices need a power of 2 for the number of samples; allowed: 2, 4, 8, 16, ..."
        )
    points = math.prod(len(v.values) for v in grid.values())
    per_point = (options.n or 1) * (len(drawn) + 2 if indices else 1)
    if points * per_point > MOST_RUNS:
        raise SceneError(f"the study has {points * per_point:g} runs; allowed: at most {MOST_RUNS}")


def quantile(variation: Variation, u: Array) -> Array:
    """Return the values below which the shares ``u`` of a distribution lie."""
    u = inside(u)
    if variation.distribution == "uniform":
        low, high = variation.arguments
        return low + (high - low) * u
    if variation.distribution == "triangular":
        low, mode, high = variation.arguments
        width = high - low
        rising = low + np.sqrt(u * width * (mode - low))
        falling = high - np.sqrt((1.0 - u) * width * (high - mode))
        return np.where(u * width < mode - low, rising, falling)
    from scipy.special import ndtri

    mean, sd = variation.arguments
    return np.asarray(mean + sd * ndtri(u))

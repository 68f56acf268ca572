"""The points of a study: a grid of values, samples of distributions, or samples at each point of the grid. Samples of a
block do not depend on which others are asked for."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.statements import Variation
from robodyn_cli.record import record
from robodyn_cli.scene.nested_options import Correlation
from robodyn_cli.scene.types import StudyOptions
from robodyn_cli.spatial.algebra import Array

# uniform numbers stay this far from 0 and 1, where a normal distribution has no finite value
MARGIN = 2.0**-53  # the next number below 1 is so far from it


class Samples(Protocol):
    """``n`` samples with so many dimensions; the first of ``random`` and ``sobol`` are the same for every n."""

    n: int

    def rows(self, first: int, last: int) -> Array:
        """Return the samples from ``first`` up to, and without, ``last``."""


def make_samples(sampler: str, n: int, dimensions: int, seed: int) -> Samples:
    """Return samples by the name of their sampler."""
    if dimensions == 0 or sampler == "random":
        return Random(n, dimensions, seed)
    return Sobol(n, dimensions, seed) if sampler == "sobol" else Latin(n, dimensions, seed)


class Random:
    """Independent samples."""

    def __init__(self, n: int, dimensions: int, seed: int) -> None:
        self.n, self.dimensions, self.seed = n, dimensions, seed

    def rows(self, first: int, last: int) -> Array:
        bits = np.random.PCG64(self.seed)
        bits.advance(first * self.dimensions)  # a double takes one number of the generator
        return np.random.Generator(bits).random((last - first, self.dimensions))


class Sobol:
    """Scrambled points of Sobol's sequence."""

    def __init__(self, n: int, dimensions: int, seed: int) -> None:
        self.n, self.dimensions, self.seed = n, dimensions, seed
        self._sampler: Any = None

    def rows(self, first: int, last: int) -> Array:
        if self._sampler is None or self._sampler.num_generated > first:
            from scipy.stats import qmc

            self._sampler = qmc.Sobol(self.dimensions, seed=np.random.default_rng(self.seed))
        if self._sampler.num_generated < first:
            self._sampler.fast_forward(first - self._sampler.num_generated)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # n need not be a power of two
            return np.asarray(self._sampler.random(last - first))


class Latin:
    """A Latin hypercube. Its samples depend on each other, so all of them are kept."""

    def __init__(self, n: int, dimensions: int, seed: int) -> None:
        from scipy.stats import qmc

        self.n = n
        self._all = np.asarray(qmc.LatinHypercube(dimensions, seed=np.random.default_rng(seed)).random(n))

    def rows(self, first: int, last: int) -> Array:
        return self._all[first:last]


class Saltelli:
    """Samples A and B, and A with one column of B for each dimension, one after another.

    Source: Saltelli et al., Variance based sensitivity analysis of model output, Comput. Phys. Commun. 181 (2010).
    """

    def __init__(self, both: Samples, dimensions: int) -> None:
        self._both, self._dimensions = Repeated(both), dimensions
        self.n = both.n * (dimensions + 2)

    def rows(self, first: int, last: int) -> Array:
        both = self._both.rows(first, last)
        A, B = both[:, : self._dimensions], both[:, self._dimensions :]
        block = (np.arange(first, last) // (self.n // (self._dimensions + 2)))[:, None]
        return np.where((block == 1) | (block == np.arange(self._dimensions) + 2), B, A)


class Repeated:
    """The same samples again and again."""

    def __init__(self, samples: Samples) -> None:
        self._samples = samples

    def rows(self, first: int, last: int) -> Array:
        n = self._samples.n
        if last - first >= n:
            return self._samples.rows(0, n)[np.arange(first, last) % n]
        start, stop = first % n, (last - 1) % n + 1
        if start < stop:
            return self._samples.rows(start, stop)
        return np.vstack([self._samples.rows(start, n), self._samples.rows(0, stop)])


class Correlated:
    """Uniform samples whose normal scores have given correlations (a Gaussian copula).

    Raises
    ------
    SceneError : a key is not drawn from a distribution, or no variables can be correlated like that.
    """

    def __init__(self, samples: Samples, names: Sequence[str], pairs: Sequence[Correlation]) -> None:
        self._samples, self.n = samples, samples.n
        matrix = np.eye(len(names))
        for pair in pairs:
            a, b = (_place(name, names) for name in pair.between)
            if a == b:
                raise SceneError(
                    f"{pair.between[0]!r} stands there twice", ("study.correlation",), key="study.correlation"
                )
            matrix[a, b] = matrix[b, a] = pair.value
        try:
            self._factor = np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            raise SceneError(
                "the matrix of correlations is not positive definite: no variables are correlated so",
                ("study.correlation",),
                key="study.correlation",
            ) from None

    def rows(self, first: int, last: int) -> Array:
        from scipy.special import ndtr, ndtri

        scores = np.asarray(ndtri(inside(self._samples.rows(first, last))))
        # not as a product of matrices, whose rounding may depend on how many rows there are
        mixed = [sum(scores[:, j] * row[j] for j in range(k + 1)) for k, row in enumerate(self._factor)]
        return np.asarray(ndtr(np.stack(mixed, axis=1)))


def _place(name: str, names: Sequence[str]) -> int:
    if name not in names:
        raise SceneError(
            f"{name!r} is not drawn from a distribution; allowed: {', '.join(names)}",
            ("study.correlation",),
            key="study.correlation",
        )
    return names.index(name)


def inside(unit: Array) -> Array:
    """Return uniform numbers without 0 and 1."""
    return np.clip(unit, MARGIN, 1.0 - MARGIN)


def strata(runs: int, most: int) -> NDArray[np.int64]:
    """Return the numbers of all runs, or of ``most``: one at random of each of as many equal parts."""
    if runs <= most:
        return np.arange(runs)
    edges = np.linspace(0, runs, most + 1).astype(np.int64)
    drawn = np.random.default_rng(0).random(most)
    return edges[:-1] + (drawn * np.diff(edges)).astype(np.int64)


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

    @property
    def independent(self) -> int:
        """Number of independent runs: two of each of Saltelli's samples, one of the same sample at points of a grid."""
        return 2 * self.samples.n // (len(self.keys) + 2) if self.indices else self.samples.n

    @property
    def counted(self) -> int:
        """Number of runs, the first ones, of which statistics are: Saltelli's mixed blocks repeat others."""
        return self.independent if self.indices else len(self)

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

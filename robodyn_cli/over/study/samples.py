"""Samples of the unit cube, made block by block: those of a block do not depend on which others are asked for."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import SceneError
from robodyn_cli.scene.nested_options import Correlation
from robodyn_cli.spatial.algebra import Array

# uniform numbers stay this far from 0 and 1, where a normal distribution has no finite value
MARGIN = 2.0**-54


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
                raise SceneError(f"study.correlation: {pair.between[0]!r} stands there twice")
            matrix[a, b] = matrix[b, a] = pair.value
        try:
            self._factor = np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            raise SceneError(
                "study.correlation: the matrix of correlations is not positive definite: no variables are correlated so"
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
            f"study.correlation: {name!r} is not drawn from a distribution; allowed: {', '.join(names)}"
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

"""The points of a study: a grid of values, samples of distributions, or samples at each point of the grid."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.variation import Variation
from robodyn_cli.record import record
from robodyn_cli.scene.types import Correlation, StudyOptions
from robodyn_cli.spatial.algebra import Array

MOST_RUNS = 10_000_000
# uniform numbers stay this far from 0 and 1, where a normal distribution has no finite value
MARGIN = 2.0**-54


@record
class Design:
    """What is run: keys and their values (N, keys), one row a run.

    indices : the samples are Saltelli's, blocks A, B and one AB for each key.
    """

    keys: tuple[str, ...]
    values: Array
    indices: bool = False


def make_design(options: StudyOptions, indices: bool = False) -> Design:
    """Return the points of a study.

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
    points = _grid(list(grid.values()))
    n = 1 if options.n is None else options.n
    unit = _indices_samples(n, len(drawn), options) if indices else _samples(n, len(drawn), options)
    unit = _correlated(unit, list(drawn), options.correlation)
    draws = np.column_stack([quantile(v, u) for v, u in zip(drawn.values(), unit.T)]) if drawn else unit
    rows = np.hstack([np.repeat(points, len(unit), axis=0), np.tile(draws, (len(points), 1))])
    given = [*grid, *drawn]
    order = [given.index(name) for name in vary]
    return Design(tuple(vary), rows[:, order], indices)


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


def _grid(variations: Sequence[Variation]) -> Array:
    """Return all combinations (points, keys), the last key fastest."""
    axes = np.meshgrid(*[np.array(v.values) for v in variations], indexing="ij")
    count = math.prod(len(v.values) for v in variations)
    return np.array([axis.ravel() for axis in axes]).reshape(len(variations), count).T


def _samples(n: int, dimensions: int, options: StudyOptions) -> Array:
    """Return samples of the unit cube (n, dimensions)."""
    if dimensions == 0:
        return np.zeros((n, 0))
    if options.sampler == "random":
        return np.random.default_rng(options.seed).random((n, dimensions))
    from scipy.stats import qmc

    sampler = qmc.LatinHypercube if options.sampler == "latin" else qmc.Sobol
    rng = np.random.default_rng(options.seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # n need not be a power of two
        return np.asarray(sampler(dimensions, seed=rng).random(n))


def _indices_samples(n: int, dimensions: int, options: StudyOptions) -> Array:
    """Return Saltelli's design: samples A and B, and A with one column of B for each dimension.

    Source: Saltelli et al., Variance based sensitivity analysis of model output, Comput. Phys. Commun. 181 (2010).
    """
    both = _samples(n, 2 * dimensions, options)
    A, B = both[:, :dimensions], both[:, dimensions:]
    mixed = [np.where(np.arange(dimensions) == k, B, A) for k in range(dimensions)]
    return np.vstack([A, B, *mixed])


def _correlated(unit: Array, names: Sequence[str], pairs: Sequence[Correlation]) -> Array:
    """Return uniform samples whose normal scores have the given correlations (a Gaussian copula).

    Raises
    ------
    SceneError : a key is not drawn from a distribution, or no variables can be correlated like that.
    """
    if not pairs:
        return unit
    from scipy.special import ndtr, ndtri

    matrix = np.eye(len(names))
    for pair in pairs:
        for name in pair.between:
            if name not in names:
                raise SceneError(
                    f"study.correlation: {name!r} is not drawn from a distribution; allowed: {', '.join(names)}"
                )
        a, b = (names.index(name) for name in pair.between)
        if a == b:
            raise SceneError(f"study.correlation: {pair.between[0]!r} stands there twice")
        matrix[a, b] = matrix[b, a] = pair.value
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        raise SceneError(
            "study.correlation: the matrix of correlations is not positive definite: no variables are correlated so"
        ) from None
    return np.asarray(ndtr(ndtri(_inside(unit)) @ factor.T))


def _inside(unit: Array) -> Array:
    return np.clip(unit, MARGIN, 1.0 - MARGIN)


def quantile(variation: Variation, u: Array) -> Array:
    """Return the values below which the shares ``u`` of a distribution lie."""
    u = _inside(u)
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

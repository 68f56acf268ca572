"""The compiled passes against linear programs: at each point the largest x from which the end can be reached."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from robodyn_cli.fastest.profile import ROWS, PassChain, fastest_through

POINTS, ROWS_EACH = 7, 3


def random_chain(rng: np.random.Generator) -> tuple[PassChain, np.ndarray]:
    """Return a chain that x = 0 can be followed through, slopes of both signs, and limits of x."""
    shape = (POINTS - 1, ROWS_EACH)
    k0, k1 = rng.uniform(-0.5, 1.5, shape), rng.uniform(-0.5, 1.5, shape)
    bounds = [(-rng.uniform(0.1, 1.0, shape), rng.uniform(0.1, 1.0, shape)) for _ in range(2)]
    (low0, high0), (low1, high1) = bounds
    chain = PassChain(k0, low0, high0, k1, low1, high1, rng.uniform(size=POINTS - 1) < 0.4)
    return chain, np.append(rng.uniform(0.3, 3.0, POINTS - 1), 0.0)


def inequalities(chain: PassChain) -> tuple[np.ndarray, np.ndarray]:
    """Return G, h of G (x, m) <= h for the points x (POINTS,) and the numbers m (POINTS - 1,) of the segments."""
    G, h = [], []
    for i, even in enumerate(chain.even):
        rows = {name: getattr(chain, name)[i] for name in ROWS}
        middle = POINTS + i
        for end, own, other in (("0", i, i + 1), ("1", i + 1, i)):
            bounded = other if even else middle
            for k, low, high in zip(rows[f"k{end}"], rows[f"low{end}"], rows[f"high{end}"]):
                row = np.zeros(2 * POINTS - 1)
                row[bounded], row[own] = 1.0, -k
                G += [row, -row]
                h += [high, -low]
    return np.array(G), np.array(h)


@pytest.mark.parametrize("seed", range(30))
def test_each_point_is_as_large_as_the_rest_allows(seed: int) -> None:
    chain, most = random_chain(np.random.default_rng(seed))
    found = fastest_through(chain, most, 0.0, 0.0)
    assert isinstance(found, np.ndarray)
    G, h = inequalities(chain)
    bounds = [(0.0, float(x)) for x in most] + [(None, None)] * (POINTS - 1)
    bounds[0] = (0.0, 0.0)
    for i in range(1, POINTS):
        cost = np.zeros(2 * POINTS - 1)
        cost[i] = -1.0
        best = linprog(cost, G, h, bounds=bounds, method="highs")
        assert best.status == 0
        assert found[i] == pytest.approx(-best.fun, abs=1e-7)  # what the linear program may pass rows by
        bounds[i] = (max(found[i] - 1e-10, 0.0), found[i])


def test_the_point_that_nothing_passes_is_named() -> None:
    chain, most = random_chain(np.random.default_rng(1))
    chain.low0[3], chain.high0[3] = 4.0, 4.1  # m >= 4 + k x0, while m <= k x1 + 1 with x1 <= 3
    chain.k0[3], chain.k1[3] = 0.0, 0.0
    assert fastest_through(chain, most, 0.0, 0.0) == 3
    assert fastest_through(random_chain(np.random.default_rng(1))[0], most, 9.0, 0.0) == 0
    assert fastest_through(random_chain(np.random.default_rng(1))[0], most, 0.0, 9.0) == POINTS - 1

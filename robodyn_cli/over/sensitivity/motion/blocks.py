"""Linear differential equations on blocks of equidistant samples, all blocks at once.

    x = (q, v, z),  q-dot = v,  (v, z)-dot = A(t) x + B(t)

On a block of nine samples the rates are the polynomial of degree 8 that satisfies the equations at each of them: the
block implicit one-step method with eight new values, of order 10 and A-stable (Watts and Shampine 1972, "A-stable block
implicit one-step methods", BIT 12). As the equations are linear, each block gives its end as a linear function of its
beginning, so that the blocks need not wait for one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.spatial.algebra import Array

NEW = 8  # samples of a block behind its first: the largest number with which the method is A-stable


@cache
def integrals() -> Array:
    """Return Q (9, 9): integrals from 0 to k/8 of the polynomials that are 1 at one of nine nodes, 0 at the others."""
    nodes = np.arange(NEW + 1) / NEW
    powers = np.vander(nodes, NEW + 1, increasing=True)
    of_powers = nodes[:, None] ** np.arange(1, NEW + 2) / np.arange(1, NEW + 2)
    Q: Array = np.linalg.solve(powers.T, of_powers.T).T
    return Q


def nodes_of(samples: Sequence[int]) -> NDArray[np.int64]:
    """Return the numbers of the samples of each block (P, 9), where parts of a motion have so many samples each, 8
    blocks + 1.
    """
    found, first = [], 0
    for count in samples:
        found.append(first + np.arange(0, count - 1, NEW)[:, None] + np.arange(NEW + 1))
        first += count
    return np.concatenate(found)


def transfers(A: Array, B: Array, lengths: Array, nq: int) -> tuple[Array, Array]:
    """Return for each block what x at its beginning is multiplied by (P, nx, nx), and what is added (P, nx, K).

    Parameters
    ----------
    A, B : at the nodes of the blocks (P, 9, nr, nx) and (P, 9, nr, K). lengths : of the blocks (P,) [s]. nq : how many
        positions lead x.
    """
    blocks, _, nr, nx = A.shape
    Q, h = integrals(), lengths[:, None, None, None]
    QQ = Q @ Q
    # x at the nodes is ``begin`` times x at the beginning and h Q, for positions h^2 QQ, times the rates
    begin = np.tile(np.eye(nx), (blocks, NEW + 1, 1, 1))
    begin[:, :, :nq, nq : 2 * nq] += h * (np.arange(NEW + 1) / NEW)[:, None, None] * np.eye(nq)
    scaled, of_q = h * A[..., nq:], h * h * A[..., :nq]
    by_rates = Q[None, :, None, :, None] * scaled[:, :, :, None, :]
    by_rates[..., :nq] += QQ[None, :, None, :, None] * of_q[:, :, :, None, :]
    size = (NEW + 1) * nr
    matrix = np.eye(size) - by_rates.reshape(blocks, size, size)
    right = np.concatenate([A @ begin, B], axis=3).reshape(blocks, size, -1)
    rates = np.linalg.solve(matrix, right).reshape(blocks, NEW + 1, -1)
    h = lengths[:, None, None]
    ends = np.zeros((blocks, nx, right.shape[2]))
    ends[:, :, :nx] = begin[:, -1]
    ends[:, nq:] += h * (Q[-1] @ rates).reshape(blocks, nr, -1)
    ends[:, :nq] += h * h * (QQ[-1] @ rates).reshape(blocks, nr, -1)[:, :nq]
    return ends[:, :, :nx], ends[:, :, nx:]

"""Goals that are magnitudes, zero at their optimum: f = |M (u - u0)| and a constant, a cone with a corner at u0.

    f grad f = G (u - u0),   G = M^T M,        |u_k - u0_k| <= f sqrt((G^-1)_kk)

The second is Cauchy and Schwarz's inequality: where columns of M are nearly alike, keys may be much farther off than f
over the slope along each of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.spatial.algebra import Array

ROOM = 1.1  # times the bound: G is found at a distance, over which M may change
ROUNDED = 4e-16  # of the way between bounds
RANK = 1e-12  # smallest over largest eigenvalue of G that counts
FREE = 1e-6  # share of a key in directions that have no slope, above which its value may be any


def cone_of(f: Array, g: Array, step: float) -> Array:
    """Return G (n, n) from goals above their lowest value (n, 2) and their gradients (n, 2, n), a step ahead and behind
    along each key."""
    ahead, behind = (f[:, side, None] * g[:, side] for side in (0, 1))
    return np.asarray((ahead - behind) / (2.0 * step))


def off_cone(G: Array, above: float) -> Array:
    """Return how far each key (n,) may be off where a goal is so much above its lowest value; nan of keys that move in
    directions without a slope, and of all where G is not known."""
    if not np.isfinite(G).all() or not G.any():
        return np.full(len(G), np.nan)
    # as far as the largest of several magnitudes, which has edges, is no root of a sum of squares
    uneven = len(G) * float(np.abs(G - G.T).max() / np.abs(G).max())
    sizes, V = np.linalg.eigh(0.5 * (G + G.T))
    kept: NDArray[np.bool_] = sizes > RANK * sizes.max()
    off: Array = ROUNDED + above * (ROOM + uneven) * np.sqrt((V[:, kept] ** 2 / sizes[kept]).sum(axis=1))
    off[np.abs(V[:, ~kept]).max(axis=1, initial=0.0) > FREE] = np.nan
    return off

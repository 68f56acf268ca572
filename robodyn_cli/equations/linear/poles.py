"""Poles of linear systems with what rounding leaves of them."""

from __future__ import annotations

import numpy as np

from robodyn_cli.spatial.algebra import Array

TRIALS = 8  # disturbed systems that tell how far rounding moves the poles
SAFETY = 4.0


def pole_errors(A: Array, rounding: Array, poles: Array) -> Array:
    """Return how far poles (n,) of A may move where its entries change by no more than ``rounding`` (n, n) [1/s].

    The farthest that disturbed systems have none nearer, with the rounding of the eigenvalue solver. That of a multiple
    pole goes with a root of the disturbance, which no derivative would tell.
    """
    from scipy.linalg import matrix_balance

    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    reach = rounding / scale[:, None] * scale + np.finfo(float).eps * np.abs(balanced).max(initial=0.0)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (TRIALS, *A.shape))
    moved = np.linalg.eigvals(balanced + signs * reach)
    gaps = np.abs(poles[:, None] - moved[:, None, :]).min(axis=2, initial=np.inf)
    errors: Array = SAFETY * gaps.max(axis=0, initial=0.0)
    return errors


def without_rounding(poles: Array, errors: Array) -> Array:
    """Return poles with those parts 0 that are no larger than the error of the pole."""
    real, imaginary = (np.where(np.abs(part) > errors, part, 0.0) for part in (poles.real, poles.imag))
    return real + 1j * imaginary


def poles_of(A: Array, rounding: Array) -> tuple[Array, Array]:
    """Return the poles (n,) of A from left to right, and their errors, in the unit of A."""
    raw = np.linalg.eigvals(A)
    errors = pole_errors(A, rounding, raw)
    poles = without_rounding(raw, errors)
    order = np.lexsort((poles.imag, poles.real))
    return poles[order], errors[order]

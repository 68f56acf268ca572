"""Which modes of a linear system its inputs reach, and its outputs show."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from robodyn_cli.spatial.algebra import Array


def reached(A: Array, B: Array, s: complex, tolerance: float) -> bool:
    """Tell whether inputs reach the mode of x-dot = A x + B u with the pole s: whether [A - s E, B] has full rank.

    The test of Popov, Belevitch and Hautus (Kailath 1980, "Linear Systems", section 6.2). With A^T and C^T: whether
    y = C x shows the mode. States are scaled so that their units do not matter.

    Parameters
    ----------
    A : (n, n). B : (n, inputs); the units of an input do not matter for one alone. s : a pole [1/s].
    tolerance : a singular value this small beside the largest counts as zero.
    """
    from scipy.linalg import matrix_balance

    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    forces = B / scale[:, None]
    forces = forces / max(float(np.abs(forces).max(initial=0.0)), 1e-300)
    size = max(float(np.abs(balanced).max(initial=0.0)), 1e-300)
    rows = np.concatenate([(balanced - s * np.eye(len(A))) / size, forces], axis=1)
    values = np.linalg.svd(rows, compute_uv=False)
    return bool(values[-1] > tolerance * values[0])


def hidden(A: Array, B: Array, poles: Iterable[complex], tolerance: float) -> complex | None:
    """Return the first of some poles whose mode is not ``reached``, None without one."""
    return next((complex(s) for s in poles if not reached(A, B, s, tolerance)), None)

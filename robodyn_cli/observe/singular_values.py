"""Singular values of the loops' Psi and of its passive block along samples, as datasets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.spatial.algebra import Array


def singular_values(psi: Array, passive: Sequence[int] = (), rank: int | None = None) -> dict[str, Array]:
    """Return datasets by path: those of Psi (T, m, nv), and with ``passive`` coordinates those of their block.

    rank : how many count, where the others are zero in every pose.
    """
    data = {"singularity/psi": np.linalg.svd(psi, compute_uv=False)[:, :rank]}
    if passive:
        block = psi[:, :, list(passive)]
        data["singularity/passive"] = np.linalg.svd(block, compute_uv=False)[:, :rank]
        if block.shape[1] == block.shape[2]:
            data["singularity/determinant"] = np.linalg.det(block)
    return data

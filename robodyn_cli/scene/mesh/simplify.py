"""A mesh with fewer triangles: corners in one cell of a grid become one (Rossignac and Borrel, 1993)."""

from __future__ import annotations

import numpy as np

from robodyn_cli.scene.mesh.mesh import Mesh

FINE = 2**20  # cells along the longest side within which corners are the same
COARSEST, FINEST = 2, 256


def simplified(mesh: Mesh, most: int) -> Mesh:
    """Return a mesh of at most ``most`` triangles, as like as cells of one size allow.

    No face is turned, and only triangles without three corners are left out, so a closed surface stays closed: every
    edge is passed as often in one direction as in the other.
    """
    fine = clustered(mesh, FINE)
    if len(fine.faces) <= most:
        return fine
    low, high = COARSEST, FINEST
    found = clustered(fine, low)
    while high - low > 1:
        middle = (low + high) // 2
        tried = clustered(fine, middle)
        if len(tried.faces) <= most:
            low, found = middle, tried
        else:
            high = middle
    return found


def clustered(mesh: Mesh, cells: int) -> Mesh:
    """Return a mesh whose corners in one cell of a grid, ``cells`` along its longest side, are one: their mean."""
    points, faces = mesh.points, mesh.faces
    if not len(faces):
        return mesh
    low = points.min(axis=0)
    size = float((points - low).max()) or 1.0
    place = np.floor((points - low) / size * (cells - 1) + 0.5).astype(np.int64)
    _, number = np.unique((place[:, 0] * FINE + place[:, 1]) * FINE + place[:, 2], return_inverse=True)
    number = number.reshape(-1)
    weight = np.bincount(number).astype(float)
    means = np.stack([np.bincount(number, points[:, k]) / weight for k in range(3)], axis=1)
    a, b, c = (faces := number[faces]).T
    used, renumbered = np.unique(faces[(a != b) & (b != c) & (c != a)], return_inverse=True)
    return Mesh(means[used], renumbered.reshape(-1, 3))

"""Read COLLADA (.dae), by the package pycollada: triangles of all nodes of its scene, in metres."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import numpy as np

from robodyn_cli.scene.mesh.mesh import Mesh, MeshError
from robodyn_cli.spatial.algebra import Array

PACKAGE = "collada"
EXTRA = "a .dae mesh needs the package pycollada: pip install 'robodyn[collada]'"


def can_read_dae() -> bool:
    """Tell whether the package that reads it is there."""
    return importlib.util.find_spec(PACKAGE) is not None


def read_dae(data: bytes) -> Mesh:
    """Return the mesh of a COLLADA file, in metres by the file's own unit, axes as they stand, as ROS takes them.

    Raises
    ------
    MeshError : the package is missing; a document type, which can define entities that grow without end; no COLLADA.
    """
    if not can_read_dae():
        raise MeshError(EXTRA)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise MeshError("a document type (<!DOCTYPE>) is refused")
    import collada

    try:
        # materials and textures that are not there do not matter here
        document = collada.Collada(BytesIO(data), ignore=[collada.common.DaeError])
        corners = list(_corners(document))
    except Exception as error:  # a parser of foreign files: whatever it stumbles over, the file is at fault
        raise MeshError(f"no COLLADA that pycollada reads: {error}") from None
    points = np.concatenate([np.zeros((0, 3)), *corners]) * float(document.assetInfo.unitmeter or 1.0)
    return Mesh(points, np.arange(len(points)).reshape(-1, 3))


def _corners(document: Any) -> Iterator[Array]:
    """Yield the corners of triangles (3 N, 3), node by node."""
    if document.scene is None:
        return
    for geometry in document.scene.objects("geometry"):
        for part in geometry.primitives():
            triangles = part.triangleset() if hasattr(part, "triangleset") else part
            corners = triangles.vertex_index
            if corners is not None and corners.shape[1:] == (3,):  # lines have two
                yield np.asarray(triangles.vertex[corners], dtype=float).reshape(-1, 3)

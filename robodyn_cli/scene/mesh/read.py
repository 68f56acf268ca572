"""From the file of a mesh to the text that a scene keeps of it."""

from __future__ import annotations

import os

import numpy as np

from robodyn_cli.scene.mesh.mesh import MOST_BYTES, Mesh, MeshError
from robodyn_cli.scene.mesh.obj import obj_text, read_obj
from robodyn_cli.scene.mesh.simplify import simplified
from robodyn_cli.scene.mesh.stl import read_stl

FORMATS = (".stl", ".obj")
MOST_FACES = 200  # that a drawing needs of a mesh: results and pages stay small
DIGITS = 4  # of its size


def is_readable(name: str) -> bool:
    """Tell whether a mesh is in a format that is read, by its name."""
    return name.lower().endswith(FORMATS)


def small_mesh(path: str) -> str:
    """Return the mesh of a file as OBJ of at most ``MOST_FACES`` triangles, in the unit of the file.

    Raises
    ------
    MeshError : the file cannot be read, is too large, of another format or damaged.
    """
    if not is_readable(path):
        raise MeshError(f"allowed: {' or '.join(FORMATS)}")
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # a zero byte in the name is a ValueError
        raise MeshError(getattr(error, "strerror", None) or str(error)) from None
    if len(data) > MOST_BYTES:
        raise MeshError(f"larger than {MOST_BYTES // 1_000_000} MB")
    mesh = read_stl(data) if path.lower().endswith(".stl") else read_obj(data.decode("utf-8", "replace"))
    if not len(mesh.faces):
        raise MeshError(f"no triangles in {os.path.getsize(path)} bytes")
    used = mesh.points[mesh.faces].reshape(-1, 3)
    if not np.isfinite(used).all():
        raise MeshError("a corner is not finite")
    return obj_text(_rounded(simplified(Mesh(used, np.arange(len(used)).reshape(-1, 3)), MOST_FACES)))


def _rounded(mesh: Mesh) -> Mesh:
    size = float(np.abs(mesh.points).max(initial=0.0))
    return Mesh(mesh.points if size == 0.0 else np.round(mesh.points / size, DIGITS) * size, mesh.faces)

"""From the file of a mesh to the text that a scene keeps of it."""

from __future__ import annotations

import os

import numpy as np

from robodyn_cli.scene.mesh.dae import can_read_dae, read_dae
from robodyn_cli.scene.mesh.mesh import MOST_BYTES, Mesh, MeshError
from robodyn_cli.scene.mesh.obj import obj_text, read_obj
from robodyn_cli.scene.mesh.simplify import simplified
from robodyn_cli.scene.mesh.stl import read_stl

FORMATS = (".stl", ".obj", ".dae")
MOST_FACES = 200  # that a drawing needs of a mesh: results and pages stay small
DIGITS = 4  # of its size


def is_readable(name: str) -> bool:
    """Tell whether a mesh is in a format that can be read here, by its name."""
    return name.lower().endswith(FORMATS) and (not name.lower().endswith(".dae") or can_read_dae())


def small_mesh(path: str) -> str:
    """Return the mesh of a file as OBJ of at most ``MOST_FACES`` triangles, in the unit of the file; of .dae in metres.

    Raises
    ------
    MeshError : the file cannot be read, is too large, of another format or damaged.
    """
    if not path.lower().endswith(FORMATS):
        raise MeshError(f"allowed: {', '.join(FORMATS)}")
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # a zero byte in the name is a ValueError
        raise MeshError(getattr(error, "strerror", None) or str(error)) from None
    if len(data) > MOST_BYTES:
        raise MeshError(f"larger than {MOST_BYTES // 1_000_000} MB")
    mesh = _read(data, path.lower().rpartition(".")[2])
    if not len(mesh.faces):
        raise MeshError(f"no triangles in {os.path.getsize(path)} bytes")
    used = mesh.points[mesh.faces].reshape(-1, 3)
    if not np.isfinite(used).all():
        raise MeshError("a corner is not finite")
    return obj_text(_rounded(simplified(Mesh(used, np.arange(len(used)).reshape(-1, 3)), MOST_FACES)))


def _read(data: bytes, kind: str) -> Mesh:
    if kind == "stl":
        return read_stl(data)
    return read_dae(data) if kind == "dae" else read_obj(data.decode("utf-8", "replace"))


def _rounded(mesh: Mesh) -> Mesh:
    size = float(np.abs(mesh.points).max(initial=0.0))
    return Mesh(mesh.points if size == 0.0 else np.round(mesh.points / size, DIGITS) * size, mesh.faces)

"""A mesh of triangles, and what is wrong with a file of one."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

MOST_BYTES = 50_000_000  # of a file


class MeshError(ValueError):
    """A file that holds no mesh; the text says where and why."""


@record
class Mesh:
    """points : (N, 3), in the unit of the file. faces : (M, 3), the corners of triangles by number."""

    points: Array
    faces: Array

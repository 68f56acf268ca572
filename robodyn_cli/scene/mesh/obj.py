"""Wavefront OBJ, as far as it says where faces are: lines ``v x y z`` and ``f i j k ...``."""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.scene.mesh.mesh import Mesh, MeshError


def read_obj(text: str) -> Mesh:
    """Return the mesh of an OBJ text; faces with more corners than three are fans of triangles.

    Raises
    ------
    MeshError : a line that is none, a corner that is not there.
    """
    points: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if words[:1] == ["v"]:
            points.append(_point(words[1:4], number))
        elif words[:1] == ["f"]:
            corners = [_corner(word, len(points), number) for word in words[1:]]
            if len(corners) < 3:
                raise MeshError(f"line {number}: a face needs three corners or more")
            faces += [(corners[0], a, b) for a, b in zip(corners[1:], corners[2:])]
    if faces and max(map(max, faces)) >= len(points):
        raise MeshError(f"a face has corner {max(map(max, faces)) + 1} of {len(points)}")
    return Mesh(np.array(points, dtype=float).reshape(-1, 3), np.array(faces, dtype=int).reshape(-1, 3))


def _point(words: list[str], line: int) -> list[float]:
    try:
        x, y, z = (float(word) for word in words)
    except ValueError:
        raise MeshError(f"line {line}: 'v' needs three numbers") from None
    if not math.isfinite(x + y + z):
        raise MeshError(f"line {line}: a corner is not finite")
    return [x, y, z]


def _corner(word: str, count: int, line: int) -> int:
    """Return the number, from 0, of a corner; behind slashes stand texture and normal, negative ones count back."""
    try:
        number = int(word.partition("/")[0])
    except ValueError:
        number = 0
    found = number - 1 if number > 0 else count + number
    if number == 0 or found < 0:
        raise MeshError(f"line {line}: {word!r} is no number of a corner")
    return found


def obj_text(mesh: Mesh) -> str:
    """Return a mesh as OBJ."""
    lines = [f"v {x:g} {y:g} {z:g}" for x, y, z in mesh.points.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()]
    return "\n".join(lines)

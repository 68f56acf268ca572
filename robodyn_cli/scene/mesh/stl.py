"""Read STL, binary and text: triangles without common corners."""

from __future__ import annotations

import numpy as np

from robodyn_cli.scene.mesh.mesh import Mesh, MeshError

HEAD = 84  # bytes before the triangles: 80 of comment, and their number
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])


def read_stl(data: bytes) -> Mesh:
    """Return the mesh of an STL file.

    Raises
    ------
    MeshError : the file ends early, or is no STL.
    """
    text = data.lstrip().startswith(b"solid") and b"facet" in data[:2000]
    points = _text(data) if text else _binary(data)
    return Mesh(points, np.arange(len(points)).reshape(-1, 3))


def _binary(data: bytes) -> np.ndarray:
    if len(data) < HEAD:
        raise MeshError(f"no STL: {len(data)} bytes, and its head alone has {HEAD}")
    count = int.from_bytes(data[80:HEAD], "little")
    needed = HEAD + count * TRIANGLE.itemsize
    if needed > len(data):
        raise MeshError(f"no STL, or cut off: {count} triangles need {needed} bytes, there are {len(data)}")
    found = np.frombuffer(data, TRIANGLE, count, HEAD)["corners"]
    return found.reshape(-1, 3).astype(float)


def _text(data: bytes) -> np.ndarray:
    rows: list[list[float]] = []
    for number, line in enumerate(data.splitlines(), start=1):
        words = line.split()
        if words[:1] == [b"vertex"]:
            try:
                x, y, z = (float(word) for word in words[1:])
            except ValueError:
                raise MeshError(f"line {number}: a vertex needs three numbers") from None
            rows.append([x, y, z])
    if len(rows) % 3:
        raise MeshError(f"{len(rows)} corners make no triangles: the file is cut off")
    return np.array(rows, dtype=float).reshape(-1, 3)

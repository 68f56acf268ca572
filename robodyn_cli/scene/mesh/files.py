"""A mesh of triangles, and what is wrong with a file of one.

Read STL, binary and text: triangles without common corners.

Wavefront OBJ, as far as it says where faces are: lines ``v x y z`` and ``f i j k ...``.

Read COLLADA (.dae), by the package pycollada: triangles of all nodes of its scene, in metres.

A mesh with fewer triangles: corners in one cell of a grid become one (Rossignac and Borrel, 1993).

From the file of a mesh to the text that a scene keeps of it.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import numpy as np

from robodyn_cli.foreign import contents
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

MOST_BYTES = 50_000_000  # of a file
MOST_NODES, MOST_TRIANGLES = 10_000, 5_000_000  # of a .dae, with all instances


class MeshError(ValueError):
    """A file that holds no mesh; the text says where and why."""


@record
class Mesh:
    """points : (N, 3), in the unit of the file. faces : (M, 3), the corners of triangles by number."""

    points: Array
    faces: Array


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
    records = np.frombuffer(data, TRIANGLE, count, HEAD)["corners"]
    return records.reshape(-1, 3).astype(float)


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
    index = number - 1 if number > 0 else count + number
    if number == 0 or index < 0:
        raise MeshError(f"line {line}: {word!r} is no number of a corner")
    return index


def obj_text(mesh: Mesh) -> str:
    """Return a mesh as OBJ."""
    lines = [f"v {x:g} {y:g} {z:g}" for x, y, z in mesh.points.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()]
    return "\n".join(lines)


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
    import zipfile
    from xml.parsers import expat

    import collada

    parser = expat.ParserCreate()  # finds a document type in every encoding
    parser.StartDoctypeDeclHandler = _refuse_document_type
    try:
        parser.Parse(data, True)
        if zipfile.is_zipfile(BytesIO(data)):  # which pycollada would unpack
            raise MeshError("an archive is refused")
        # materials and textures that are not there do not matter here
        document = collada.Collada(BytesIO(data), ignore=[collada.common.DaeError])
        corners = list(_corners(document))
    except MeshError:
        raise
    except Exception as error:  # a parser of foreign files: whatever it stumbles over, the file is at fault
        raise MeshError(f"no COLLADA that pycollada reads: {error}") from None
    points = np.concatenate([np.zeros((0, 3)), *corners]) * float(document.assetInfo.unitmeter or 1.0)
    return Mesh(points, np.arange(len(points)).reshape(-1, 3))


def _refuse_document_type(*declared: Any) -> None:
    raise MeshError("a document type (<!DOCTYPE>) is refused")


def _nodes(node: Any, known: dict[int, int]) -> int:
    """Return how many nodes stand below one, each as often as it is an instance there."""
    from collada.scene import Node, NodeNode

    if id(node) not in known:
        below = node.children if isinstance(node, (Node, NodeNode)) else ()
        known[id(node)] = 1 + sum(_nodes(child, known) for child in below)
    return known[id(node)]


def _corners(document: Any) -> Iterator[Array]:
    """Yield the corners of triangles (3 N, 3), node by node."""
    if document.scene is None:
        return
    known: dict[int, int] = {}
    if sum(_nodes(node, known) for node in document.scene.nodes) > MOST_NODES:
        raise MeshError(f"its nodes stand for more than {MOST_NODES}, each as often as it is an instance")
    left = MOST_TRIANGLES
    for geometry in document.scene.objects("geometry"):
        for part in geometry.primitives():
            triangles = part.triangleset() if hasattr(part, "triangleset") else part
            corners = triangles.vertex_index
            if corners is not None and corners.shape[1:] == (3,):  # lines have two
                if (left := left - len(corners)) < 0:
                    raise MeshError(f"its instances have more than {MOST_TRIANGLES} triangles")
                yield np.asarray(triangles.vertex[corners], dtype=float).reshape(-1, 3)


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
    best = clustered(fine, low)
    while high - low > 1:
        middle = (low + high) // 2
        tried = clustered(fine, middle)
        if len(tried.faces) <= most:
            low, best = middle, tried
        else:
            high = middle
    return best


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


FORMATS = (".stl", ".obj", ".dae")
MOST_FACES = 200  # that a drawing needs of a mesh: results and pages stay small
DIGITS = 4  # of its size


def is_readable(name: str) -> bool:
    """Tell whether a mesh is in a format that can be read here, by its name."""
    return name.lower().endswith(FORMATS) and (not name.lower().endswith(".dae") or can_read_dae())


@np.errstate(all="ignore")  # what is too large is told below
def small_mesh(path: str) -> str:
    """Return the mesh of a file as OBJ of at most ``MOST_FACES`` triangles, in the unit of the file; of .dae in metres.

    Raises
    ------
    MeshError : the file cannot be read, is too large, of another format or damaged.
    """
    used = _triangles(mesh_bytes(path), path)
    return obj_text(_rounded(simplified(Mesh(used, np.arange(len(used)).reshape(-1, 3)), MOST_FACES)))


def mesh_bytes(path: str, checked: bool = False) -> bytes:
    """Return the bytes of a file that holds a mesh; ``checked`` : which was read from them.

    Raises
    ------
    MeshError : as ``small_mesh``.
    """
    if not path.lower().endswith(FORMATS):
        raise MeshError(f"allowed: {', '.join(FORMATS)}")
    try:
        data = contents(path, MOST_BYTES)
    except (OSError, ValueError) as error:  # a zero byte in the name is a ValueError
        raise MeshError(getattr(error, "strerror", None) or str(error)) from None
    if checked:
        _triangles(data, path)
    return data


@np.errstate(all="ignore")
def _triangles(data: bytes, path: str) -> Array:
    """Return the corners (3 N, 3) of the triangles in the bytes of a file."""
    mesh = _read(data, path.lower().rpartition(".")[2])
    if not len(mesh.faces):
        raise MeshError(f"no triangles in {len(data)} bytes")
    used = mesh.points[mesh.faces].reshape(-1, 3)
    if not np.isfinite(np.ptp(used, axis=0)).all():
        raise MeshError("a corner is not finite, or too far from another one for a double")
    return used


def _read(data: bytes, kind: str) -> Mesh:
    if kind == "stl":
        return read_stl(data)
    return read_dae(data) if kind == "dae" else read_obj(data.decode("utf-8", "replace"))


def _rounded(mesh: Mesh) -> Mesh:
    size = float(np.abs(mesh.points).max(initial=0.0))
    return Mesh(mesh.points if size == 0.0 else np.round(mesh.points / size, DIGITS) * size, mesh.faces)

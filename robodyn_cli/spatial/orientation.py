"""How a frame is turned: from the form in which a scene gives it to its axes, and what may be wrong with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from robodyn_cli.schema.fields import Orientation
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import (
    Matrix,
    Values,
    Vector,
    cross,
    matrix,
    rotation_about,
    rotation_rpy,
    rotation_to_z,
    snap,
    vector,
)

FORMS = "rpy, quaternion, axis and angle, matrix, or two of x, y, z"
ROUNDED = 1e-3  # three digits of a direction or a length of 1


def rotation_of(given: Orientation) -> Matrix:
    """Return the rotation R (3, 3) of a frame, its axes as columns, from the form in which the scene gives it.

    A matrix of few digits is replaced by the nearest rotation; of two directions the first keeps its own, and the
    second is the nearest one at right angles.
    """
    if given.plain:
        return rotation_rpy(given.rpy or (0.0, 0.0, 0.0))
    axes = {k: a for k, a in enumerate((given.x, given.y, given.z)) if a is not None}
    if given.quaternion is not None:
        R = quaternion.rotation(quaternion.unit(vector(given.quaternion)))
    elif given.axis is not None and given.angle is not None:
        to_z = rotation_to_z(given.axis)
        R = to_z @ rotation_about(2, given.angle) @ to_z.T
    elif given.matrix is not None:
        left, _, right = np.linalg.svd(np.array(given.matrix))
        R = left @ right
    else:
        R = from_directions(axes)
    return matrix([[snap(float(x)) for x in row] for row in R])


def from_directions(axes: dict[int, tuple[float, ...]]) -> Matrix:
    """Return the rotation of which two columns, by index, have given directions."""
    (i, first), (j, second) = axes.items()
    k = 3 - i - j
    columns = {i: _unit(first)}
    columns[k] = _unit(cross(columns[i], second))
    columns[j] = cross(columns[k], columns[i])
    if (j - i) % 3 == 2:  # i, j, k do not follow in the order x, y, z
        columns[k] = -columns[k]
    return np.stack([columns[n] for n in range(3)], axis=1)


def _unit(a: Values) -> Vector:
    length = math.hypot(*a)
    return vector([e / length for e in a])


def orientation_problems(given: Orientation) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield what is wrong with an orientation, and at which key."""
    axes = {name: axis for name in ("x", "y", "z") if (axis := getattr(given, name)) is not None}
    forms = [name for name in ("rpy", "quaternion", "matrix") if getattr(given, name) is not None]
    forms += ["axis"] if given.axis is not None or given.angle is not None else []
    forms += [next(iter(axes))] if axes else []
    if len(forms) > 1:
        yield (forms[-1],), f"gives the orientation twice, beside {forms[0]!r}; allowed: one of {FORMS}"
    elif (given.axis is None) != (given.angle is None):
        there, missing = ("axis", "angle") if given.angle is None else ("angle", "axis")
        yield (there,), f"needs {missing!r} beside it"
    elif len(axes) in (1, 3):
        yield (
            (next(iter(axes)),),
            f"{len(axes)} of the axes x, y, z are given; allowed: two, the third follows",
        )
    elif len(axes) == 2:
        (_, first), (name, second) = axes.items()
        cosine = _dot(first, second) / (math.hypot(*first) * math.hypot(*second))
        if abs(cosine) > ROUNDED:
            yield (name,), f"must be at right angles to the other axis, to three digits (cosine {cosine:.3g})"
    elif given.quaternion is not None and abs(math.hypot(*given.quaternion) - 1.0) > ROUNDED:
        length = math.hypot(*given.quaternion)
        yield ("quaternion",), f"(w, x, y, z) has length {length:.6g}; needed: length 1, to three digits"
    elif given.matrix is not None and (problem := _matrix_problem(given.matrix)):
        yield ("matrix",), problem


def _matrix_problem(rows: Sequence[Sequence[float]]) -> str:
    """Return why a matrix is no rotation, empty if it is one."""
    for i in range(3):
        for j in range(i, 3):
            product = _dot(rows[i], rows[j])
            if not abs(product - (i == j)) <= ROUNDED:
                reason = (
                    f"row {i} has length {math.sqrt(product):.6g}"
                    if i == j
                    else f"rows {i} and {j} are not at right angles"
                )
                return f"is no rotation: {reason}; needed: rows of length 1 at right angles, to three digits"
    a, b, c = rows
    cross = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    return "is a reflection: its determinant is -1; needed: 1" if _dot(cross, c) < 0.0 else ""


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b))

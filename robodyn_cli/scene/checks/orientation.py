"""Checks of how frames are turned: one form, and a rotation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.robot_types import Orientation
from robodyn_cli.scene.text.nodes import Path

FORMS = "rpy, quaternion, axis and angle, matrix, or two of x, y, z"
ROUNDED = 1e-3  # three digits of a direction or a length of 1


def check_orientation(given: Orientation, check: Check, path: Path) -> None:
    """Refuse an orientation in no form, in several, or that is no rotation."""
    for where, message in orientation_problems(given):
        with check:
            check.fail((*path, *where), message)


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
                what = (
                    f"row {i} has length {math.sqrt(product):.6g}"
                    if i == j
                    else f"rows {i} and {j} are not at right angles"
                )
                return f"is no rotation: {what}; needed: rows of length 1 at right angles, to three digits"
    a, b, c = rows
    cross = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    return "is a reflection: its determinant is -1; needed: 1" if _dot(cross, c) < 0.0 else ""


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b))

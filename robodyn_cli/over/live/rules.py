"""Rules of Python as data: functions of numpy's arrays run once on arrays that record what is done with them.

What functions are recorded as that neither work entry by entry nor only put entries elsewhere (``over/live/tape.py``).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robodyn_cli.over.live.tape import SPECIAL, ChosenRows, Recorded, Tape, example_of, plain
from robodyn_cli.solve.quadrature import POINTS, Breaks, doubts, positive_parts
from robodyn_cli.spatial.algebra import Array

__all__ = ["Recorded", "Tape", "plain"]


def _solve(tape: Tape, A: Any, b: Any) -> Recorded:
    return tape.matrices(
        "solve", [A, b], np.linalg.solve(example_of(A), example_of(b)), A.shape[-1], b.shape[-1]
    )


def _pinv(tape: Tape, A: Any, rcond: float) -> Recorded:
    return tape.matrices("pinv", [A], np.linalg.pinv(example_of(A), rcond=rcond), *A.shape[-2:], rcond)


def _svd(tape: Tape, A: Any, full_matrices: bool = True, compute_uv: bool = True) -> Any:
    """Record singular values, and with them V^T; what is left of U is not there."""
    m, n = A.shape[-2:]
    U, sigma, Vt = np.linalg.svd(example_of(A), full_matrices=False)
    values = tape.matrices("sigma", [A], sigma, m, n)
    if not compute_uv:
        return values
    return U, values, tape.matrices("right_vectors", [A], Vt, m, n)


def _det(tape: Tape, A: Any) -> Recorded:
    return tape.matrices("det", [A], np.linalg.det(example_of(A)), A.shape[-1])


def _sort(tape: Tape, x: Any, axis: int = -1) -> Recorded:
    assert axis % x.ndim == x.ndim - 1
    return tape.matrices("sort", [x], np.sort(example_of(x), axis=axis), x.shape[-1])


def _where(tape: Tape, condition: Any, a: Any, b: Any) -> Recorded:
    return tape.elementwise("where", [condition, a, b], np.where(*map(example_of, (condition, a, b))))


def _flatnonzero(tape: Tape, x: Any) -> ChosenRows:
    return ChosenRows(tape, x.place, x.example)


def _take_along(tape: Tape, x: Any, places: Any, axis: int) -> Recorded:
    """Record entries of the first axis of matrices by number: ``places`` (..., 1, n) with the same number in a row."""
    values = np.take_along_axis(example_of(x), example_of(places), axis=axis)
    return tape.matrices("row", [x, places], values, x.shape[axis], math.prod(x.shape[axis + 1 :]))


def _argmax(tape: Tape, x: Any, axis: int | None = None) -> Any:
    """Record the first of the largest along the first axis; of runs side by side there is one, the first."""
    if axis is None:
        return 0
    assert axis % x.ndim == 0
    return tape.reduced("argmax", x, axis, np.argmax(x.example, axis=axis))


def _diff(tape: Tape, x: Any, n: int = 1, axis: int = -1) -> Any:
    assert axis == 0 or x.ndim == 1
    row = math.prod(x.shape[1:])
    for _ in range(n):
        x = tape.matrices("diff", [x], np.diff(x.example, axis=0), row)
    return x


def _clip(tape: Tape, x: Any, low: Any, high: Any) -> Any:
    return np.minimum(np.maximum(x, low), high)


def _norm(tape: Tape, x: Any, axis: int) -> Any:
    return np.sqrt((x * x).sum(axis=axis))


def _dot(tape: Tape, subscripts: str, a: Any, b: Any) -> Any:
    assert subscripts == "...i,...i->..."
    return (a * b).sum(axis=-1)


def _cross(tape: Tape, a: Any, b: Any) -> Any:
    """Record vector products along the last axis."""
    first, second = [1, 2, 0], [2, 0, 1]
    return a[..., first] * b[..., second] - a[..., second] * b[..., first]


def _slogdet(tape: Tape, A: Any) -> tuple[Any, None]:
    """Record the sign of determinants; their size is not there."""
    return np.sign(np.linalg.det(A)), None


def _constant_like(tape: Tape, x: Any, shape: Any = None) -> Recorded:
    return tape.constant(np.zeros(x.shape if shape is None else shape))


def _positive_parts(tape: Tape, y: Any, first: Array, last: Array, chosen: Any) -> Recorded:
    """Record integrals of polynomials through samples where they are positive."""
    values = positive_parts(*map(example_of, (y, first, last, chosen)))
    return tape.matrices("positive", [y, first, last, chosen], values, len(y), POINTS)


def _hidden_jumps(tape: Tape, times: Array, y: Any, breaks: Breaks) -> Any:
    """Take it that functions jump and bend nowhere but at breaks; note where that is in doubt."""
    if len(y) >= 2 * POINTS:
        doubtful: Any = doubts(times, y, breaks)[1]
        tape.doubts.append(doubtful)
    return [(slice(None), ())]


SPECIAL |= {
    "solve": _solve, "pinv": _pinv, "svd": _svd, "det": _det, "slogdet": _slogdet, "sort": _sort, "where": _where,
    "flatnonzero": _flatnonzero, "take_along_axis": _take_along, "argmax": _argmax, "zeros_like": _constant_like,
    "clip": _clip, "ptp": lambda tape, x, axis: x.max(axis=axis) - x.min(axis=axis), "diff": _diff, "norm": _norm,
    "einsum": _dot, "cross": _cross, "positive_parts": _positive_parts, "hidden_jumps": _hidden_jumps,
}  # fmt: skip

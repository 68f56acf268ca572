"""Refuse numbers that are not finite, and say where they come from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.expr.graph import Expr, Scalar, reachable
from robodyn_cli.expr.rebuild import apply
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

CONSTANT = "a number of the scene, or a product of some, exceeds what a double holds (1.8e308)"
TOO_LARGE = "it exceeds what a double holds (1.8e308), or is 0 / 0"
SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
# names of a motion's symbol groups in results
MOTION = {"t": ("time", "time"), "q": ("q", "position"), "v": ("qd", "rate"), "a": ("qdd", "acceleration")}


def first_fault(arrays: Mapping[str, Array]) -> tuple[str, tuple[int, ...]] | None:
    """Return name and index of the first number that is not finite, sample by sample of the first such array."""
    for name, array in arrays.items():
        # a finite sum has finite entries; one that overflows is examined entry by entry
        if not np.isfinite(array.sum()) and not np.isfinite(array).all():
            at = np.argwhere(~np.isfinite(array))[0]
            return name, tuple(int(k) for k in at)
    return None


def refuse_sampled(
    inputs: Mapping[str, Array], outputs: Mapping[str, Sequence[Scalar]], arrays: Mapping[str, Array]
) -> None:
    """Refuse outputs (T, n), evaluated from inputs (T, n) by symbol group, that are not finite.

    Raises
    ------
    NumericalError : names dataset, time and the operation that has no value.
    """
    found = first_fault(inputs)
    if found is not None:
        name, (sample, *_) = found
        path, what = MOTION[name]
        raise not_finite(path, float(inputs["t"][sample, 0]), f"the motion has no finite {what} there")
    found = first_fault(arrays)
    if found is not None:
        name, (sample, *_) = found
        values = {group: array[sample] for group, array in inputs.items()}
        raise not_finite(name, float(inputs["t"][sample, 0]), cause(outputs[name], values))


def cause(entries: Sequence[Scalar], values: Mapping[str, Sequence[float]]) -> str:
    """Return in words the first operation, in the order of evaluation, without a finite value of finite arguments.

    Parameters
    ----------
    entries : expressions. values : of their symbols, by group.
    """
    value: dict[int, Any] = {}
    for node in reachable(list(entries)):
        if node.op == "sym":
            _, group, position = node.value
            value[node.index] = np.atleast_1d(values[group][position])
            continue
        given = [value[a.index] for a in node.args]
        with np.errstate(all="ignore"):
            value[node.index] = np.atleast_1d(node.value if node.op == "const" else apply(node, given))
        if not np.isfinite(value[node.index][0]) and all(np.isfinite(x[0]) for x in given):
            return _operation(node, [float(x[0]) for x in given])
    return CONSTANT


def _operation(node: Expr, given: Sequence[float]) -> str:
    numbers = [f"{x:.6g}" for x in given]
    if node.op == "const":
        return CONSTANT
    sign = SIGNS.get(node.op)
    text = f"{node.op}({', '.join(numbers)})" if sign is None else f" {sign} ".join(numbers)
    undefined = (node.op == "div" and given[1] == 0.0) or node.op in ("sqrt", "log", "asin", "acos", "pow")
    return f"{text} has no value" if undefined else f"{text} exceeds what a double holds (1.8e308)"


def refuse_result(result: Result) -> None:
    """Refuse a result in which a number of a dataset or of the summary is not finite.

    Raises
    ------
    NumericalError : names dataset, column and time, or the key.
    """
    found = first_fault({path: item.data for path, item in result.variables.items()})
    if found is not None:
        path, at = found
        item = result.variables[path]
        time = float(result.time[at[0]]) if item.dims[0] == "time" else float(result.time[0])
        column = f" of {item.names[at[-1]]!r}" if item.names else ""
        raise not_finite(path, time, TOO_LARGE, column)
    key = _not_finite(result.summary)
    if key is not None:
        raise NumericalError(
            f"{key} in the summary is not finite: {TOO_LARGE}",
            key=key, status="not_finite",
        )  # fmt: skip


def _not_finite(value: Any, key: str = "") -> str | None:
    """Return the dotted key of the first number that is not finite."""
    if isinstance(value, float):
        return None if np.isfinite(value) else key
    if isinstance(value, Mapping):
        entries = value.items()
    elif isinstance(value, (list, tuple)):
        entries = {str(k): x for k, x in enumerate(value)}.items()
    else:
        return None
    found = (_not_finite(x, f"{key}.{name}" if key else str(name)) for name, x in entries)
    return next((x for x in found if x is not None), None)


def not_finite(path: str, time: float, why: str, column: str = "") -> NumericalError:
    """Return the error that names a dataset, the time [s] and why a number of it is not finite."""
    message = f"{path}{column} is not finite at t = {time:.9g} s: {why}"
    return NumericalError(message, dataset=path, time=time, status="not_finite")

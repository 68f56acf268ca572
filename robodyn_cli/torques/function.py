"""Expressions of a state as compiled functions: of one state, or of many, a row each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.linear.residuals import LAMBDA
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

# symbol groups of the arrays that functions take
GROUPS = {"q": "q", "qd": "v", "qdd": "a", "tau": "tau", LAMBDA: LAMBDA}
OUT = "out"  # the output of a kernel
LINE = 8  # numbers in a line of the cache, or in the widest vector


@record
class Arguments:
    """The arrays that a function takes: for each the names of its columns."""

    columns: Mapping[str, tuple[str, ...]]

    @staticmethod
    def of(problem: Problem, names: Sequence[str]) -> Arguments:
        """Return the arguments ``names``, of ``q``, ``qd``, ``qdd``, ``tau`` and ``lam``, the multipliers."""
        others = {"q": problem.model.q_names}
        if LAMBDA in names:
            others[LAMBDA] = problem.constraints.names
        return Arguments({name: others.get(name, problem.model.v_names) for name in names})

    def rows(self, arrays: Sequence[Any]) -> tuple[dict[str, Array], bool]:
        """Return arrays (T, n) by name, and whether one state was given, as arrays (n,).

        Raises
        ------
        CapabilityError : what is no array of real numbers, an array without exactly one column per joint (further
        columns would be ignored silently), or arrays of different lengths.
        """
        found = {name: _real(name, array) for name, array in zip(self.columns, arrays)}
        for name, array in found.items():
            joints = self.columns[name]
            if array.ndim not in (1, 2) or array.shape[-1] != len(joints):
                raise CapabilityError(
                    f"{name} has shape {array.shape}; needed: (samples, {len(joints)}), a row for each sample and a "
                    f"column for each of {', '.join(joints)}, or ({len(joints)},) for one state"
                )
        shapes = {name: array.shape[:-1] for name, array in found.items()}
        if len(set(shapes.values())) > 1:
            listed = ", ".join(f"{name} {array.shape}" for name, array in found.items())
            raise CapabilityError(f"arrays of different lengths: {listed}; needed: as many rows of each")
        one = () in shapes.values()
        return {n: array[None] if one else np.asfortranarray(array) for n, array in found.items()}, one


def _real(name: str, array: Any) -> Array:
    """Return what is given for an argument as an array of doubles.

    Raises
    ------
    CapabilityError : it is none of real numbers.
    """
    try:
        found = np.asarray(array)
        if found.dtype.kind in "fiub":
            return found.astype(float, copy=False)
    except ValueError:  # rows of different lengths
        pass
    raise CapabilityError(f"{name} is {array!r:.60}; needed: an array of real numbers")


class StateFunction:
    """Named arrays of expressions as a compiled function of states.

    Parameters
    ----------
    names : what it takes, of ``q``, ``qd``, ``qdd`` and ``tau``. outputs : arrays of expressions, of any shape.

    Calling it takes arrays (T, n), or (n,) for one state, and returns {output: (T, *shape)}, or {output: shape}.
    Results are column-ordered: the samples of each entry lie next to each other. Arrays with ``order="F"`` do too,
    and are read in place.

    Raises
    ------
    CapabilityError : the outputs depend on time. SceneError : on data that the scene does not give.
    """

    def __init__(self, problem: Problem, names: Sequence[str], outputs: Mapping[str, Any]) -> None:
        from robodyn_cli.kernels.samples import SampleKernel

        entries = {name: np.asarray(array, dtype=object) for name, array in outputs.items()}
        if any(symbol is problem.t for a in entries.values() for symbol in free_symbols(a.flat)):
            raise CapabilityError(
                "a point that moves by a formula of t has no place at a state; allowed: points fixed to links"
            )
        self.arguments = Arguments.of(problem, names)
        self.shapes = {name: array.shape for name, array in entries.items()}
        known = [GROUPS[name] for name in names]
        # a program for each: compiling takes more than twice as long for one that is twice as long
        self.kernels = {name: SampleKernel({OUT: list(a.flat)}, known) for name, a in entries.items()}

    def __call__(self, *arrays: Any) -> dict[str, Array]:
        rows, one = self.arguments.rows(arrays)
        return {name: a[0] if one else a for name, a in self.evaluate(rows).items()}

    def evaluate(self, rows: Mapping[str, Array]) -> dict[str, Array]:
        """Return {output: (T, *shape)} of arrays (T, n) by name.

        All outputs lie in one block of memory. Several large arrays the allocator would give back to the system, to
        take them anew at the next call; a page touched for the first time costs more than what is written to it.
        """
        groups = {GROUPS[name]: array for name, array in rows.items()}
        samples = len(next(iter(rows.values())))
        sizes = [math.prod(shape) for shape in self.shapes.values()]
        padded = max(samples, *(kernel.lanes for kernel in self.kernels.values()))
        parts = np.split(_block(padded, sum(sizes)), np.cumsum(sizes)[:-1], axis=1)
        found: dict[str, Array] = {}
        for (name, kernel), part in zip(self.kernels.items(), parts):
            out = kernel.evaluate(samples, groups, {OUT: part})[OUT]
            found[name] = out.reshape(samples, *self.shapes[name])
        return found


def _block(rows: int, columns: int) -> Array:
    """Return an empty column-ordered array that begins with a line of the cache: vectors then fill whole lines."""
    memory = np.empty(rows * columns + LINE)
    first = -(memory.ctypes.data // memory.itemsize) % LINE
    return memory[first : first + rows * columns].reshape(columns, rows).T

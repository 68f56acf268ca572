"""Evaluate expressions at many samples: interpreted where that takes less time than compiling, else compiled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.graph import Expr, Scalar, count_operations, free_symbols
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.kernels.program import unknown_data

Array = NDArray[np.float64]
Outputs = Mapping[str, Sequence[Scalar]]

# measured: a numpy operation costs about 2 us and 4 ns a sample, compiling 35 ms (half of it the import) and 80 us
# an operation; a compiled operation is too cheap to count
_CALL, _ENTRY = 2e-6, 4e-9
_COMPILER, _OPERATION = 35e-3, 80e-6
BLOCK = 2048  # samples interpreted at a time, so that the intermediate results stay in the cache


class SampleFunction:
    """Named expressions as a function of samples.

    Parameters
    ----------
    outputs : arrays of expressions by name. known : symbol groups that calls will give.
    samples : how many samples are expected in all, which decides whether to compile.

    Raises
    ------
    SceneError : the outputs depend on data that the scene does not give.
    """

    def __init__(self, outputs: Outputs, known: Sequence[str], samples: int) -> None:
        self.outputs = {name: list(entries) for name, entries in outputs.items()}
        entries = [e for array in self.outputs.values() for e in array]
        missing = [s.value[0] for s in free_symbols(entries) if s.value[1] not in known]
        if missing:
            raise unknown_data(missing)
        self.operations = count_operations(entries)
        interpreting = self.operations * (_CALL + _ENTRY * samples)
        self.compiled = interpreting > _COMPILER + _OPERATION * self.operations
        if self.compiled:
            from robodyn_cli.kernels.samples import SampleKernel

            # constants need no kernel
            varying = {n: a for n, a in self.outputs.items() if any(isinstance(e, Expr) for e in a)}
            self._kernel = SampleKernel(varying, known)

    def __call__(self, **groups: Array) -> dict[str, Array]:
        """Return {output: (T, n)} in column order, from arrays (T, n) by symbol group."""
        samples = len(next(iter(groups.values())))
        out = {name: np.empty((samples, len(a)), order="F") for name, a in self.outputs.items()}
        if self.compiled:
            out.update(self._kernel(**groups))
            for name, entries in self.outputs.items():
                if not any(isinstance(e, Expr) for e in entries):
                    out[name][:] = entries
            return out
        flat = [e for entries in self.outputs.values() for e in entries]
        for start in range(0, samples, BLOCK):
            part = slice(start, min(start + BLOCK, samples))
            values = iter(evaluate(flat, {group: array[part].T for group, array in groups.items()}))
            for name, entries in self.outputs.items():
                for k in range(len(entries)):
                    out[name][part, k] = next(values)
        return out

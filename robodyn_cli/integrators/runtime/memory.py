"""The whole state of a run in one block of memory: going back to an earlier moment is one copy."""

from __future__ import annotations

from typing import cast

import numpy as np

from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot
from robodyn_cli.kernels.arrays import aligned_zeros
from robodyn_cli.spatial.algebra import Array

ROW = 8  # doubles; each part starts where a vector may


class Memory:
    """The arrays that the compiled loop works on, in one block, and room for a copy of it.

    w, n : see ``DoubleSlot`` and ``IntegerSlot``, as memoryviews, which single numbers enter and leave faster than
    arrays. armed : the values of event functions, which follow the slots in w. y : the state. dense : what dense output
    keeps. addresses : where w, n, y and dense lie; the block starts with ``w``. saved_w, saved_n : w and n of the copy.
    """

    def __init__(self, events: int, size: int, dense: int) -> None:
        counts = (DoubleSlot.SIZE + max(1, events), IntegerSlot.SIZE, size, max(1, dense))
        starts = [0]
        for count in counts:
            starts.append(starts[-1] + -(-count // ROW) * ROW)
        self.block, self.saved = aligned_zeros(starts[-1]), aligned_zeros(starts[-1])
        w, n, self.y, self.dense = (self.block[a : a + count] for a, count in zip(starts, counts))
        self.w, self.n, self.armed = _doubles(w), _integers(n), w[DoubleSlot.SIZE :]
        self.saved_w, self.saved_n = _doubles(self.saved), _integers(self.saved[starts[1] :])
        self.addresses = tuple(self.block.ctypes.data + 8 * first for first in starts[:-1])
        self.nbytes = self.block.nbytes

    def clear(self) -> None:
        self.block.fill(0.0)


def _doubles(x: Array) -> memoryview[float]:
    return cast("memoryview[float]", x.data)


def _integers(x: Array) -> memoryview[int]:
    return x.view(np.int64).data

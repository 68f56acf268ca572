"""What a run is, in one block of memory: going back to a moment of it is one copy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.integrators.layout import Real, Whole
from robodyn_cli.kernels.arrays import aligned_zeros

ROW = 8  # doubles; each part starts where a vector may


class Memory:
    """The arrays that the compiled loop works on, in one block.

    w, n : see ``Real`` (the values of event functions follow) and ``Whole``. y : the state. dense : what dense
    output keeps. addresses : where these four lie; the block starts with ``w``.
    """

    def __init__(self, events: int, size: int, dense: int) -> None:
        counts = (Real.SIZE + max(1, events), Whole.SIZE, size, max(1, dense))
        starts = [0]
        for count in counts:
            starts.append(starts[-1] + -(-count // ROW) * ROW)
        self.block = aligned_zeros(starts[-1])
        parts = [self.block[first : first + count] for first, count in zip(starts, counts)]
        self.w, _, self.y, self.dense = parts
        self.n: NDArray[np.int64] = parts[1].view(np.int64)
        base = self.block.ctypes.data
        self.addresses = tuple(base + 8 * first for first in starts[:-1])
        self.nbytes = self.block.nbytes

    def clear(self) -> None:
        self.block.fill(0.0)

"""Samples of a run, from the compiled loop, which writes them into a block, to whoever takes them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn_cli.integrators.runtime.engine import Engine
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.runtime.options import Samples, StretchedGrid
from robodyn_cli.spatial.algebra import Array


class SampleBlocks:
    """Hands on samples at the times of a grid, each once and in order, at most ``block`` at a time.

    The loop counts uniform samples of one stretch, from 0. The one behind them finds no room, so that the run comes
    back to be set on the next stretch.
    """

    def __init__(
        self, engine: Engine, grid: Samples, emit: Callable[[Array, Array], None], block: int
    ) -> None:
        self.engine, self.grid, self.emit = engine, grid, emit
        self.size, self.capacity = len(engine.memory.y), max(1, min(block, grid.at_once))
        if len(engine.out) != self.capacity * self.size:
            engine.make_room(self.capacity * self.size)
        engine.memory.n[IntegerSlot.CAPACITY] = self.capacity

    def begin(self, time: float) -> None:
        """Begin at a time, with a sample that lies there."""
        first = self.grid.first_at(time)
        if first < self.grid.count and self.grid.begins_by(first, time):
            self.emit(np.array([time]), self.engine.memory.y[None].copy())
            first += 1
        self._aim(first)

    def _aim(self, k: int) -> None:
        """Set the loop, and what it may go back to, on sample k, with the rows that are left for its stretch."""
        start, step, self.first, last = self.grid.stretch(k)
        self.row = k - self.first if isinstance(self.grid, StretchedGrid) else 0
        memory = self.engine.memory
        for w, n in ((memory.w, memory.n), (memory.saved_w, memory.saved_n)):
            w[DoubleSlot.SAMPLE_START], w[DoubleSlot.SAMPLE_STEP] = start, step
            n[IntegerSlot.NEXT_SAMPLE], n[IntegerSlot.LAST_SAMPLE] = k - self.first, last - self.first
            n[IntegerSlot.ROWS] = self.row

    @property
    def next(self) -> int:
        """The next sample."""
        return self.first + self.engine.memory.n[IntegerSlot.NEXT_SAMPLE]

    @property
    def last(self) -> int:
        """The last sample of the stretch, as the loop counts them."""
        return self.grid.stretch(self.next)[3] - self.first

    def lies_at(self, time: float) -> bool:
        """Tell whether the next sample lies at or before a time, but for rounding."""
        return self.next < self.grid.count and self.grid.begins_by(self.next, time)

    def flush(self) -> None:
        """Hand on what has been written."""
        end = self.engine.memory.n[IntegerSlot.ROWS]
        if end > self.row:
            last = self.next
            rows = self.engine.out.reshape(self.size, self.capacity)[:, self.row : end]
            self.emit(self.grid.times(last - end + self.row, last), rows.T.copy())
            self._aim(last)

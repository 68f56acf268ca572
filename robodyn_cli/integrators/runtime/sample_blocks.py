"""Samples of a run, from the compiled loop, which writes them into a block, to whoever takes them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn_cli.integrators.runtime.engine import Engine
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.spatial.algebra import Array


class SampleBlocks:
    """Hands on samples at the times of a grid from ``time`` on, each once and in order, some ``block`` at a time.

    Between knots the loop counts the samples from one of them, from 0, and finds no room for the next one, so that the
    run comes back to be set on what follows; those are handed on when there are many, or by ``hand_on``. first : sample
    that it counts as 0. row : of the first one in the block.
    """

    def __init__(
        self, engine: Engine, grid: Grid, emit: Callable[[Array, Array], None], block: int, time: float
    ) -> None:
        self.engine, self.grid, self.emit, self.size = engine, grid, emit, len(engine.memory.y)
        self.knots = [] if grid.knots is None else grid.knots.tolist()
        self.inside = (grid.count - 1) // (len(self.knots) - 1) if self.knots else 0
        # those between knots are many in few blocks each
        self.times = grid.times(0, grid.count) if self.knots else None
        self.waiting: list[Array] = []
        self.block, self.handed = block, 0
        self.capacity = self.inside or max(1, min(block, grid.count))
        if len(engine.out) < self.capacity * self.size:
            engine.make_room(self.capacity * self.size)
        engine.memory.n[IntegerSlot.CAPACITY] = self.capacity
        first = grid.first_at(time)
        if first < grid.count and grid.begins_by(first, time):
            emit(np.array([time]), engine.memory.y[None].copy())
            first += 1
        self.first, self.row, self.handed = first, -1, first
        engine.memory.n[IntegerSlot.ROWS] = engine.memory.n[IntegerSlot.NEXT_SAMPLE] = 0
        self.flush()

    def flush(self) -> None:
        """Hand on what has been written, and set the loop, and what it may go back to, on the next sample."""
        n = self.engine.memory.n
        end, k = n[IntegerSlot.ROWS], self.first + n[IntegerSlot.NEXT_SAMPLE]
        if end <= self.row:
            return
        if end:
            block = self.engine.out[: self.size * self.capacity].reshape(self.size, self.capacity)
            rows = block[:, self.row : end].T.copy()
            if self.times is None:
                self.emit(self.grid.times(k - end + self.row, k), rows)
            else:
                self.waiting.append(rows)
                if k - self.handed >= self.block:
                    self.hand_on()
        grid, inside, memory = self.grid, self.inside, self.engine.memory
        start, step, last = grid.start, grid.step, grid.count - 1
        self.first, self.row = int(grid.head is not None), 0
        if self.knots:
            j = min(k // inside, len(self.knots) - 1)
            self.first = j * inside
            self.row, last = k - self.first, min(self.first + inside, last)
            start = self.knots[j]
            step = (self.knots[min(j + 1, len(self.knots) - 1)] - start) / inside
        for w, n in ((memory.w, memory.n), (memory.saved_w, memory.saved_n)):
            w[DoubleSlot.SAMPLE_START], w[DoubleSlot.SAMPLE_STEP] = start, step
            n[IntegerSlot.NEXT_SAMPLE], n[IntegerSlot.LAST_SAMPLE] = k - self.first, last - self.first
            n[IntegerSlot.ROWS] = self.row

    def hand_on(self) -> None:
        """Hand on what waits for more."""
        if self.times is not None and self.waiting:
            rows, self.waiting = np.concatenate(self.waiting), []
            first, self.handed = self.handed, self.handed + len(rows)
            self.emit(self.times[first : self.handed], rows)

    @property
    def last(self) -> int:
        """The last sample up to which the loop writes now, as it counts them."""
        last = self.grid.count - 1
        return (min(self.first + self.inside, last) if self.inside else last) - self.first

    def lies_at(self, time: float) -> bool:
        """Tell whether the next sample lies at or before a time, but for rounding."""
        k = self.first + self.engine.memory.n[IntegerSlot.NEXT_SAMPLE]
        return k < self.grid.count and self.grid.begins_by(k, time)

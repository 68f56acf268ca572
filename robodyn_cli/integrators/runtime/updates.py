"""Python's side of updates at known instants: their block of memory, and the call of a function in Python."""

from __future__ import annotations

import ctypes

import numpy as np

from robodyn_cli.formulations.updates import Updates
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Memory
from robodyn_cli.kernels.arrays import aligned_zeros

CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int64)


class UpdateSlot:
    """Slots of the block of updates; measured q and v follow, then the torques of a function in Python, then noise."""

    PERIOD = 0
    REST = 1
    FUNCTION = 2  # its address, an integer
    TIME = 3  # for the function
    SIZE = 4


class UpdateMemory:
    """The block that compiled code reads at updates (see ``UpdateSlot``), and what a function in Python raised."""

    def __init__(self, updates: Updates, positions: int, velocities: int) -> None:
        self.updates = updates
        seen, driven = positions + velocities, len(updates.joints)
        first = UpdateSlot.SIZE + seen + driven
        self.block = aligned_zeros(first + updates.noise.size)
        self.block[first:] = updates.noise.ravel()
        self.block[UpdateSlot.PERIOD], self.block[UpdateSlot.REST] = updates.period, updates.rest
        measured = self.block[UpdateSlot.SIZE : UpdateSlot.SIZE + seen]
        self._q, self._v = measured[:positions], measured[positions:]
        self._asked = self.block[first - driven : first]
        self.failure: BaseException | None = None
        if updates.function is not None:
            self._callback = CALLBACK(self._call)
            address = ctypes.cast(self._callback, ctypes.c_void_p).value
            self.block.view(np.int64)[UpdateSlot.FUNCTION] = address or 0

    def _call(self) -> int:
        """Call the function with what was measured; 1 where it raised."""
        updates, time = self.updates, float(self.block[UpdateSlot.TIME])
        try:
            assert updates.function is not None
            self._asked[:] = updates.function(time, self._q.copy(), self._v.copy())
        except BaseException as error:  # compiled code lies between here and who can handle it
            self.failure = error
            return 1
        return 0

    def begin(self, memory: Memory, time: float) -> None:
        """Note in the memory of a run that begins at ``time`` [s] which update comes first."""
        n, w = memory.n, memory.w
        n[IntegerSlot.UPDATES], n[IntegerSlot.PHASE], w[DoubleSlot.NEXT_UPDATE] = self.updates.after(time)

    def within(self, time: float) -> float:
        """Return how many updates there are within a time [s], and so at least how many steps."""
        return time / self.updates.period

    def raise_failure(self) -> None:
        """Raise what the function has raised."""
        failure, self.failure = self.failure, None
        if failure is not None:
            raise failure

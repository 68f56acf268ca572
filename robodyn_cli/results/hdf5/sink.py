"""The file below HDF5: it keeps failures and interrupts from the library and reports them to the writer."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any


class Sink:
    """A file for HDF5's file-object driver.

    HDF5 cannot close a file whose writes have failed: on a full disk it crashes the process. So the first
    failure is kept in ``error`` and what follows goes to memory, until the writer asks and gives up; that is
    little, since it asks after every block. Interrupts wait outside (``atomic.uninterrupted``): one that is raised
    between two statements here would reach the library.
    """

    def __init__(self, path: Path) -> None:
        self._file = open(path, "x+b", buffering=0)  # noqa: SIM115 - closed by close()
        self._patches: list[tuple[int, bytes]] = []
        self._position = 0
        self._end = 0
        self.error: BaseException | None = None

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to ``offset``."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._end}[whence]
        self._position = start + offset
        return self._position

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def write(self, data: Any) -> int:
        """Write all of ``data`` at the position."""
        view = memoryview(data).cast("B")
        if self.error is None:
            try:
                self._file.seek(self._position)
                done = 0
                while done < len(view):
                    done += self._file.write(view[done:])
            except BaseException as error:
                self.error = error
        if self.error is not None:
            self._patches.append((self._position, bytes(view)))
        self._position += len(view)
        self._end = max(self._end, self._position)
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """Fill ``buffer`` from the position; beyond the end there are zeros."""
        view = memoryview(buffer).cast("B")
        view[:] = bytes(len(view))
        try:
            self._file.seek(self._position)
            self._file.readinto(view)
        except BaseException as error:
            self.error = self.error or error
        for offset, patch in self._patches:
            first, last = max(offset, self._position), min(offset + len(patch), self._position + len(view))
            if first < last:
                view[first - self._position : last - self._position] = patch[first - offset : last - offset]
        self._position += len(view)
        return len(view)

    def truncate(self, size: int) -> int:
        """Set the length of the file."""
        self._end = size
        if self.error is None:
            try:
                self._file.truncate(size)
            except BaseException as error:
                self.error = error
        return size

    def flush(self) -> None:
        """Do nothing: writes are not buffered, and ``close`` syncs."""

    def check(self) -> None:
        """Raise the first failure, if there was one."""
        if self.error is not None:
            raise self.error

    def close(self, sync: bool) -> None:
        """Close the file, after bringing it to the disk if ``sync``."""
        try:
            if sync:
                os.fsync(self._file.fileno())
        finally:
            self._file.close()

"""An exclusive lock on a directory, released when the process that holds it ends in any way."""

from __future__ import annotations

import errno
import os
import stat
import sys
from pathlib import Path

from robodyn_cli.errors import DirectoryInUseError

LOCK_NAME = ".lock"
# Some network file systems have no locks; a run there is better than none.
_UNSUPPORTED = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL}

if sys.platform == "win32":
    import msvcrt

    # A lock on Windows hides the locked bytes from others, so it lies behind the process number.
    _OFFSET = 1 << 30

    def _take(descriptor: int) -> None:
        os.lseek(descriptor, _OFFSET, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

    def _drop(descriptor: int) -> None:
        os.lseek(descriptor, _OFFSET, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)

else:
    import fcntl

    def _take(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _drop(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


class DirectoryLock:
    """Holds ``DIR/.lock``. The file stays behind: removing it would let two runs lock two different files.

    warning : what users are to be told, where the file system has no locks.
    """

    def __init__(self, directory: Path) -> None:
        """Take the lock; raises DirectoryInUseError if another run holds it."""
        self.warning: str | None = None
        # no link is followed: its target would be truncated to the process number
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        self._descriptor: int | None = os.open(directory / LOCK_NAME, flags, 0o666)
        if not stat.S_ISREG(os.fstat(self._descriptor).st_mode):
            self.release()
            raise OSError(errno.EINVAL, "not a regular file", str(directory / LOCK_NAME))
        try:
            _take(self._descriptor)
        except OSError as error:
            if error.errno in _UNSUPPORTED:
                self.warning = f"{directory}: this file system has no locks; run one robodyn here at a time"
                return
            holder = self._holder()
            os.close(self._descriptor)
            self._descriptor = None
            if error.errno not in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
                raise
            raise DirectoryInUseError(
                f"{directory} is in use by another run{holder}; wait for it or choose another --out",
                path=str(directory),
            ) from None
        os.ftruncate(self._descriptor, 0)
        os.write(self._descriptor, f"{os.getpid()}\n".encode())

    def release(self) -> None:
        """Give the lock back."""
        if self._descriptor is not None:
            try:
                _drop(self._descriptor)
            except OSError:
                pass
            finally:
                os.close(self._descriptor)
                self._descriptor = None

    def _holder(self) -> str:
        assert self._descriptor is not None
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        text = os.read(self._descriptor, 32).decode(errors="replace").strip()
        return f" (process {text})" if text.isdigit() else ""

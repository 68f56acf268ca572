"""Run an action in a process of its own: the HDF5 library may crash on a damaged file, or loop forever."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

# time between two checks whether the process has ended
_POLL = 0.001


def survive(action: Callable[[], object], seconds: float) -> None:
    """Return if the process that does ``action`` ends by itself within a time; errors that it raises do not count.

    Where processes cannot be forked (Windows) nothing is tried.

    Raises
    ------
    TimeoutError : it did not end.
    RuntimeError : it crashed.
    """
    if not hasattr(os, "fork"):
        return
    process = os.fork()
    if process == 0:
        try:
            # its last output is no message for the user
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            # where this process is killed nobody else ends that one
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(int(seconds) + 2)
            action()
        finally:
            os._exit(0)
    status = _wait(process, time.monotonic() + seconds)
    if status is None:
        raise TimeoutError(f"reading it does not end within {seconds:.0f} s: it is damaged")
    if os.WIFSIGNALED(status):
        raise RuntimeError(f"the HDF5 library crashes on it ({signal.Signals(os.WTERMSIG(status)).name})")


def _wait(process: int, end: float) -> int | None:
    """Return the status with which a process ended; None, and the process is killed, if it did not in time."""
    ended = False
    try:
        while time.monotonic() < end:
            found, status = os.waitpid(process, os.WNOHANG)
            if found:
                ended = True
                return status
            time.sleep(_POLL)
        return None
    finally:
        if not ended:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)

"""Files and texts of others: what is opened, what terminals and spreadsheets are shown, which files names stand for,
which their libraries survive."""

from __future__ import annotations

import errno
import os
import re
import signal
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

# what a terminal obeys, or what changes the order of letters: all control characters but tab and end of line, the marks
# of direction, separators of lines, letters without width that join none, surrogates
_OBEYED = re.compile(
    "[\0-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb]"
)
_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # that a spreadsheet computes


def opened(path: str | Path) -> BinaryIO:
    """Return a file that is open for reading.

    Raises
    ------
    OSError : it cannot be opened, or is a directory, a pipe or a device, which may never end.
    """
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "it is a directory; allowed: a file")
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device, which may never end; allowed: a file")
    return open(path, "rb")


def contents(path: str | Path, most: int) -> bytes:
    """Return the bytes of a file.

    Raises
    ------
    OSError : as ``opened``, or there are more than ``most``.
    """
    with opened(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"it is larger than {most // 1_000_000} MB")
    return data


def printable(text: str) -> str:
    r"""Return a text, or JSON, that a terminal only shows: what it would obey stands as ``\u001b``."""
    return _OBEYED.sub(lambda letter: f"\\u{ord(letter.group()):04x}", text)


def spreadsheet_cell(text: str) -> str:
    """Return a text that a spreadsheet takes for no formula."""
    return f"'{text}" if text.startswith(_FORMULA) else text


# names that no file has on Windows, whatever its suffix
DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(1, 10))}


def file_stem(name: str) -> str:
    """Return a name as that of a file, in whatever directory it is put."""
    stem = re.sub(r"[^\w.-]", "_", name).lstrip(".") or "_"
    return f"_{stem}" if stem.partition(".")[0].casefold() in DEVICES else stem


_POLL = 0.001  # seconds between two checks whether a process has ended


def survive(action: Callable[[], object], seconds: float, library: str) -> None:
    """Return if the process that does ``action`` ends by itself within a time; errors that it raises do not count.

    ``library`` : of others, which may crash on a damaged file or loop forever.

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
        raise RuntimeError(f"{library} crashes on it ({signal.Signals(os.WTERMSIG(status)).name})")


def _wait(process: int, end: float) -> int | None:
    """Return the status with which a process ended; None, and the process is killed, if it did not in time."""
    ended = False
    try:
        while time.monotonic() < end:
            pid, status = os.waitpid(process, os.WNOHANG)
            if pid:
                ended = True
                return status
            time.sleep(_POLL)
        return None
    finally:
        if not ended:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)

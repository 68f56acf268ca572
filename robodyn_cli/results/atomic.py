"""Files that appear whole or not at all, and the lock of a directory that one process writes into."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import signal
import stat
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

from robodyn_cli.errors import DirectoryInUseError, OutputError

SUFFIX = ".robodyn-tmp"


def temporary_path(target: Path) -> Path:
    """Return an unused name in the directory of ``target`` (a rename must not cross file systems)."""
    return target.with_name(f".{target.name}.{os.getpid():x}-{os.urandom(4).hex()}{SUFFIX}")


def is_temporary(path: Path) -> bool:
    """Tell whether ``path`` is a name that ``temporary_path`` made."""
    return path.name.startswith(".") and path.name.endswith(SUFFIX)


def output_error(path: Path, error: BaseException) -> OutputError:
    """Turn a failure of the operating system into an OutputError that names the path."""
    reason = getattr(error, "strerror", None) or str(error)
    # HDF5 wraps the system's own words in a paragraph.
    if words := re.search(r"error message = '([^']+)'", reason):
        reason = words[1]
    return OutputError(f"cannot write {path}: {reason}", path=str(path))


@contextlib.contextmanager
def output_errors(path: Path, *kinds: type[Exception]) -> Iterator[None]:
    """Raise OutputError naming ``path`` where the block raises OSError or one of ``kinds``."""
    try:
        yield
    except Exception as error:
        if not isinstance(error, (OSError, *kinds)):
            raise
        raise output_error(path, error) from error


def anew(path: Path) -> TextIO:
    """Return an empty text file of our own, to which lines are added."""
    return open(path, "w", encoding="utf-8")


def publish(temporary: Path, target: Path) -> None:
    """Sync ``temporary`` to the disk and rename it to ``target``, replacing what is there."""
    # Without the sync, a power cut after the rename can leave an empty file under the final name.
    descriptor = os.open(temporary, os.O_RDWR | getattr(os, "O_BINARY", 0))
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    os.replace(temporary, target)


def discard(path: Path) -> None:
    """Remove ``path`` if it is there; a failure to do so must not hide the error that led here."""
    with contextlib.suppress(OSError):
        path.unlink()


def write_bytes(target: Path, content: bytes) -> None:
    """Write ``content`` to ``target`` atomically."""
    temporary = temporary_path(target)
    with output_errors(target):
        try:
            temporary.write_bytes(content)
            publish(temporary, target)
        except BaseException:
            discard(temporary)
            raise


def write_new(target: Path, text: str) -> None:
    """Write a text file atomically, never over another one.

    Raises
    ------
    OutputError : there is a file of that name, or it cannot be written.
    """
    taken = OutputError(f"{target} exists already; choose another name, or remove it")
    if os.path.lexists(target):
        raise taken
    temporary = temporary_path(target)
    with output_errors(target):
        try:
            temporary.write_text(text, encoding="utf-8")
            _appear(temporary, target)
        except FileExistsError:
            raise taken from None
        finally:
            discard(temporary)


def _appear(temporary: Path, target: Path) -> None:
    """Give a file its name; unlike a rename, this replaces nothing.

    Raises
    ------
    FileExistsError : there is a file of that name.
    """
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without links, as on memory sticks
        with open(target, "xb") as file:
            file.write(temporary.read_bytes())


def write_alike(texts: Mapping[Path, str]) -> None:
    """Write text files, never over other ones: those that are there with the same text stay.

    Raises
    ------
    OutputError : there is another file of such a name (then nothing is written), or one cannot be written.
    """
    missing = {path: text for path, text in texts.items() if not _holds(path, text)}
    if taken := next(filter(os.path.lexists, missing), None):
        raise OutputError(f"{taken} exists already and is another file; choose another folder, or remove it")
    for path, text in missing.items():
        with output_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_new(path, text)


def _holds(path: Path, text: str) -> bool:
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return path.is_file() and path.read_text(encoding="utf-8") == text
    return False


@contextlib.contextmanager
def written(target: Path) -> Iterator[Path]:
    """Give a name to write to; what is there when the block ends becomes ``target``, and nothing if it fails.

    Raises
    ------
    OutputError : it cannot be written.
    """
    temporary = temporary_path(target)
    with output_errors(target):
        try:
            yield temporary
            os.replace(temporary, target)
        except BaseException:
            discard(temporary)
            raise


def written_folder(target: Path, contents: Mapping[str, str | bytes]) -> None:
    """Put files into a folder at once: a new folder is renamed when it is whole; in one that is there already
    files of these names are replaced when all new ones are written.

    Raises
    ------
    OutputError : it cannot be written.
    """
    there = target.exists()
    stage = temporary_path(target / "new" if there else Path(os.path.abspath(target)))
    with output_errors(target):
        try:
            stage.parent.mkdir(parents=True, exist_ok=True)
            stage.mkdir()
            for name, content in contents.items():
                if isinstance(content, str):
                    (stage / name).write_text(content, encoding="utf-8")
                else:
                    (stage / name).write_bytes(content)
            with uninterrupted():
                if not there:
                    os.replace(stage, target)
                    return
                for name in contents:
                    publish(stage / name, target / name)
        finally:
            shutil.rmtree(stage, ignore_errors=True)


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Put an interrupt (Ctrl-C) off until the block has ended.

    For what must not be left half done.
    HDF5 calls back into Python to write; an interrupt raised in there would reach the library as a failed write, and
    it would report that, or crash on closing the file. Only the main thread sees interrupts, so elsewhere, and where a
    program handles them in a way of its own that is no Python function, this does nothing.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    waiting: list[tuple[int, Any]] = []
    signal.signal(signal.SIGINT, lambda number, frame: waiting.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if waiting:
            before(*waiting[0])


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

"""Files that appear whole or not at all: write beside the target, sync, rename."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from robodyn_cli.errors import OutputError

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
    if found := re.search(r"error message = '([^']+)'", reason):
        reason = found[1]
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
            os.link(temporary, target)  # unlike a rename, it replaces nothing
        except FileExistsError:
            raise taken from None
        finally:
            discard(temporary)


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

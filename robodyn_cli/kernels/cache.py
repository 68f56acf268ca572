"""Compiled code kept on disk: only what this user wrote is used, and only for the key it was written for; a count of
compilations, which is read without loading LLVM; and the digest of the installed package, which is kept there too.

An object file is machine code that runs with the user's rights. So a directory or file that belongs to another user, or
that others may write, is left alone; links and special files are not followed; and each file starts with a digest of
its key and its code together, so a file that was damaged, swapped or brought from elsewhere is compiled anew.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
import stat
import time
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path

from robodyn_cli.errors import OutputError
from robodyn_cli.version import digest_of, files_below

# instructions of lasting code that take LLVM some seconds, in which no other thread of Python runs
MANY = 20_000

_seconds: ContextVar[float] = ContextVar("_seconds", default=0.0)


class CompileReport:
    """Seconds that this thread has spent, modules compiled, modules that came from the cache, and warnings, each once.

    ``now`` says in words what is being compiled, empty between compilations. ``listener``, where there is one, is told
    of a compilation that takes long before it begins.
    """

    def __init__(self) -> None:
        self.compiled = 0
        self.cached = 0
        self.now = ""
        self.listener: Callable[[str], None] | None = None
        self.warnings: list[str] = []

    @property
    def seconds(self) -> float:
        """Spent by this thread, so that times of stages of a run are its own."""
        return _seconds.get()

    def spend(self, seconds: float) -> None:
        """Add time that this thread has spent."""
        _seconds.set(_seconds.get() + seconds)

    def begin(self, instructions: int, quick: bool) -> None:
        """Note the compilation that begins, of code that is made quickly or is to last."""
        self.now = f"compiling {instructions} instructions"
        if instructions >= MANY and not quick and self.listener is not None:
            self.listener(f"robodyn: {self.now} takes a while; the code is kept for the next run")

    def warn(self, message: str) -> None:
        """Keep a warning for the report of the run."""
        if message not in self.warnings:
            self.warnings.append(message)


REPORT = CompileReport()


MOST_BYTES = 64 << 20  # kept in all; the oldest files go first
PARTIAL = ".part"
STALE = 3600.0  # age [s] from which on an unfinished file is left over from a process that was killed
DIGEST = 32  # bytes of SHA-256
SWEEPERS = "0"  # first digits of keys whose writing sweeps: one in sixteen, as a sweep looks at every file
PACKAGE = str(Path(__file__).resolve().parent.parent)
# age [ns] from which on a file that changes again has another time, on any file system
SETTLED = 2_000_000_000
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def cache_directory() -> Path | None:
    """Return where compiled code is kept, or None where nothing can be kept (``ROBODYN_CACHE`` = path or ``off``)."""
    setting = os.environ.get("ROBODYN_CACHE")
    if setting == "off":
        return None
    root = Path(setting) if setting else _default_root()
    try:
        root.mkdir(parents=True, exist_ok=True, mode=0o700)
        status = os.stat(root)
    except (OSError, RuntimeError, ValueError):
        return None
    if (why := _distrusted(status)) is not None:
        REPORT.warn(
            f"compiled code is not kept in {root}: {why}; set ROBODYN_CACHE to a directory of your own"
        )
        return None
    return root


def _default_root() -> Path:
    if platform.system() == "Windows":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "robodyn"
    if platform.system() == "Darwin":
        return Path.home() / "Library" / "Caches" / "robodyn"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robodyn"


def _distrusted(status: os.stat_result) -> str | None:
    """Return why a directory or file is not used, None where it is this user's own."""
    if os.name != "posix":
        return None
    if status.st_uid not in (os.geteuid(), 0):
        return "it belongs to another user"
    if status.st_mode & OTHERS_WRITE:
        return "other users may write there"
    return None


class ObjectFile:
    """One cached object: the file of a key, which need not exist.

    Parameters
    ----------
    key : digest of everything that decides the code, the processor and the version of robodyn included.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.key, self.path = key, folder / f"{key[:40]}.o"

    def read(self) -> bytes | None:
        """Return the code, if the file is whole, written for this key, and nobody else's."""
        flags = (
            os.O_RDONLY
            | getattr(os, "O_NOFOLLOW", 0)
            | getattr(os, "O_NONBLOCK", 0)
            | getattr(os, "O_BINARY", 0)
        )
        try:
            descriptor = os.open(self.path, flags)
        except OSError:
            return None
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or _distrusted(status) is not None:
            os.close(descriptor)
            return None
        with os.fdopen(descriptor, "rb") as stream:
            data = stream.read()
        code = data[DIGEST:]
        return code if code and data[:DIGEST] == self._digest(code) else None

    def write(self, code: bytes) -> None:
        """Keep an object; losing a race or having no space is no error."""
        import tempfile  # which a run that finds its code there does without

        with contextlib.suppress(OSError):
            handle, name = tempfile.mkstemp(dir=self.path.parent, suffix=PARTIAL)
            try:
                with os.fdopen(handle, "wb") as stream:
                    stream.write(self._digest(code) + code)
                os.replace(name, self.path)
            except BaseException:
                os.unlink(name)
                raise
            if self.key[0] in SWEEPERS:
                sweep(self.path.parent)

    def _digest(self, code: bytes) -> bytes:
        return hashlib.sha256(self.key.encode() + b"\0" + code).digest()


@functools.cache
def code_digest(root: str = PACKAGE) -> str:
    """Return the SHA-256 of all files of the installed package, names included, hexadecimal (see ``digest_of``).

    It is asked for when a result is written or compared, never at start-up, and kept beside compiled code: to look at
    the files takes a third of reading them. As in the index of git, a file is what it was while its size, times and
    place on the disk are; those that have just changed are read again.
    """
    now = time.time_ns()
    status = [(entry.path, entry.stat()) for entry in files_below(root)]
    known = [(path, s.st_size, s.st_mtime_ns, s.st_ctime_ns, s.st_ino, s.st_dev) for path, s in status]
    settled = all(now - max(s.st_mtime_ns, s.st_ctime_ns) > SETTLED for _, s in status)
    folder = cache_directory() if settled else None
    if folder is None:
        return digest_of(root)
    # no key that sweeps
    kept = ObjectFile(folder, f"files-{hashlib.sha256(repr(known).encode()).hexdigest()}")
    digest = kept.read()
    if digest is None:
        digest = digest_of(root).encode()
        kept.write(digest)
    return digest.decode()


def contents(folder: Path) -> list[tuple[Path, os.stat_result]]:
    """Return the objects in a cache with what is known of them, oldest first."""
    return sorted(_files(folder, ".o"), key=lambda pair: pair[1].st_mtime)


def _files(folder: Path, suffix: str) -> list[tuple[Path, os.stat_result]]:
    """Return the files with this ending."""
    found = []
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(suffix):
                with contextlib.suppress(OSError):
                    found.append((Path(entry.path), entry.stat(follow_symlinks=False)))
    return found


def remove_all(folder: Path) -> int:
    """Remove all objects and return how many; a run that uses one of them has it in memory.

    Raises
    ------
    OutputError : one cannot be removed.
    """
    objects = contents(folder)
    for path, _ in objects:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(f"cannot remove {path}: {error.strerror}") from error
    return len(objects)


def sweep(folder: Path, most_bytes: int | None = None) -> None:
    """Remove the oldest objects beyond ``most_bytes`` in all, and what processes that were killed left unfinished."""
    objects = contents(folder)
    excess = sum(status.st_size for _, status in objects) - (MOST_BYTES if most_bytes is None else most_bytes)
    for path, status in objects:
        if excess <= 0:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            excess -= status.st_size
    for path, status in _files(folder, PARTIAL):
        if time.time() - status.st_mtime > STALE:
            with contextlib.suppress(OSError):
                path.unlink()

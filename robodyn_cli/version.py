"""The version, and what tells two installations of one version apart; in one place that everything may import."""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Iterator

__version__ = "0.1.0"


@functools.cache
def code_digest() -> str:
    """Return the SHA-256 of all files of the installed package, names included, hexadecimal.

    The files are read once a process, when a result is written or compared (some 15 ms), never at start-up.
    """
    return digest_of(os.path.dirname(os.path.abspath(__file__)))


def digest_of(root: str) -> str:
    """Return the SHA-256 of the files below a folder and of their names in it, hexadecimal."""
    hasher = hashlib.sha256()
    for path in _files(root):
        with open(path, "rb", buffering=0) as stream:
            data = stream.read()
        name = os.path.relpath(path, root).replace(os.sep, "/")
        hasher.update(f"{name}\0{len(data)}\0".encode() + data)
    return hasher.hexdigest()


def _files(folder: str) -> Iterator[str]:
    """Yield the files of a folder and of those in it, in an order of their names alone, without bytecode."""
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        if entry.is_dir():
            if entry.name != "__pycache__":
                yield from _files(entry.path)
        else:
            yield entry.path

"""The version, and what tells two installations of one version apart; in one place that everything may import."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator

__version__ = "0.2.0"

# The address of the repository, which its owner writes here; the built package says none as long as it is "".
REPOSITORY = ""


def files_below(root: str) -> Iterator[os.DirEntry[str]]:
    """Yield the files below a folder, without bytecode, in an order that only names decide."""
    with os.scandir(root) as entries:
        found = sorted(entries, key=lambda entry: entry.name)
    yield from (entry for entry in found if not entry.is_dir())
    for entry in found:
        if entry.is_dir(follow_symlinks=False) and entry.name != "__pycache__":
            yield from files_below(entry.path)


def digest_of(root: str) -> str:
    """Return the SHA-256 of the files below a folder and of their names in it, without bytecode, hexadecimal."""
    hasher = hashlib.sha256()
    for entry in files_below(root):
        with open(entry.path, "rb", buffering=0) as stream:
            data = stream.read()
        name = entry.path[len(root) + 1 :].replace(os.sep, "/")
        hasher.update(f"{name}\0{len(data)}\0".encode() + data)
    return hasher.hexdigest()

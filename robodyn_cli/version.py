"""The version, and what tells two installations of one version apart; in one place that everything may import."""

from __future__ import annotations

import functools
import hashlib
import os

__version__ = "0.2.0"

# The address of the repository, which its owner writes here; the built package says none as long as it is "".
REPOSITORY = ""


@functools.cache
def code_digest() -> str:
    """Return the SHA-256 of all files of the installed package, names included, hexadecimal.

    The files are read once a process, when a result is written or compared (some 15 ms), never at start-up.
    """
    return digest_of(os.path.dirname(os.path.abspath(__file__)))


def digest_of(root: str) -> str:
    """Return the SHA-256 of the files below a folder and of their names in it, without bytecode, hexadecimal."""
    hasher = hashlib.sha256()
    for folder, folders, names in os.walk(root):
        folders[:] = sorted(set(folders) - {"__pycache__"})
        place = folder[len(root) + 1 :].replace(os.sep, "/")
        for name in sorted(names):
            with open(os.path.join(folder, name), "rb", buffering=0) as stream:
                data = stream.read()
            hasher.update(f"{f'{place}/' if place else ''}{name}\0{len(data)}\0".encode() + data)
    return hasher.hexdigest()

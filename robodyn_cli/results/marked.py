"""The marks by which drawings of ours are known, so that a run removes no file of anybody else."""

from __future__ import annotations

import os
from pathlib import Path

MARK = "robodyn"  # keyword "Software" of a PNG
CREATOR = "robodyn drawing"  # creator of an SVG or a PDF
SUFFIXES = (".png", ".svg", ".pdf")
# by suffix: the bytes, and how much of the start and of the end of the file is searched for them
SIGNATURE = b"Software\x00" + MARK.encode()
_START, _END = 4096, 4096


def is_ours(path: Path) -> bool:
    """Tell whether a file is a drawing that carries our mark."""
    try:
        if not path.is_file():
            return False
        with open(path, "rb") as stream:
            start = stream.read(_START)
            stream.seek(max(0, os.fstat(stream.fileno()).st_size - _END))
            end = stream.read(_END)
    except OSError:
        return False
    if path.suffix == ".png":
        return SIGNATURE in start[:512]
    return path.suffix in SUFFIXES and any(CREATOR.encode() in part for part in (start, end))

"""Result files: ``write`` and ``read`` a Result in one call, ``ResultWriter`` for runs too long for memory.

The format is described in ``docs/hdf5.md``. Members are imported on first use: a run only writes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robodyn_cli.results.hdf5.reader import read, read_all
    from robodyn_cli.results.hdf5.writer import ResultWriter, write

__all__ = ["ResultWriter", "read", "read_all", "write"]


def __getattr__(name: str) -> Any:
    if name in ("read", "read_all"):
        from robodyn_cli.results.hdf5 import reader

        return getattr(reader, name)
    if name in ("ResultWriter", "write"):
        from robodyn_cli.results.hdf5 import writer

        return getattr(writer, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

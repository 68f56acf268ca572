"""The file below HDF5: it keeps failures and interrupts from the library and reports them to the writer.

The few HDF5 calls the writer needs, on h5py's low-level interface.

The high-level interface takes twice the time for a file of many small datasets, and that time is part of
every run. Nothing else imports h5py for writing.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5f, h5fd, h5g, h5p, h5s, h5t


class Sink:
    """A file for HDF5's file-object driver.

    HDF5 cannot close a file whose writes have failed: on a full disk it crashes the process. So the first
    failure is kept in ``error`` and what follows goes to memory, until the writer asks and gives up; that is
    little, since it asks after every block. Interrupts wait outside (``atomic.uninterrupted``): one that is raised
    between two statements here would reach the library.
    """

    def __init__(self, path: Path) -> None:
        self._file = open(path, "x+b", buffering=0)  # noqa: SIM115 - closed by close()
        self._patches: list[tuple[int, bytes]] = []
        self._position = 0
        self._end = 0
        self.error: BaseException | None = None

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to ``offset``."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._end}[whence]
        self._position = start + offset
        return self._position

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def write(self, data: Any) -> int:
        """Write all of ``data`` at the position."""
        view = memoryview(data).cast("B")
        if self.error is None:
            try:
                self._file.seek(self._position)
                done = 0
                while done < len(view):
                    done += self._file.write(view[done:])
            except BaseException as error:
                self.error = error
        if self.error is not None:
            self._patches.append((self._position, bytes(view)))
        self._position += len(view)
        self._end = max(self._end, self._position)
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """Fill ``buffer`` from the position; beyond the end there are zeros."""
        view = memoryview(buffer).cast("B")
        view[:] = bytes(len(view))
        try:
            self._file.seek(self._position)
            self._file.readinto(view)
        except BaseException as error:
            self.error = self.error or error
        for offset, patch in self._patches:
            first, last = max(offset, self._position), min(offset + len(patch), self._position + len(view))
            if first < last:
                view[first - self._position : last - self._position] = patch[first - offset : last - offset]
        self._position += len(view)
        return len(view)

    def truncate(self, size: int) -> int:
        """Set the length of the file."""
        self._end = size
        if self.error is None:
            try:
                self._file.truncate(size)
            except BaseException as error:
                self.error = error
        return size

    def flush(self) -> None:
        """Do nothing: writes are not buffered, and ``close`` syncs."""

    def check(self) -> None:
        """Raise the first failure, if there was one."""
        if self.error is not None:
            raise self.error

    def close(self, sync: bool) -> None:
        """Close the file, after bringing it to the disk if ``sync``."""
        try:
            if sync:
                os.fsync(self._file.fileno())
        finally:
            self._file.close()


FLOAT = h5t.py_create(np.dtype("<f8"))
INTEGER = h5t.py_create(np.dtype("<i8"))
TEXT_DTYPE = h5py.string_dtype("utf-8")
TEXT = h5t.py_create(TEXT_DTYPE, logical=True)
# Python objects in memory, variable-length strings in the file.
TEXT_IN_MEMORY = h5t.py_create(TEXT_DTYPE)
SCALAR = h5s.create(h5s.SCALAR)
TRACKED = h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED
# What netCDF calls a scale that only carries a length; readers of netCDF look for this very text.
BARE_DIMENSION = "This is a netCDF dimension but not a netCDF variable."


class OutputFile:
    """An HDF5 file being written: groups keep the order in which things were added."""

    def __init__(self, path: Path) -> None:
        access = h5p.create(h5p.FILE_ACCESS)
        access.set_fclose_degree(h5f.CLOSE_STRONG)
        # Attributes beyond 64 KiB (the names of some 4000 joints) need the 1.8 layout; all readers know it.
        access.set_libver_bounds(h5f.LIBVER_V18, h5f.LIBVER_LATEST)
        # datasets grow by whole chunks, so the 8 MB of cache that HDF5 gives each of them would be for nothing
        access.set_cache(0, 521, 0, 0.75)
        self._sink = Sink(path)
        access.set_fileobj_driver(h5fd.fileobj_driver, self._sink)
        creation = h5p.create(h5p.FILE_CREATE)
        creation.set_link_creation_order(TRACKED)
        self._file = h5f.create(os.fsencode(path), h5f.ACC_TRUNC, fcpl=creation, fapl=access)
        self._group_creation = h5p.create(h5p.GROUP_CREATE)
        self._group_creation.set_link_creation_order(TRACKED)
        self._groups = {""}

    @property
    def root(self) -> Any:
        """The root group, for attributes."""
        return h5g.open(self._file, b"/")

    def whole(self, path: str, array: np.ndarray) -> Any:
        """Store a contiguous array and return its dataset."""
        space = h5s.create_simple(array.shape) if array.ndim else SCALAR
        dataset = h5d.create(self._file, self._name(path), FLOAT, space)
        if array.size:
            dataset.write(h5s.ALL, h5s.ALL, np.ascontiguousarray(array, dtype="<f8"))
        return dataset

    def growing(self, path: str, columns: tuple[int, ...], chunk_rows: int) -> Any:
        """Create an empty dataset that grows along its first dimension and return it."""
        creation = h5p.create(h5p.DATASET_CREATE)
        creation.set_chunk((chunk_rows, *columns))
        space = h5s.create_simple((0, *columns), (h5s.UNLIMITED, *columns))
        return h5d.create(self._file, self._name(path), FLOAT, space, dcpl=creation)

    def text(self, path: str, items: Sequence[str]) -> Any:
        """Store a column of text and return its dataset."""
        array = np.array(list(items), dtype=TEXT_DTYPE)
        dataset = h5d.create(self._file, self._name(path), TEXT, h5s.create_simple(array.shape))
        if array.size:
            dataset.write(h5s.ALL, h5s.ALL, array, mtype=TEXT_IN_MEMORY)
        return dataset

    def bare_dimension(self, name: str, length: int) -> Any:
        """Create a dimension that has a length and no labels, as netCDF does, and return its scale."""
        space = h5s.create_simple((length,))
        dataset = h5d.create(self._file, self._name(name), h5t.IEEE_F32BE, space)
        h5ds.set_scale(dataset, f"{BARE_DIMENSION}{length:10d}".encode())
        return dataset

    def check(self) -> None:
        """Raise the first failure to write; HDF5 itself is never told of one."""
        self._sink.check()

    def close(self, sync: bool = True) -> None:
        """Close the file, whole and on the disk if ``sync``; every handle into it becomes invalid."""
        try:
            self._file.close()
            if sync:
                self._sink.check()
        finally:
            self._sink.close(sync and self._sink.error is None)

    def _name(self, path: str) -> bytes:
        """Return ``path`` for HDF5 after creating the groups above it."""
        parent = ""
        for part in path.split("/")[:-1]:
            parent = f"{parent}/{part}" if parent else part
            if parent not in self._groups:
                h5g.create(self._file, parent.encode(), gcpl=self._group_creation)
                self._groups.add(parent)
        return path.encode()


def extend(dataset: Any, rows: np.ndarray) -> None:
    """Add ``rows`` at the end of a growing dataset."""
    start = dataset.shape[0]
    dataset.set_extent((start + len(rows), *dataset.shape[1:]))
    space = dataset.get_space()
    space.select_hyperslab((start, *(0,) * (rows.ndim - 1)), rows.shape)
    dataset.write(h5s.create_simple(rows.shape), space, np.ascontiguousarray(rows, dtype="<f8"))


def cut(dataset: Any, rows: int) -> None:
    """Shorten a growing dataset to its first ``rows`` rows."""
    dataset.set_extent((rows, *dataset.shape[1:]))


def make_scale(dataset: Any, name: str) -> None:
    """Make ``dataset`` a dimension scale."""
    h5ds.set_scale(dataset, name.encode())


def attach(dataset: Any, scale: Any, axis: int) -> None:
    """Attach a dimension scale to one axis of ``dataset``."""
    h5ds.attach_scale(dataset, scale, axis)


def set_text(target: Any, name: str, value: str) -> None:
    """Store a text attribute; variable length, so there is no limit of size."""
    # A NUL would cut the text in C; YAML and names never hold one, a stray byte must not lose the rest.
    cell = np.empty((), dtype=TEXT_DTYPE)
    cell[()] = value.replace("\0", "\N{REPLACEMENT CHARACTER}")
    h5a.create(target, name.encode(), TEXT, SCALAR).write(cell, mtype=TEXT_IN_MEMORY)


def set_texts(target: Any, name: str, values: Sequence[str]) -> None:
    """Store an attribute that is a list of text."""
    cells = np.array(list(values), dtype=TEXT_DTYPE)
    h5a.create(target, name.encode(), TEXT, h5s.create_simple(cells.shape)).write(cells, mtype=TEXT_IN_MEMORY)


def set_numbers(target: Any, name: str, values: Sequence[float]) -> None:
    """Store an attribute that is a list of floats."""
    cells = np.array(list(values), dtype="<f8")
    h5a.create(target, name.encode(), FLOAT, h5s.create_simple(cells.shape)).write(cells)


def set_number(target: Any, name: str, value: int | float) -> None:
    """Store a number as an attribute: 64-bit integer or float."""
    if isinstance(value, int):
        h5a.create(target, name.encode(), INTEGER, SCALAR).write(np.array(value, dtype="<i8"))
    else:
        h5a.create(target, name.encode(), FLOAT, SCALAR).write(np.array(value, dtype="<f8"))

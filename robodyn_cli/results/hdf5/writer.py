"""Write a result file block by block; it gets its final name when it is complete.

So that xarray and netCDF readers open every group, each axis of each dataset has a scale that names and labels it: a
one-dimensional dataset named like its dimension is that scale (``/time``); otherwise the scale lies at the root under
the dimension's name and holds the labels, or only a length.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.kernels.cache import code_digest
from robodyn_cli.record import mutable_record
from robodyn_cli.results import catalogue
from robodyn_cli.results import summary as provenance
from robodyn_cli.results.atomic import discard, output_errors, temporary_path, uninterrupted
from robodyn_cli.results.hdf5 import low
from robodyn_cli.results.result import Meta, Result, Variable, make_variable
from robodyn_cli.results.summary import dumps, jsonable
from robodyn_cli.version import __version__

if TYPE_CHECKING:
    from typing_extensions import Unpack


@mutable_record
class Scale:
    """A dimension of the file: its length, labels (may be empty) and dataset."""

    length: int
    labels: tuple[str, ...]
    dataset: Any


class Dimensions:
    """The dimensions of a file being written; ``taken`` are the names its datasets and groups use."""

    def __init__(self, file: low.OutputFile, taken: Container[str]) -> None:
        self._file = file
        self._taken = taken
        self._scales: dict[str, list[Scale]] = {}
        self._names: set[str] = set()

    def add_coordinate(self, name: str, length: int, dataset: Any) -> None:
        """Declare that ``dataset`` is the scale of dimension ``name``."""
        low.make_scale(dataset, name)
        self._scales.setdefault(name, []).insert(0, Scale(length, (), dataset))
        self._names.add(name)

    def attach(self, dataset: Any, axis: int, dim: str, length: int, labels: tuple[str, ...]) -> None:
        """Attach the scale of ``dim`` to an axis, creating it where needed.

        A second length or set of labels under one name gets a dimension of its own: ``NAME_2``, ``NAME_3``.
        """
        scales = self._scales.setdefault(dim, [])
        for scale in scales:
            if scale.length == length and (not labels or not scale.labels or scale.labels == labels):
                break
        else:
            scale = self._create(dim, length, labels)
            scales.append(scale)
        low.attach(dataset, scale.dataset, axis)

    def _create(self, dim: str, length: int, labels: tuple[str, ...]) -> Scale:
        name, number = dim, 1
        while name in self._taken or name in self._names:
            number += 1
            name = f"{dim}_{number}"
        self._names.add(name)
        # Labels that repeat cannot serve as an index.
        if labels and len(set(labels)) == len(labels):
            dataset = self._file.text(name, labels)
            low.make_scale(dataset, name)
            low.set_text(dataset, "units", "1")
            low.set_text(dataset, "long_name", f"labels of dimension {dim}")
            return Scale(length, labels, dataset)
        return Scale(length, (), self._file.bare_dimension(name, length))


FILETYPE = "robodyn.result"
FORMAT_VERSION = 1
NO_SEED = -1
# Root attributes that hold JSON; a run may give them in its attributes or in its summary.
JSON_ATTRIBUTES = ("termination", "counters", "wall_time_s")
# Up to BLOCK_BYTES a dataset is kept in memory and stored in one piece; beyond, it is flushed in chunks.
BLOCK_BYTES = 1 << 20
CHUNK_BYTES = 1 << 18


@mutable_record
class _Column:
    """A dataset that is being written: its buffered rows, and the rows already in the file."""

    meta: Variable
    blocks: list[np.ndarray]
    buffered: int = 0
    written: int = 0
    dataset: Any = None

    @property
    def rows(self) -> int:
        return self.written + self.buffered

    @property
    def row_bytes(self) -> int:
        return 8 * max(1, int(np.prod(self.meta.data.shape[1:])))

    def gathered(self) -> np.ndarray:
        """Return the buffered rows as one array."""
        return self.blocks[0] if len(self.blocks) == 1 else np.concatenate(self.blocks)


class ResultWriter:
    """Writes ``path`` under a temporary name; ``finish`` completes it and gives it its final name.

    Leaving the context without ``finish`` removes the temporary file and leaves an older ``path`` alone. To
    keep what a failed run has computed, call ``finish(status="failed")`` before the error leaves the context.
    """

    def __init__(self, path: str | Path, *, command: str, title: str = "", scene_text: str = "") -> None:
        from robodyn_cli.results.hdf5 import low

        self._h5 = low
        self.path = Path(path)
        self._head = {"command": command, "title": title, "scene": scene_text}
        self._columns: dict[str, _Column] = {}
        self._temporary: Path | None = temporary_path(self.path)
        with output_errors(self.path), uninterrupted():
            self._file = low.OutputFile(self._temporary)

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._temporary is None:
            return
        self._abandon()
        if kind is None:
            raise RuntimeError(f"{self.path}: the writer was left without finish()")

    @property
    def samples(self) -> int:
        """Number of times stored so far."""
        return self._columns["time"].rows if "time" in self._columns else 0

    def append(self, path: str, block: Any, **meta: Unpack[Meta]) -> None:
        """Add rows to ``path``; ``block`` has the shape of the dataset with its first dimension free.

        ``meta`` (units, names and so on, as for ``make_variable``) is read at the first call.
        """
        path = path.strip("/")
        column = self._columns.get(path)
        if column is None:
            column = self._declare(path, make_variable(path, block, **meta))
        rows = np.asarray(block, dtype=float)
        if rows.ndim == 0 or rows.shape[1:] != column.meta.data.shape[1:]:
            raise ValueError(f"{path}: a block of shape {rows.shape} after {column.meta.data.shape}")
        if not len(rows):
            return
        large = len(rows) * column.row_bytes >= BLOCK_BYTES
        # The caller may reuse its buffer, unless it is written before this call returns.
        column.blocks.append(rows if large else rows.copy())
        column.buffered += len(rows)
        if column.buffered * column.row_bytes >= BLOCK_BYTES:
            self._flush(path, column)

    def put(self, path: str, data: Any, **meta: Unpack[Meta]) -> None:
        """Store a whole array; ``meta`` as for ``append``. The array must not change before ``finish``."""
        path = path.strip("/")
        self.put_variable(path, make_variable(path, data, **meta))

    def put_variable(self, path: str, variable: Variable) -> None:
        """Store a whole Variable. Its array must not change before ``finish``."""
        path = path.strip("/")
        if path in self._columns:
            raise ValueError(f"{path}: already stored")
        column = self._declare(path, variable)
        column.blocks.append(variable.data)
        column.buffered = len(variable.data) if variable.data.ndim else 1

    def finish(
        self,
        *,
        status: str = "ok",
        summary: Mapping[str, Any] | None = None,
        events: Iterable[Mapping[str, Any]] = (),
        attributes: Mapping[str, Any] | None = None,
    ) -> Path:
        """Complete the file, publish it under its final name and return that.

        With ``status="failed"`` everything is cut to the samples that all time-dependent datasets have.
        """
        if self._temporary is None:
            raise RuntimeError(f"{self.path}: finish() was called twice")
        try:
            with uninterrupted():
                self._check_lengths(status)
            with output_errors(self.path, RuntimeError):
                with uninterrupted():
                    self._write_columns()
                    self._write_events(list(events))
                    self._write_attributes(status, dict(summary or {}), dict(attributes or {}))
                    self._file.close()
                os.replace(self._temporary, self.path)
        except BaseException:
            self._abandon()
            raise
        self._temporary = None
        return self.path

    def _abandon(self) -> None:
        """Close and remove the temporary file in any state."""
        temporary, self._temporary = self._temporary, None
        self._columns.clear()
        try:
            with contextlib.suppress(Exception), uninterrupted():
                self._file.close(sync=False)
        finally:
            if temporary is not None:
                discard(temporary)

    def _declare(self, path: str, meta: Variable) -> _Column:
        if self._temporary is None:
            raise RuntimeError(f"{self.path}: already finished")
        # Only the shape of the first rows counts; keeping the caller's array here would keep its memory.
        shape = np.empty((0, *meta.data.shape[1:])) if meta.data.ndim else meta.data
        column = _Column(dataclasses.replace(meta, data=shape), [])
        self._columns[path] = column
        return column

    def _flush(self, path: str, column: _Column) -> None:
        """Move whole chunks from the buffer to the file; a rest of less than a chunk stays."""
        chunk = max(1, CHUNK_BYTES // column.row_bytes)
        rows = column.gathered()
        count = len(rows) - len(rows) % chunk
        with output_errors(self.path, RuntimeError), uninterrupted():
            if column.dataset is None:
                column.dataset = self._file.growing(path, column.meta.data.shape[1:], chunk)
            if count:
                self._h5.extend(column.dataset, rows[:count])
            self._file.check()
        column.written += count
        column.buffered -= count
        column.blocks = [rows[count:].copy()] if column.buffered else []

    def _check_lengths(self, status: str) -> None:
        """Make all datasets over time equally long, or raise an error that names the lengths."""
        timed = {path: column for path, column in self._columns.items() if "time" in column.meta.dims[:1]}
        if len({column.rows for column in timed.values()}) <= 1:
            return
        shortest = min(column.rows for column in timed.values())
        if status != "failed":
            listing = ", ".join(f"{path} {column.rows}" for path, column in timed.items())
            raise ValueError(f"{self.path}: datasets over time differ in length: {listing}")
        for column in timed.values():
            if column.written > shortest:
                self._h5.cut(column.dataset, shortest)
                column.written, column.blocks = shortest, []
            else:
                column.blocks = [column.gathered()[: shortest - column.written]] if column.blocks else []
            column.buffered = shortest - column.written

    def _write_columns(self) -> None:

        groups = {path.split("/")[0] for path in self._columns} | {"events"}
        dimensions = Dimensions(self._file, groups)
        for path, column in self._columns.items():
            self._write_column(path, column)
            if column.meta.dims == (path,):
                dimensions.add_coordinate(path, column.rows, column.dataset)
        for path, column in self._columns.items():
            meta = column.meta
            shape = (column.rows, *meta.data.shape[1:])
            for axis, dim in enumerate(meta.dims):
                if meta.dims == (path,):
                    continue
                labels = meta.names if axis == len(meta.dims) - 1 else ()
                dimensions.attach(column.dataset, axis, dim, shape[axis], labels)

    def _write_column(self, path: str, column: _Column) -> None:
        meta = column.meta
        if column.dataset is None:
            column.dataset = self._file.whole(path, column.gathered() if column.blocks else meta.data)
        elif column.blocks:
            self._h5.extend(column.dataset, column.gathered())
        column.blocks = []
        self._h5.set_text(column.dataset, "units", meta.units)
        self._h5.set_text(column.dataset, "long_name", meta.long_name)
        if meta.names:
            self._h5.set_texts(column.dataset, "names", meta.names)
        if meta.column_units:
            self._h5.set_texts(column.dataset, "column_units", meta.column_units)
        if meta.held is not None:
            self._h5.set_number(column.dataset, "held_period", meta.held.period)
            self._h5.set_numbers(column.dataset, "held_offset", meta.held.offset)

    def _write_events(self, events: list[Mapping[str, Any]]) -> None:
        core = ("time", "name", "kind")
        rest = [{key: item for key, item in event.items() if key not in core} for event in events]
        times = np.array([float(event["time"]) for event in events])
        datasets = {
            "events/time": self._file.whole("events/time", times),
            "events/name": self._file.text("events/name", [str(event.get("name", "")) for event in events]),
            "events/kind": self._file.text("events/kind", [str(event.get("kind", "")) for event in events]),
            "events/details": self._file.text("events/details", [dumps(item) for item in rest]),
        }
        scale = self._file.bare_dimension("event", len(events))
        for entry in catalogue.EVENT_ENTRIES:
            self._h5.set_text(datasets[entry.path], "units", entry.units)
            self._h5.set_text(datasets[entry.path], "long_name", entry.long_name)
            self._h5.attach(datasets[entry.path], scale, 0)

    def _write_attributes(self, status: str, summary: dict[str, Any], given: dict[str, Any]) -> None:
        attributes: dict[str, Any] = {
            "filetype": FILETYPE,
            "format_version": FORMAT_VERSION,
            "robodyn_version": __version__,
            "robodyn_code_sha256": code_digest(),
            **self._head,
            "scene_sha256": provenance.sha256(self._head["scene"]),
            "status": status,
            "versions": provenance.versions(),
            "cpu": provenance.cpu_name(),
            "seed": NO_SEED,
            "integrator": str(summary.get("integrator", "none")),
        }
        attributes.update({key: summary.get(key, {}) for key in JSON_ATTRIBUTES})
        reserved = ("filetype", "format_version", "status", "scene", "scene_sha256", "summary")
        attributes.update({key: value for key, value in given.items() if key not in reserved})
        attributes["summary"] = summary
        root = self._file.root
        for name, value in attributes.items():
            if isinstance(value, bool | int | float | np.integer | np.floating):
                self._h5.set_number(root, name, value.item() if isinstance(value, np.generic) else value)
            else:
                self._h5.set_text(root, name, value if isinstance(value, str) else dumps_any(value))


def write(result: Result, path: str | Path) -> Path:
    """Store ``result`` at ``path``, atomically, and return the path."""
    with ResultWriter(
        path, command=result.command, title=result.title, scene_text=result.scene_text
    ) as writer:
        for name, variable in result.variables.items():
            writer.put_variable(name, variable)
        return writer.finish(
            status=result.status, summary=result.summary, events=result.events, attributes=result.attributes
        )


def dumps_any(value: Any) -> str:
    """Return an attribute that is not text or a number as JSON."""
    import json

    return json.dumps(jsonable(value), ensure_ascii=False, allow_nan=False)

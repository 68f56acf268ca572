"""Dimension scales: which dataset names and labels each axis of each other one.

The rules, so that xarray and netCDF readers open every group: each axis of each dataset has a scale; a
one-dimensional dataset named like its dimension is that scale (``/time``); otherwise the scale lies at the root under
the dimension's name and holds the labels, or only a length.
"""

from __future__ import annotations

from collections.abc import Container
from typing import Any

from robodyn_cli.record import mutable_record
from robodyn_cli.results.hdf5 import low


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

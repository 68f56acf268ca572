"""A motion in an HDF5 file: of a result of robodyn, or datasets named as the columns of a table."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.errors import ResultFileError
from robodyn_cli.results.hdf5.reader import guarded
from robodyn_cli.results.hdf5.writer import FILETYPE
from robodyn_cli.spatial.algebra import Array


def read_table(path: str) -> tuple[list[str], Array]:
    """Return the names of the columns, ``t`` first, and their numbers (T, n): times and positions.

    Raises
    ------
    ResultFileError : the file cannot be read, or holds no motion.
    """
    return guarded(Path(path), partial(_read, path))


def _read(path: str) -> tuple[list[str], Array]:
    import h5py

    with h5py.File(path, "r", locking="best-effort") as file:
        if file.attrs.get("filetype") == FILETYPE:
            return _of_result(file, path)
        columns = {name: item[()] for name, item in file.items() if isinstance(item, h5py.Dataset)}
    lengths = {name: np.shape(values) for name, values in columns.items()}
    if "t" not in columns:
        found = ", ".join(columns) or "none"
        raise ResultFileError(f"{path} has no dataset 't' of times; its datasets: {found}", path=path)
    for name, shape in lengths.items():
        if shape != lengths["t"] or len(shape) != 1 or columns[name].dtype.kind not in "fiu":
            raise ResultFileError(
                f"{path}: dataset {name!r} is no list of as many numbers as 't' has (shape {shape})",
                path=path,
            )
    names = ["t", *(name for name in columns if name != "t")]
    return names, np.column_stack([np.asarray(columns[name], dtype=float) for name in names])


def _of_result(file: Any, path: str) -> tuple[list[str], Array]:
    if "time" not in file or "q" not in file:
        raise ResultFileError(
            f"{path} is a result without a motion (command {file.attrs['command']})", path=path
        )
    names = [str(name) for name in file["q"].attrs["names"]]
    return ["t", *names], np.column_stack([file["time"][()], file["q"][()]])

"""Read a file into a Result, or the motion that it holds; in a process of its own first, for the HDF5 library may crash
on a damaged file, or loop forever."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from robodyn_cli.errors import ResultFileError
from robodyn_cli.foreign import opened, survive
from robodyn_cli.results.hdf5.writer import FILETYPE, FORMAT_VERSION, JSON_ATTRIBUTES
from robodyn_cli.results.held import HeldColumns
from robodyn_cli.results.result import Result, Variable
from robodyn_cli.spatial.algebra import Array


def read_table(path: str) -> tuple[list[str], Array]:
    """Return the names of the columns, ``t`` first, and their numbers (T, n): times and positions.

    Raises
    ------
    ResultFileError : the file cannot be read, or holds no motion.
    """
    columns, rows = guarded(Path(path), partial(_table, path))
    if rows.size > MOST_NUMBERS:
        raise ResultFileError(
            f"{path} holds {rows.size} numbers; allowed in a table: {MOST_NUMBERS}", path=path
        )
    return columns, rows


def _table(path: str) -> tuple[list[str], Array]:
    import h5py

    with h5py.File(path, "r", locking="best-effort") as file:
        if file.attrs.get("filetype") == FILETYPE:
            return _of_result(file, path)
        load = Loader(Path(path))
        columns = {name: load(item) for name, item in file.items() if isinstance(item, h5py.Dataset)}
    lengths = {name: np.shape(values) for name, values in columns.items()}
    if "t" not in columns:
        listed = ", ".join(columns) or "none"
        raise ResultFileError(f"{path} has no dataset 't' of times; its datasets: {listed}", path=path)
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
    if "pieces" in file:
        return [str(name) for name in file["pieces"].attrs["names"]], file["pieces"][()]
    names = [str(name) for name in file["q"].attrs["names"]]
    return ["t", *names], np.column_stack([file["time"][()], file["q"][()]])


MOST_NUMBERS = 5_000_000  # of a table, each a node of the scene
# what a file may expand to: bytes, or times its own size
ROOM, EXPANSION = 1_000_000_000, 100
# time limit of reading a file [s]; a damaged one may make the library loop forever
SECONDS = 10.0
BYTES_PER_SECOND = 5e6
LIBRARY = "the HDF5 library"
T = TypeVar("T")

_FIELDS = ("filetype", "format_version", "command", "title", "status", "scene", "scene_sha256", "summary")
_TEXT_ATTRIBUTES = ("robodyn_version", "robodyn_code_sha256", "cpu", "integrator")


def read(path: str | Path, select: Callable[[str], bool] | None = None) -> Result:
    """Return the result stored at ``path``; ``select`` chooses paths where not all are wanted.

    Raises
    ------
    ResultFileError : the file is not a result of robodyn, is damaged, or is of a newer format.
    """
    path = Path(path)
    return guarded(path, partial(_read, path, select))


def read_all(paths: Sequence[Path]) -> list[Result]:
    """Return the results stored at paths, which one process tries for all of them: to start it takes longer than to
    read a small file.

    Raises
    ------
    ResultFileError : as ``read``, of the first file that cannot be read.
    """
    if not paths:
        return []
    for path in paths:
        _openable(path)
    actions = [partial(_read, path, None) for path in paths]

    def each() -> None:
        for action in actions:
            with suppress(Exception):  # told where it is read here
                action()

    try:
        survive(each, sum(map(_seconds, paths)), LIBRARY)
    except (TimeoutError, RuntimeError):
        return [read(path) for path in paths]  # which says whose fault it is
    return [_told(path, action) for path, action in zip(paths, actions)]


def guarded(path: Path, action: Callable[[], T]) -> T:
    """Return what reading a file gives, which is tried in a process of its own first.

    Raises
    ------
    ResultFileError : there is no such file, or it is damaged.
    """
    _openable(path)

    def tried() -> T:
        survive(action, _seconds(path), LIBRARY)
        return action()

    return _told(path, tried)


def _openable(path: Path) -> None:
    try:
        opened(path).close()
    except IsADirectoryError:
        raise ResultFileError(f"{path} is a directory; name the result.h5 in it", path=str(path)) from None
    except (OSError, ValueError) as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.args[-1]
        raise ResultFileError(f"{path}: {reason}", path=str(path)) from None


def _seconds(path: Path) -> float:
    """Return the time in which a file has to be read."""
    return SECONDS + path.stat().st_size / BYTES_PER_SECOND


def _told(path: Path, action: Callable[[], T]) -> T:
    """Return what reading a file gives; each error says which file it is about."""
    try:
        return action()
    except ResultFileError:
        raise
    except Exception as error:  # a damaged file can raise any error
        message = f"{path} cannot be read as HDF5: {error}"
        raise ResultFileError(message, path=str(path)) from error


def _read(path: Path, select: Callable[[str], bool] | None) -> Result:
    import h5py

    with h5py.File(path, "r", locking="best-effort") as file:
        _check(file, path)
        return _result(file, path, select)


def _check(file: Any, path: Path) -> None:
    if file.attrs.get("filetype") != FILETYPE:
        raise ResultFileError(f"{path} is an HDF5 file, but not a result of robodyn", path=str(path))
    version = int(file.attrs["format_version"])
    if version > FORMAT_VERSION:
        raise ResultFileError(
            f"{path} has format {version}, written by robodyn {file.attrs.get('robodyn_version', '?')}; this"
            f" version reads formats up to {FORMAT_VERSION}: update robodyn",
            path=str(path),
        )


def _result(file: Any, path: Path, select: Callable[[str], bool] | None) -> Result:
    attributes = {name: _attribute(name, value) for name, value in file.attrs.items() if name not in _FIELDS}
    result = Result(
        command=str(file.attrs["command"]),
        title=str(file.attrs["title"]),
        status=str(file.attrs["status"]),
        scene_text=str(file.attrs["scene"]),
        events=_events(file),
        summary=json.loads(file.attrs.get("summary", "{}")),
        attributes=attributes,
    )
    _collect(file["/"], "", result, select, Loader(path))
    return result


def _attribute(name: str, value: Any) -> Any:
    """Return a root attribute as Python has it; those that hold JSON are parsed."""
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, str) or name in _TEXT_ATTRIBUTES:
        return value
    if name in JSON_ATTRIBUTES or value.startswith(("{", "[")):
        try:
            return json.loads(value)
        except ValueError:
            return value
    return value


class Loader:
    """Loads datasets of a file as far as all their bytes lie in it and are not too many."""

    def __init__(self, path: Path) -> None:
        self._room = max(ROOM, EXPANSION * path.stat().st_size)

    def __call__(self, dataset: Any) -> Any:
        if dataset.external or dataset.is_virtual:
            raise ValueError(f"{dataset.name} lies in another file")
        self._room -= dataset.size * max(8, dataset.dtype.itemsize)
        if self._room < 0:
            raise ValueError(f"with {dataset.name} it expands to more than {EXPANSION} times its size")
        return dataset[()]


def _collect(
    group: Any, prefix: str, result: Result, select: Callable[[str], bool] | None, load: Loader
) -> None:
    import h5py

    for name in _members(group):
        path = prefix + name
        if name in (".", "..") or isinstance(group.get(name, getlink=True), h5py.ExternalLink):
            raise ValueError(f"{path!r} leads out of it")
        item = group[name]
        if isinstance(item, h5py.Group):
            if path != "events":
                _collect(item, path + "/", result, select, load)
        elif _is_bare(item) or not (select is None or select(path)):
            continue
        elif item.dtype.kind not in "fiu":
            if not item.is_scale:
                result.others[path] = _entries(item, load)
        else:
            attributes = dict(item.attrs)
            result.variables[path] = Variable(
                np.asarray(load(item), dtype=float),
                _dims(item, path),
                str(attributes.get("units", "")),
                str(attributes.get("long_name", "")),
                tuple(str(label) for label in attributes.get("names", ())),
                tuple(str(unit) for unit in attributes.get("column_units", ())),
                _held(attributes),
            )


def _held(attributes: dict[str, Any]) -> HeldColumns | None:
    if "held_period" not in attributes:
        return None
    return HeldColumns(float(attributes["held_period"]), tuple(float(x) for x in attributes["held_offset"]))


def _entries(dataset: Any, load: Loader) -> tuple[str, ...]:
    """Return the entries of a dataset that holds no numbers, as text."""
    data = np.ravel(load(dataset))
    return tuple(entry.decode() if isinstance(entry, bytes) else str(entry) for entry in data)


def _members(group: Any) -> list[str]:
    """Return the names in a group in the order in which they were written, where the file knows it."""
    import h5py

    order = h5py.h5.INDEX_NAME
    if group.id.get_create_plist().get_link_creation_order() & h5py.h5p.CRT_ORDER_INDEXED:
        order = h5py.h5.INDEX_CRT_ORDER
    names: list[bytes] = []
    group.id.links.iterate(names.append, idx_type=order)
    return [name.decode() for name in names]


def _is_bare(dataset: Any) -> bool:
    """Tell whether a dataset only carries the length of a dimension."""
    return dataset.is_scale and bytes(dataset.attrs.get("NAME", b"")).startswith(
        b"This is a netCDF dimension"
    )


def _dims(dataset: Any, path: str) -> tuple[str, ...]:
    """Return the names of the dimensions from their scales; a dataset that is a scale names its own."""
    if dataset.is_scale:
        return (path,)
    names = [dimension[0].name if len(dimension) else f"dim_{k}" for k, dimension in enumerate(dataset.dims)]
    if None in names:
        raise ValueError(f"a dimension of {path} has no name")
    return tuple(name.rsplit("/", 1)[-1] for name in names)


def _events(file: Any) -> list[dict[str, Any]]:
    group = file.get("events")
    if group is None:
        return []
    names, kinds, details = (group[key].asstr()[()] for key in ("name", "kind", "details"))
    return [
        {"time": float(time), "name": name, "kind": kind, **json.loads(more)}
        for time, name, kind, more in zip(group["time"][()], names, kinds, details)
    ]

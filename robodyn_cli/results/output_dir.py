"""The directory that a run writes into: locked, and filled at once when all that the run leaves is there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from robodyn_cli.commands import PLOT_FORMATS
from robodyn_cli.errors import OutputError
from robodyn_cli.foreign import opened
from robodyn_cli.results.atomic import (
    DirectoryLock,
    is_temporary,
    output_error,
    output_errors,
    temporary_path,
    uninterrupted,
)
from robodyn_cli.results.summary import read_summary, write_summary

RESULT_NAME = "result.h5"
SUMMARY_NAME = "summary.json"
UNFINISHED_NAME = ".unfinished-samples"  # what a long run that was killed goes on from
RUN_ID = "run_id"  # key of the summary and attribute of the result file: the same of one run
SCENE_FILE = "scene_file"  # key of the summary: where the scene lies
# by which drawings of ours are known, so that a run removes no file of anybody else
MARK = "robodyn"  # keyword "Software" of a PNG
CREATOR = "robodyn drawing"  # creator of an SVG or a PDF
DRAWING_SUFFIXES = tuple(f".{kind}" for kind in PLOT_FORMATS)
SIGNATURE = b"Software\x00" + MARK.encode()
_START, _END = 4096, 4096


class OutputDirectory:
    """Context manager around the output directory of one run.

    Entering creates and locks the directory. Files are written below ``new``, a folder of the run's own inside;
    ``replace_old`` puts them in the place of what an earlier run left. Leaving without that leaves the earlier files as
    they are. Files of others are never touched: a drawing is removed only if it carries robodyn's mark.

    Parameters
    ----------
    path : the directory.
    drawings : names that a report may have left without a summary listing them (a run that was killed).
    scene : file of the scene, by which the directory of another scene is recognised.

    Raises
    ------
    OutputError : it cannot be written into. DirectoryInUseError : another run is writing there.
    """

    lasts = True  # what is written stays

    def __init__(
        self, path: str | Path, drawings: Iterable[str] = (), scene: str | Path | None = None
    ) -> None:
        self.path = Path(path)
        self.new = temporary_path(self.path / "new")
        self.outputs: list[str] = []
        self.run_id = os.urandom(8).hex()
        self._scene = os.path.realpath(scene) if scene is not None else None
        self._drawings = tuple(drawings)
        self._lock: DirectoryLock | None = None

    def __enter__(self) -> OutputDirectory:
        with output_errors(self.path):
            try:
                self.path.mkdir(parents=True, exist_ok=True)
            except (FileExistsError, NotADirectoryError) as error:
                raise OutputError(
                    f"cannot write into {self.path}: it, or a part of it, is a file and not a directory",
                    path=str(self.path),
                ) from error
            self._lock = DirectoryLock(self.path)
        try:
            self._prepare()
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        shutil.rmtree(self.new, ignore_errors=True)
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    @property
    def result_path(self) -> Path:
        """Where the result file is written."""
        return self.new / RESULT_NAME

    def stored_run(self) -> tuple[float, ...] | None:
        """Return what changes when another run's files come here; None if there are none."""
        marks: list[float] = []
        for name in (RESULT_NAME, SUMMARY_NAME):
            try:
                status = os.stat(self.path / name)
            except (OSError, ValueError):
                continue
            marks += [status.st_ino, status.st_mtime_ns]
        return tuple(marks) or None

    @property
    def warning(self) -> str | None:
        """What users are to be told of the directory's lock."""
        return None if self._lock is None else self._lock.warning

    def other_scene(self) -> Path | None:
        """Return the scene file whose results are here, if it is another one than this run's and still there."""
        owner = read_summary(self.path / SUMMARY_NAME).get(SCENE_FILE)
        if self._scene is None or not isinstance(owner, str) or owner == self._scene:
            return None
        return Path(owner) if os.path.isfile(owner) else None

    def replace_old(self, summary: Mapping[str, Any]) -> None:
        """Put the files of this run, and its summary, in the place of an earlier run's.

        The summary goes last and names the result file's run: ended in between, the files are known to be of two runs.
        """
        names = sorted(path.name for path in _entries(self.new) if not is_temporary(path))
        drawings = [name for name in names if name != RESULT_NAME]
        self.outputs = [*(name for name in names if name == RESULT_NAME), *sorted({*drawings, SUMMARY_NAME})]
        write_summary(self._completed(summary), self.new / SUMMARY_NAME)
        old = [name for name in self._old_drawings() if name not in names]
        with uninterrupted():
            if RESULT_NAME in names:
                self._move(RESULT_NAME)
            else:
                # a summary that lists no result file cannot be told apart by it
                self._remove(RESULT_NAME)
                self._remove(SUMMARY_NAME)
            for name in drawings:
                self._move(name)
            for name in (*old, UNFINISHED_NAME):
                self._remove(name)
            self._move(SUMMARY_NAME)

    def _completed(self, summary: Mapping[str, Any]) -> dict[str, Any]:
        own: dict[str, Any] = {SCENE_FILE: self._scene} if self._scene is not None else {}
        return {**summary, **own, RUN_ID: self.run_id, "outputs": self.outputs}

    def _prepare(self) -> None:
        """Make the folder of new files, and refuse at once what would be in the way at the end."""
        # The lock is ours, so a temporary file here belongs to a run that was killed.
        for path in (found := _entries(self.path)):
            if is_temporary(path):
                self._remove(path.name)
        own = {RESULT_NAME, SUMMARY_NAME, *self._drawings}
        for path in found:
            if path.name in own and path.is_dir():
                raise OutputError(f"cannot write {path}: it is a directory", path=str(path))
        with output_errors(self.path):
            self.new.mkdir()

    def _old_drawings(self) -> list[str]:
        listed = read_summary(self.path / SUMMARY_NAME).get("outputs", ())
        names = [name for name in listed if _is_drawing(name)] if isinstance(listed, list) else []
        here = {path.name for path in _entries(self.path)}
        # a list can name a file that somebody else has put there since
        return [
            name
            for name in dict.fromkeys((*names, *self._drawings))
            if name in here and is_ours(self.path / name)
        ]

    def _move(self, name: str) -> None:
        target = self.path / name
        with output_errors(target):
            os.replace(self.new / name, target)

    def _remove(self, name: str) -> None:
        path = self.path / name
        try:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
        except OSError as error:
            raise output_error(path, error) from error


def is_ours(path: Path) -> bool:
    """Tell whether a file is a drawing that carries our mark."""
    try:
        with opened(path) as stream:
            start = stream.read(_START)
            stream.seek(max(0, os.fstat(stream.fileno()).st_size - _END))
            end = stream.read(_END)
    except OSError:
        return False
    if path.suffix == ".png":
        return SIGNATURE in start[:512]
    return path.suffix in DRAWING_SUFFIXES and any(CREATOR.encode() in part for part in (start, end))


def set_in_summary(directory: Path, key: str, value: Any) -> None:
    """Set a key of the summary that a run left in a directory; None takes the key away.

    Raises
    ------
    OutputError : it cannot be written. DirectoryInUseError : another run is writing there.
    """
    path = directory / SUMMARY_NAME
    if value is None and key not in read_summary(path):
        return
    with output_errors(path):
        lock = DirectoryLock(directory)
        try:
            summary = {**read_summary(path), key: value}
            if value is None:
                del summary[key]
            write_summary(summary, path)
        finally:
            lock.release()


def same_run(summary: Mapping[str, Any], attributes: Mapping[str, Any]) -> bool:
    """Tell whether a summary and the attributes of a result file are of one run."""
    return summary.get(RUN_ID) == attributes.get(RUN_ID)


def _entries(directory: Path) -> list[Path]:
    with output_errors(directory):
        return [Path(entry.path) for entry in os.scandir(directory)]


def _is_drawing(name: Any) -> bool:
    """Tell whether an entry of an old list of outputs is the plain name of a drawing."""
    return isinstance(name, str) and Path(name).name == name and name.endswith(DRAWING_SUFFIXES)


def path_ends(paths: Sequence[Path]) -> list[str]:
    """Return the shortest ends of paths, of results or of their directories, that tell these apart."""
    parts = [(path if path.is_dir() else path.parent).resolve().parts for path in paths]
    for count in range(1, max(len(p) for p in parts) + 1):
        ends = ["/".join(p[-count:]) for p in parts]
        if len(set(ends)) == len(ends):
            return ends
    return [f"{k + 1}: {path}" for k, path in enumerate(paths)]

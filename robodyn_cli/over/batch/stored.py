"""Results of earlier runs, by the directory or the file that holds them.

The scenes that files, folders and patterns on a command line mean.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from robodyn_cli.errors import ResultFileError, SceneError
from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.output_dir import RESULT_NAME, SUMMARY_NAME, same_run
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import read_summary
from robodyn_cli.scene.load import is_part


def result_path(path: Path) -> Path:
    """Return the result file that a path means: itself, or the one in the directory.

    Raises
    ------
    ResultFileError : there is none in the directory.
    """
    if not path.is_dir():
        return path
    inside = path / RESULT_NAME
    if not inside.exists():
        raise ResultFileError(
            f"{path}: there is no {RESULT_NAME} in it; name the output directory of one run"
        )
    return inside


def read_stored(path: Path, select: Callable[[str], bool] | None = None) -> Result:
    """Return the result that a path means.

    Raises
    ------
    ResultFileError : there is none, it cannot be read, or the summary beside it is of another run.
    """
    result = read(result_path(path), select)
    if (
        path.is_dir()
        and (summary := read_summary(path / SUMMARY_NAME))
        and not same_run(summary, result.attributes)
    ):
        raise _mixed(path)
    return result


def summary_and_scene(path: Path) -> tuple[dict[str, Any], str | None]:
    """Return the summary of a run and the text of its scene, if a result file has it.

    A run that failed before it had results left only its summary.
    """
    summary = read_summary(path / SUMMARY_NAME) if path.is_dir() else {}
    if summary and not (path / RESULT_NAME).exists():
        outputs = summary.get("outputs")
        if isinstance(outputs, list) and RESULT_NAME in outputs:
            raise _mixed(path)
        return summary, None
    result = read_stored(path, lambda _: False)
    return summary or result.summary, result.scene_text


def _mixed(path: Path) -> ResultFileError:
    return ResultFileError(
        f"{path}: {SUMMARY_NAME} and {RESULT_NAME} are not of the same run: one was ended while it "
        "replaced the other's files; run the scene again",
        path=str(path),
    )


SUFFIXES = (".yaml", ".yml")


def gather(words: Sequence[str]) -> list[Path]:
    """Return the scene files, each once.

    A folder means all YAML files below it, a pattern those that match it; files that are made to be included (a
    robot, a trajectory) and hidden folders are passed over there. A file that is named is taken as it is.
    """
    found: dict[str, Path] = {}
    for word in words:
        here = list(_of(word))
        if not here:
            what = "there is no scene in it" if os.path.isdir(word) else "no file matches"
            raise SceneError(
                f"{word}: {what}; allowed: scenes, folders with scenes, patterns such as 'configs/*.yaml'"
            )
        for path in here:
            found.setdefault(os.path.realpath(path), path)
    return list(found.values())


def _of(word: str) -> Iterator[Path]:
    path = Path(word)
    if path.is_dir():
        for file in sorted(path.rglob("*")):
            hidden = any(part.startswith(".") for part in file.relative_to(path).parts)
            if file.suffix in SUFFIXES and file.is_file() and not hidden and not is_part(file):
                yield file
    elif not path.exists() and glob.has_magic(word):
        for name in sorted(glob.glob(word, recursive=True)):
            file = Path(name)
            if file.is_file() and not is_part(file):
                yield file
    else:
        yield path

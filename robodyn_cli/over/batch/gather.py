"""The scenes that files, folders and patterns on a command line mean."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from robodyn_cli.errors import SceneError
from robodyn_cli.scene.load import is_part

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

"""Results of earlier runs, by the directory or file that holds them; directories of results compared; the scenes that
files, folders and patterns mean."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robodyn_cli.errors import FAILED, ResultFileError, RobodynError, SceneError
from robodyn_cli.record import record
from robodyn_cli.results import hdf5
from robodyn_cli.results.compare import Difference, compare
from robodyn_cli.results.output_dir import RESULT_NAME, RUN_ID, SUMMARY_NAME, same_run
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import read_summary
from robodyn_cli.scene.load import NO_FILE, GivenScene
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.includes import Includer
from robodyn_cli.scene.text.nodes import IN_PYTHON
from robodyn_cli.scene.types import Scene


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


# an output directory, a result file, or for a program in Python a result itself
Stored = Path | Result


def read_stored(path: Stored, select: Callable[[str], bool] | None = None) -> Result:
    """Return the result that a path means; a result as it is.

    Raises
    ------
    ResultFileError : there is none, it cannot be read, or the summary beside it is of another run.
    """
    if isinstance(path, Result):
        return path
    return _of_one_run(path, hdf5.read(result_path(path), select))


def _of_one_run(path: Path, result: Result) -> Result:
    if (
        path.is_dir()
        and (summary := read_summary(path / SUMMARY_NAME))
        and not same_run(summary, result.attributes)
    ):
        raise _mixed(path)
    return result


def read_all(stored: Sequence[Stored]) -> list[tuple[Path, Result]]:
    """Return results with their paths; those in memory are told apart by their commands and numbers.

    Raises
    ------
    ResultFileError : as ``read_stored``.
    """
    files = iter(hdf5.read_all([result_path(one) for one in stored if not isinstance(one, Result)]))
    return [
        (Path("in memory") / f"{one.command} {k}" / RESULT_NAME, one)
        if isinstance(one, Result)
        else (one, _of_one_run(one, next(files)))
        for k, one in enumerate(stored, start=1)
    ]


def read_result(path: str | os.PathLike[str], select: Callable[[str], bool] | None = None) -> Result:
    """Return a stored result: of an output directory, or of a file.

    Of a run that failed before it had samples it is its status and its summary alone.

    Parameters
    ----------
    select : tells of the path of a dataset whether it is wanted; default: all.

    Raises
    ------
    ResultFileError : there is none, it cannot be read, or the files of the directory are of different runs.
    """
    place = Path(path)
    if place.is_dir() and is_run(place):
        return read_run(place, select)
    if is_tree(place) and (below := sorted(runs_below(place))):
        raise ResultFileError(
            f"{place}: there is no {RESULT_NAME} in it but there are results below it, {below[0]} the first; allowed: "
            "one of them, or read_results for all",
            path=str(place),
        )
    return read_stored(place, select)


def read_results(
    directory: str | os.PathLike[str], select: Callable[[str], bool] | None = None
) -> dict[str, Result]:
    """Return all stored results below a directory, as ``run`` leaves them, by their paths from there.

    Raises
    ------
    ResultFileError : there is none below it, or one cannot be read.
    """
    root = Path(directory)
    names = sorted(runs_below(root))
    if not names:
        raise ResultFileError(f"{root}: there is no result in it, nor below it", path=str(root))
    return {name: read_run(root / name, select) for name in names}


def summary_and_scene(path: Stored) -> tuple[dict[str, Any], str | None]:
    """Return the summary of a run and the text of its scene, if a result file has it.

    A run that failed before it had results left only its summary.
    """
    if isinstance(path, Result):
        return path.summary, path.scene_text or None
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


def name_of(source: GivenScene) -> str:
    """Return the name of a source in messages: its file, where it is one."""
    if isinstance(source, (Scene, Mapping)):
        return source.path if isinstance(source, Scene) else IN_PYTHON
    name = os.fspath(source)
    return NO_FILE if "\n" in name else name


SUFFIXES = (".yaml", ".yml")


def gather(words: Sequence[Any], files: bool = False) -> list[Path]:
    """Return the scene files, each once; scenes that a program in Python gives, as they are, unless they must be files.

    A folder means all YAML files below it, a pattern those that match it; files that are made to be included (a
    robot, a trajectory) and hidden folders are passed over there. A file that is named is taken as it is.
    """
    paths: dict[str, Path] = {}
    for word in words:
        if not isinstance(word, (str, Path)) or "\n" in str(word):
            if files:
                raise SceneError(
                    "a scene in memory: each scene runs in a process of its own; allowed: files, folders, patterns"
                )
            paths[f"{len(paths)}\n"] = word
            continue
        here = list(_of(str(word)))
        if not here:
            reason = "there is no scene in it" if os.path.isdir(word) else "no file matches"
            raise SceneError(
                f"{word}: {reason}; allowed: scenes, folders with scenes, patterns such as 'configs/*.yaml'"
            )
        for path in here:
            paths.setdefault(os.path.realpath(path), path)
    return list(paths.values())


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


def is_part(path: str | os.PathLike[str]) -> bool:
    """Tell whether a YAML file is made to be included by scenes (a robot, a trajectory), not a scene itself."""
    try:
        root = Includer(nodes.Faults()).open_root(os.fspath(path))
    except SceneError:
        return False
    if not isinstance(root, nodes.Mapping):
        return not isinstance(root, nodes.Scalar)
    return not any(root.get(key) is not None for key in ("schema", "robot", "command"))


# from what cannot be compared to what only the new tree has
RANK = {"unreadable": 0, "missing": 1, "differs": 2, "equal": 3, "extra": 4}

MOST_TOLD = 5  # datasets of one of many results


@record
class Compared:
    """A result beside its baseline.

    ``verdict`` is ``"equal"`` (within tolerance), ``"differs"``, ``"missing"`` (only in the baseline), ``"extra"``
    (only in the results) or ``"unreadable"``. message : why the two could not be compared. differing : datasets, worst
    first.
    """

    name: str
    verdict: str
    message: str = ""
    differing: tuple[Difference, ...] = ()

    @property
    def exit_code(self) -> int:
        """What this pair alone would end with."""
        return {"equal": 0, "extra": 0, "unreadable": ResultFileError.exit_code}.get(self.verdict, FAILED)

    @property
    def lines(self) -> list[str]:
        """Why the two could not be compared, or the datasets that differ most, in words."""
        lines = [self.message] if self.message else []
        lines += [f"{item.path}: {item.text}" for item in self.differing[:MOST_TOLD]]
        more = len(self.differing) - MOST_TOLD
        if more > 0:
            lines.append(f"and {more} more; robodyn compare of these two results lists all")
        return lines

    @property
    def sort_key(self) -> tuple[float, ...]:
        """Worst first: what cannot be compared, then datasets that cannot, then by how much they differ."""
        by_value = [item.ratio for item in self.differing if item.verdict == "differs"]
        odd = len(self.differing) - len(by_value)
        return RANK[self.verdict], -odd, -max(by_value, default=0.0)


def is_tree(path: Stored) -> bool:
    """Tell whether a path means all results below it: a directory that is not the output directory of a run."""
    return isinstance(path, Path) and path.is_dir() and not is_run(path)


def compare_trees(results: Path, baselines: Path, *, rtol: float, atol: float) -> list[Compared]:
    """Return how all results below two directories compare, worst first; what has the same path from there belongs
    together.

    Raises
    ------
    ResultFileError : there is no result below one of them.
    """
    new, old = _required(results, baselines), _required(baselines, results)
    pairs = [Compared(name, "missing") for name in old - new] + [
        Compared(name, "extra") for name in new - old
    ]
    for name in new & old:
        pairs.append(compare_stored(name, results / name, baselines / name, rtol=rtol, atol=atol))
    return sorted(pairs, key=lambda pair: (*pair.sort_key, pair.name))


def _required(root: Path, other: Path) -> set[str]:
    """Return the runs below a directory, of which there must be some since they are compared with those of another."""
    if not is_tree(root):
        raise ResultFileError(
            f"{root} is no directory with results below it, but {other} is; name two results or two such directories",
            path=str(root),
        )
    runs = runs_below(root)
    if not runs:
        raise ResultFileError(f"{root}: there is no result in it, nor below it", path=str(root))
    return runs


def runs_below(root: Path) -> set[str]:
    """Return the output directories of runs below a directory, by their paths from there."""
    runs = set()
    for folder, below, _ in os.walk(root):
        below[:] = [name for name in below if not name.startswith(".")]
        if is_run(Path(folder)):
            runs.add(Path(folder).relative_to(root).as_posix())
    return runs


def compare_stored(name: str, result: Path, baseline: Path, *, rtol: float, atol: float) -> Compared:
    """Return how the results of two output directories compare."""
    try:
        comparison = compare(read_run(result), read_run(baseline), rtol=rtol, atol=atol)
    except RobodynError as error:
        return Compared(name, "unreadable", error.message)
    return Compared(name, "equal" if comparison.agrees else "differs", differing=comparison.differing)


def read_run(directory: Path, select: Callable[[str], bool] | None = None) -> Result:
    """Return what a run left in its output directory; of one that failed before it had samples the status alone.

    Raises
    ------
    ResultFileError : there is nothing, or it cannot be read.
    """
    summary = read_summary(directory / SUMMARY_NAME)
    if (directory / RESULT_NAME).exists() or RUN_ID not in summary:
        return read_stored(directory, select)
    command, title, status = (str(summary.get(key)) for key in ("command", "title", "status"))
    return Result(command, title, status, "", summary=summary)


def is_run(directory: Path) -> bool:
    """Tell whether a directory is the output directory of a run."""
    return (directory / RESULT_NAME).exists() or RUN_ID in read_summary(directory / SUMMARY_NAME)

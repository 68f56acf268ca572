"""Each command as a function of Python, made of the declaration of its command line: the same words, defaults, checks.

The signature of ``command`` in ``cli/commands/NAME.py`` is the one list of what a command takes. A function takes its
arguments by place or by name and its options as keywords (``--own-settings`` is ``own_settings``, ``--with`` is
``with_``), as values of Python: maps for ``KEY=VALUE``, lists for words with commas. What the command would print is
kept, and what it would write stays in memory, unless ``out`` names a directory.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import logging
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.keywords import (
    OF_TERMINALS,
    OVERRIDES,
    Keyword,
    declared,
    gives_result,
    keywords,
    module_of,
    own_keywords,
)
from robodyn_cli.commands import COMMANDS, python_name
from robodyn_cli.errors import (
    RobodynError,
    SceneError,
    did_you_mean,
    no_linear_algebra,
    out_of_range,
)
from robodyn_cli.foreign import contents
from robodyn_cli.results.in_memory import InMemory
from robodyn_cli.results.report import Report
from robodyn_cli.results.result import Result

MOST_BYTES = 2_000_000_000  # of a picture or a page in memory
MOVIE = ".gif"  # kind of a picture that moves where none is asked for


class RobodynWarning(UserWarning):
    """What is doubtful about a scene or a run: what the command line prints as a warning."""


class Keeping(Console):
    """Keeps what a command would print, for a program in Python that has called it: nothing goes to any stream.

    result : what a command that runs something has found. told : what others would print as JSON. lines, notes,
    warnings, errors : what people would read. reached : is told how far a long run has come.
    """

    def __init__(self, reached: Callable[[float, float], None] | None = None) -> None:
        super().__init__()
        self.result: Result | None = None
        self.told: Any = None
        self.lines: list[str] = []
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.errors: list[str] = []
        self._tell = reached

    def say(self, text: str) -> None:
        self.lines.append(text)

    def note(self, text: str) -> None:
        self.notes.append(text)

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def error(self, text: str) -> None:
        self.errors.append(text)

    def data(self, report: Any) -> None:
        self.told = report

    def failed(self, error: RobodynError) -> int:
        raise error

    def takes(self, result: Result) -> bool:
        self.result = result
        return True

    @contextlib.contextmanager
    def waiting(self, doing: Callable[[], str]) -> Iterator[None]:
        yield

    def progress(self, done: float, total: float, unit: str = "s") -> None:
        if self._tell is not None:
            self._tell(done, total)

    def count(self, done: int, total: int, left: float | None) -> None:
        self.progress(done, total)

    def clear(self) -> None:
        pass


@functools.cache
def function(name: str) -> Callable[..., Any]:
    """Return the function of a command by its name in Python."""
    command = next(command for command in COMMANDS if python_name(command) == name)
    known = keywords(command)
    extra = own_keywords(command)

    def call(*arguments: Any, progress: Callable[[float, float], None] | None = None, **options: Any) -> Any:
        given = _bound(name, known, extra, arguments, options)
        return _called(command, known, given, Keeping(progress))

    call.__name__ = call.__qualname__ = name
    call.__module__ = "robodyn"
    call.__doc__ = described(command)
    call.__signature__ = signature(command)  # type: ignore[attr-defined]
    return call


def signature(command: str) -> inspect.Signature:
    """Return the signature of the function of a command: arguments by place, options by name."""
    kinds = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    taken = [
        inspect.Parameter(one.name, kinds[not one.is_argument], default=None if one.is_file else one.default)
        for one in keywords(command)
    ]
    extra = [p.replace(kind=kinds[1]) for p in own_keywords(command)]
    return inspect.Signature([*taken, *extra, inspect.Parameter("progress", kinds[1], default=None)])


def _bound(
    name: str, known: tuple[Keyword, ...], extra: tuple[inspect.Parameter, ...], arguments: tuple[Any, ...],
    options: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """Return what was given, by name.

    Raises
    ------
    SceneError : a keyword that there is not, one given twice, one that is missing.
    """
    places = [one.name for one in known if one.is_argument]
    allowed = [*(one.name for one in known), *(p.name for p in extra)]
    if len(arguments) > len(places):
        raise SceneError(
            f"{name}: {len(arguments)} arguments by place; allowed: {', '.join(places) or 'none'}, and options by name"
        )
    given = dict(zip(places, arguments))
    for option, value in options.items():
        if option in OF_TERMINALS:
            raise SceneError(f"{name}: {option} is an option of terminals: {OF_TERMINALS[option]}")
        if option not in allowed:
            hint = did_you_mean(option, allowed)
            raise SceneError(
                f"{name}: unknown keyword {option!r}{hint}; allowed: {', '.join([*allowed, 'progress'])}"
            )
        if option in given:
            raise SceneError(f"{name}: {option} is given twice")
        given[option] = value
    missing = [one.name for one in known if one.is_required and not one.is_file and one.name not in given]
    if missing:
        raise SceneError(f"{name}: {', '.join(missing)} is missing")
    return given


def _called(command: str, known: tuple[Keyword, ...], given: dict[str, Any], kept: Keeping) -> Any:
    """Return what a command finds: a result, or its report.

    Raises
    ------
    RobodynError : as the command line tells it.
    """
    own = {p.name: given.pop(p.name) for p in own_keywords(command) if p.name in given}
    values = {
        one.parameter: one.value(given[one.name]) if one.name in given else _absent(one)
        for one in known
        if not one.is_file or given.get(one.name) is not None
    }
    if own:
        prepared = module_of(command).in_python(values["scene"], values[OVERRIDES] or (), **own)
        values["scene"], values[OVERRIDES] = prepared
    work = functools.partial(declared(command), kept=kept, **values, **_silent(command))
    lacking = next((one for one in known if one.parameter not in values), None)
    with _errors():
        code, content = (work(), None) if lacking is None else _in_memory(work, lacking, kept)
    _tell(kept)
    if kept.result is not None:
        return kept.result
    return Report(kept.told or {}, "\n".join(kept.lines), code, content)


def _in_memory(work: Callable[..., int], file: Keyword, kept: Keeping) -> tuple[int, tuple[bytes, str]]:
    """Let a command write its one file into memory; return its exit code, the bytes and the end of the file's name."""
    with InMemory() as folder:
        path = folder.path / f"file{Path(file.form).suffix or MOVIE}"
        code = work(**{file.parameter: path})
        content = contents(path, MOST_BYTES)
    kept.lines = [line.replace(str(path), "in memory") for line in kept.lines]
    kept.told = {key: x for key, x in kept.told.items() if x != str(path)}
    return code, (content, path.suffix)


def _absent(one: Keyword) -> Any:
    return [] if one.default is None and one.many and one.info.default_factory is not None else one.default


def _silent(command: str) -> dict[str, Any]:
    """Return the options of terminals that a command has."""
    names = inspect.signature(declared(command)).parameters
    return {name: False for name in ("as_json", "quiet", "verbose") if name in names}


def _tell(kept: Keeping) -> None:
    for text in kept.warnings:
        warnings.warn(text, RobodynWarning, stacklevel=4)
    for text in kept.notes:
        logging.getLogger("robodyn").info(text.removeprefix("robodyn: "))


@contextlib.contextmanager
def _errors() -> Iterator[None]:
    """Raise errors of numbers as those of the command line."""
    try:
        yield
    except OverflowError as error:
        raise out_of_range(error) from error
    except ZeroDivisionError as error:
        raise no_linear_algebra(error) from error
    except ValueError as error:
        if type(error).__name__ != "LinAlgError":
            raise
        raise no_linear_algebra(error) from error


def described(command: str) -> str:
    """Return the docstring of the function of a command: its line of help, and what each keyword is."""
    lines = [COMMANDS[command].help, "", "Parameters", "----------"]
    lines += [f"{one.name} : {one.meaning}" for one in keywords(command)]
    lines += [f"{parameter.name} : see docs/python.md" for parameter in own_keywords(command)]
    lines.append("progress : Function that is told how far a long run has come, and of how much.")
    returns = "A Result." if gives_result(command) else "A Report."
    return "\n".join(
        [
            *lines,
            "",
            "Returns",
            "-------",
            returns,
            "",
            "Raises",
            "------",
            "RobodynError : as the command line tells it.",
        ]
    )

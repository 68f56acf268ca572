"""Read plain command lines without Typer.

Its import and its conversion of values take longer than a small run. What is read here calls a command
with the same values, and imports no other command; whatever is not plain (help, completion, mistakes, kinds of
parameter that this file does not know) is left to Typer. The root callback, which has nothing to do but
``--version``, is not called.
"""

from __future__ import annotations

import importlib
import inspect
import typing
from collections.abc import Callable, Sequence
from pathlib import Path
from types import NoneType
from typing import Any

from robodyn_cli.cli.parameters import Parameter

READERS: dict[Any, Callable[[str], Any]] = {Path: Path, str: str}


class NotPlain(Exception):
    """Typer has to look at this command line."""


def find_command(word: str) -> Callable[..., Any] | None:
    """Return the function of a command, ``command`` in the file of that name; None where there is none."""
    name = word.replace("-", "_")
    if not word.islower() or not name.isidentifier() or word != name.replace("_", "-"):
        return None
    try:
        module = importlib.import_module(f"robodyn_cli.cli.{name}")
    except ModuleNotFoundError:
        return None
    return getattr(module, "command", None)


def run_plain(words: Sequence[str]) -> None:
    """Run the command that the words call, and exit; return where they are not plain."""
    function = find_command(words[0]) if words else None
    if function is None:
        return
    try:
        values = read(function, words[1:])
    except NotPlain:
        return
    function(**values)
    raise SystemExit(0)


def read(function: Callable[..., Any], words: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of a command.

    Raises
    ------
    NotPlain : words or parameters that only Typer understands.
    """
    arguments: list[str] = []
    options: dict[str, str] = {}
    kinds: dict[str, Any] = {}
    values: dict[str, Any] = {}
    hints = typing.get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        kinds[name], note = _parts(hints[name])
        if note.names:
            options.update(dict.fromkeys(note.names, name))
        else:
            arguments.append(name)
        if parameter.default is not parameter.empty:
            values[name] = parameter.default
    given: list[str] = []
    waiting = list(words)
    while waiting:
        word = waiting.pop(0)
        if not word.startswith("-"):
            given.append(word)
            continue
        declared, has_value, value = word.partition("=") if word.startswith("--") else (word, "", "")
        option = options.get(declared)
        if option is None:
            raise NotPlain
        kind = kinds[option]
        if kind is bool:
            if has_value or values[option] is not False:
                raise NotPlain
            values[option] = True
            continue
        if not has_value:
            if not waiting or waiting[0].startswith("-"):
                raise NotPlain
            value = waiting.pop(0)
        if _is_list(kind):
            values[option] = [*(values[option] or []), _reader(kind)(value)]
        else:
            values[option] = _reader(kind)(value)
    if len(arguments) == 1 and given and _is_list(kinds[arguments[0]]):
        values[arguments[0]] = [_reader(kinds[arguments[0]])(word) for word in given]
        return values
    if len(given) != len(arguments) or any(_is_list(kinds[name]) for name in arguments):
        raise NotPlain
    for name, word in zip(arguments, given):
        values[name] = _reader(kinds[name])(word)
    return values


def _parts(hint: Any) -> tuple[Any, Parameter]:
    """Return the type of a parameter, None taken off, and what is declared beside it."""
    kind, *notes = typing.get_args(hint) if typing.get_origin(hint) is typing.Annotated else (hint,)
    if len(notes) != 1 or not isinstance(notes[0], Parameter):
        raise NotPlain
    some = [t for t in typing.get_args(kind) if t is not NoneType]
    if not _is_list(kind) and NoneType in typing.get_args(kind) and len(some) == 1:
        kind = some[0]
    return kind, notes[0]


def _is_list(kind: Any) -> bool:
    return typing.get_origin(kind) is list


def _reader(kind: Any) -> Callable[[str], Any]:
    """Return what turns a word into a value, or into an item of a list."""
    reader = READERS.get(typing.get_args(kind)[0] if _is_list(kind) else kind)
    if reader is None:
        raise NotPlain
    return reader

"""What the function of a command takes: read off the declaration of its command line, values of Python turned into its
words."""

from __future__ import annotations

import importlib
import inspect
import os
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import typer.models

from robodyn_cli.cli.options import with_shared
from robodyn_cli.commands import COMMANDS, python_name
from robodyn_cli.errors import SceneError, shown
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.text.nodes import IN_PYTHON
from robodyn_cli.scene.text.values import settings, text_of

# options that concern terminals alone: a function prints nothing
OF_TERMINALS = {"json": "a result has its summary as a map", "quiet": "nothing is printed",
                "verbose": "nothing is printed"}  # fmt: skip
SCENES = ("scene", "scenes", "source")  # arguments that may be a scene of any source
OVERRIDES = "overrides"
RESULTS = ("result", "results", "baseline", "more", "source")  # arguments that may be a result in memory


@record
class Keyword:
    """One argument or option of a command, as its function takes it.

    name : in Python. parameter : of the command's function. kind : its type; of a list that of its items. form : how
    its words are written, as ``KEY=VALUE``. info : what typer is told of it.
    """

    name: str
    parameter: str
    kind: Any
    many: bool
    optional: bool
    form: str
    info: typer.models.ParameterInfo
    default: Any

    @property
    def is_argument(self) -> bool:
        return isinstance(self.info, typer.models.ArgumentInfo)

    @property
    def is_required(self) -> bool:
        return self.default is inspect.Parameter.empty

    @property
    def is_file(self) -> bool:
        """Whether it is what a command writes, which a function may leave in memory."""
        return not self.is_argument and self.is_required and self.kind is Path

    @property
    def meaning(self) -> str:
        """What it is, in one line: the help of the command line."""
        if self.parameter == "out" and self.default is None and "default" in (self.info.help or ""):
            return "Directory for the result and its plots; without one it stays in memory, and nothing is drawn."
        return " ".join((self.info.help or self.form).split())

    def value(self, given: Any) -> Any:
        """Return what the command takes for a value of Python.

        Raises
        ------
        SceneError : it is not allowed.
        """
        if given is None and self.optional:
            return None
        try:
            if not self.many:
                return self._one(given)
            values = [self._one(x) for x in self._items(given)]
            if self.is_argument and self.is_required and not values:
                raise SceneError(f"nothing is given; allowed: {self.form}")
            return values
        except typer.BadParameter as error:
            raise SceneError(f"{self.name}: {error.message}") from None
        except SceneError as error:
            raise SceneError(error.beyond(IN_PYTHON), (self.name,)) from None

    def _items(self, given: Any) -> list[Any]:
        """Return the values of a list: of a map its entries as words."""
        if self.parameter == OVERRIDES:
            return list(settings(given))
        if isinstance(given, Mapping) and not (self.is_argument and self.parameter in SCENES):
            if "=" not in self.form:
                raise SceneError(f"{shown(given)} is a map; allowed: {self.form} or a list of them")
            return [self._entry(key, value) for key, value in given.items()]
        if isinstance(given, (list, tuple)):
            return list(given)
        return [given]

    def _entry(self, key: Any, value: Any) -> str:
        """Return an entry of a map as a word of the command line."""
        if "<=" in self.form:
            text = str(value).strip()
            return f"{key} {text}" if text[:1] in "<>" else f"{key} = {text}"
        if "LOW:HIGH" in self.form:
            if value is None:
                return str(key)
            return (
                f"{key}={':'.join(map(_word, value)) if isinstance(value, (list, tuple)) else _word(value)}"
            )
        return f"{key}={_word(value)}"

    def _one(self, given: Any) -> Any:
        if self.is_argument and self.parameter in (*SCENES, *RESULTS):
            return self._source(given)
        if self.kind is bool:
            if not isinstance(given, bool):
                raise SceneError(f"{shown(given)}; allowed: True or False")
            return given
        if self.kind is Path:
            path = _path(given)
            return path if self.info.parser is None else self.info.parser(str(path))
        word = self._joined(given)
        if self.info.parser is not None:
            return self.info.parser(word)
        return self._number(word) if self.kind in (int, float) else word

    def _source(self, given: Any) -> Any:
        """Return a scene or a result: paths as such, all else as it is."""
        of_scene, of_result = self.parameter in SCENES, self.parameter in RESULTS
        if of_result and isinstance(given, Result):
            return given
        if isinstance(given, Result):
            raise SceneError(f"{given!r} is a result; allowed: {'a scene, ' if of_scene else ''}a path")
        if of_scene and isinstance(given, str) and "\n" in given:
            return given
        if isinstance(given, (str, os.PathLike)):
            path = _path(given)
            return self.info.callback(path) if self.info.callback is not None else path
        if of_scene:
            return given  # refused where it is read
        raise SceneError(f"{shown(given)}; allowed: a path or a result")

    def _joined(self, given: Any) -> str:
        """Return a value as a word of the command line; a list is joined where words have commas."""
        if isinstance(given, (list, tuple)) and "," in self.form and "=" not in self.form:
            return ",".join(map(_word, given))
        if type(given).__module__ == "numpy" and given.ndim == 1 and "," in self.form:
            return ",".join(map(_word, given.tolist()))
        return _word(given)

    def _number(self, word: str) -> Any:
        low, high = self.info.min, self.info.max
        within = " and ".join(f"{sign} {x:g}" for sign, x in ((">=", low), ("<=", high)) if x is not None)
        allowed = f"allowed: a {'whole ' if self.kind is int else ''}number {within}".rstrip()
        try:
            value = self.kind(word)
        except ValueError:
            raise SceneError(f"{shown(word)}; {allowed}") from None
        if not (low is None or value >= low) or not (high is None or value <= high) or value != value:
            raise SceneError(f"{shown(word)}; {allowed}")
        return value


def _word(value: Any) -> str:
    return value if isinstance(value, str) else text_of(value)


def _path(given: Any) -> Path:
    if not isinstance(given, (str, os.PathLike)):
        raise SceneError(f"{shown(given)}; allowed: a path")
    return Path(os.fspath(given))


def keywords(command: str) -> tuple[Keyword, ...]:
    """Return what the function of a command takes: its arguments, then its options."""
    found = [_keyword(p) for p in inspect.signature(declared(command)).parameters.values()]
    kept = [one for one in found if one.name not in OF_TERMINALS]
    return tuple(sorted(kept, key=lambda one: not one.is_argument))


def _keyword(parameter: inspect.Parameter) -> Keyword:
    kind, info = typing.get_args(parameter.annotation)[:2]
    inner = [x for x in typing.get_args(kind) if x is not type(None)]
    optional = type(None) in typing.get_args(kind)
    if optional:
        kind = inner[0]
    many = typing.get_origin(kind) is list
    # inside ``Annotated`` typer takes the first word for the default
    words = [x for x in (info.default, *(info.param_decls or ())) if isinstance(x, str)]
    longest = max(words, key=len, default=parameter.name)
    default = parameter.default
    if info.default_factory is not None:
        default, optional = None, True
    return Keyword(
        name=python_name(longest.lstrip("-")), parameter=parameter.name,
        kind=typing.get_args(kind)[0] if many else kind, many=many, optional=optional, form=info.metavar or "",
        info=info, default=default,
    )  # fmt: skip


def module_of(command: str) -> Any:
    return importlib.import_module(f"robodyn_cli.cli.commands.{command.replace('-', '_')}")


def declared(command: str) -> Callable[..., int]:
    return with_shared(module_of(command).command)


def gives_result(command: str) -> bool:
    """Tell whether a command finds a result, which can be drawn, or a report."""
    row = COMMANDS[command]
    return bool(row.run or row.plots)


def own_keywords(command: str) -> tuple[inspect.Parameter, ...]:
    """Return what a function takes that no command line can give, as a controller: the module's ``in_python``."""
    prepare = vars(module_of(command)).get("in_python")
    return tuple(inspect.signature(prepare).parameters.values())[2:] if prepare is not None else ()

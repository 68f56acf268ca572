"""Command lines that are read without Typer give a command the same arguments."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer.main import get_command

from robodyn_cli.cli.app import app
from robodyn_cli.cli.parameters import argument, option
from robodyn_cli.cli.quick import NotPlain, find_command, read, run_plain

COMMANDS: dict[str, Callable[..., None]] = {
    str(info.name): inspect.unwrap(info.callback) for info in app.registered_commands if info.callback
}

PLAIN = [
    ["scene.yaml"],
    ["scene.yaml", "--json"],
    ["--quiet", "scene.yaml", "--json"],
    ["-q", "scene.yaml"],
    ["--set", "a.b=1", "scene.yaml", "--set=c=-2", "--set", "d=e=f"],
    ["scene.yaml", "--set="],
    ["a file with spaces.yaml"],
    ["scene.yaml", "--out", "dir"],
    ["-o", "dir", "scene.yaml", "--no-plots"],
    ["--out=", "scene.yaml"],
    ["scene.yaml", "--out", "first", "--out", "last"],
]
NOT_PLAIN = [
    [],
    ["--help"],
    ["-h"],
    ["scene.yaml", "other.yaml"],
    ["scene.yaml", "--nonsense"],
    ["scene.yaml", "--js"],
    ["scene.yaml", "--json=yes"],
    ["scene.yaml", "--set"],
    ["scene.yaml", "--set", "--json"],
    ["scene.yaml", "-qq"],
    ["--", "scene.yaml"],
    ["scene.yaml", "-"],
]


def by_typer(name: str, words: Sequence[str]) -> dict[str, Any]:
    group: Any = get_command(app)
    command = group.commands[name]
    found: dict[str, Any] = dict(command.make_context(name, list(words)).params)
    return found


@pytest.mark.parametrize("words", [*PLAIN, *NOT_PLAIN], ids=" ".join)
@pytest.mark.parametrize("name", COMMANDS)
def test_same_as_typer_or_left_to_it(name: str, words: list[str]) -> None:
    try:
        mine = read(COMMANDS[name], words)
    except NotPlain:
        return
    theirs = by_typer(name, words)
    assert mine.keys() == theirs.keys()
    for key in mine:
        # an option that may be given several times, and is not, is None, () or []
        nothing = theirs[key] in ((), []) and mine[key] is None
        assert nothing or (mine[key] == theirs[key] and type(mine[key]) is type(theirs[key])), key


@pytest.mark.parametrize("words", PLAIN, ids=" ".join)
@pytest.mark.parametrize("name", ["inverse", "simulate", "deploy"])
def test_plain_runs_are_read_here(name: str, words: list[str]) -> None:
    read(COMMANDS[name], words)


@pytest.mark.parametrize("words", NOT_PLAIN, ids=" ".join)
def test_what_is_not_plain_is_left_to_typer(words: list[str]) -> None:
    with pytest.raises(NotPlain):
        read(COMMANDS["inverse"], words)


def test_several_scenes() -> None:
    assert read(COMMANDS["validate"], ["a.yaml", "b.yaml"])["scenes"] == ["a.yaml", "b.yaml"]


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_is_found_by_its_file(name: str) -> None:
    assert find_command(name) is COMMANDS[name]


OTHER_WORDS = ["", "nonsense", "console", "app", "main", "quick", "work_precision", "..", "a b", "Inverse"]


@pytest.mark.parametrize("word", OTHER_WORDS)
def test_no_other_word_is_a_command(word: str) -> None:
    assert find_command(word) is None


NOTHING = [[], ["--version"], ["nonsense"], ["--help"], ["inverse"], ["inverse", "-h"]]


@pytest.mark.parametrize("words", NOTHING, ids=" ".join)
def test_nothing_runs(words: list[str]) -> None:
    assert run_plain(words) is None


def _checked(file: Annotated[Path, typer.Argument(exists=True)]) -> None: ...
def _from_environment(name: Annotated[str, typer.Option(envvar="NAME")] = "") -> None: ...
def _bare(name: str = "") -> None: ...


@pytest.mark.parametrize("function", [_checked, _from_environment, _bare])
def test_parameters_that_ask_for_more_are_left_to_typer(function: Callable[..., None]) -> None:
    with pytest.raises(NotPlain):
        read(function, ["x"])


def _counting(n: Annotated[int, option("--count", min=0, help="A number.")] = 3) -> None: ...


def test_kinds_not_known_are_left_to_typer_where_they_are_given() -> None:
    assert read(_counting, []) == {"n": 3}
    with pytest.raises(NotPlain):
        read(_counting, ["--count", "4"])


def _fail(code: Annotated[str, argument("CODE", "Code.")]) -> None:
    raise SystemExit(int(code))


def test_exit_code_is_the_command_s(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robodyn_cli.cli.inverse.command", _fail)
    with pytest.raises(SystemExit) as end:
        run_plain(["inverse", "5"])
    assert end.value.code == 5

"""The rows of commands: what each has, that its places are there and keep their contracts, and that no other table knows them."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import typer.main

from robodyn_cli.cli.app import app
from robodyn_cli.commands import COMMANDS, SCENE_COMMANDS, places
from robodyn_cli.errors import OF_STATUS
from robodyn_cli.over.many.command import BatchCommand
from robodyn_cli.registry import Registry
from robodyn_cli.report.registry import PLOTS, Plot
from robodyn_cli.scene.types import Scene
from tests.source import files, name_of, tree_of

pytestmark = pytest.mark.usefixtures("source_trees")
ROOT = Path(__file__).parents[2]
SECTIONS = {field.name for field in dataclasses.fields(Scene)}


def test_a_command_that_runs_has_a_check_and_no_other_has_one() -> None:
    assert set(places("run")) == set(places("check")) == set(SCENE_COMMANDS)


def test_what_asks_runs_asks_commands_that_run() -> None:
    for column in ("plan", "batch", "slopes", "together"):
        assert set(places(column)) <= set(SCENE_COMMANDS), column
    for name, row in COMMANDS.items():
        assert row.run or not (row.given or row.streamed or row.goes_on), name


def test_keys_of_rows_are_keys_of_scenes_and_their_status_is_good() -> None:
    for name, row in COMMANDS.items():
        assert {row.blames, *row.given} <= SECTIONS, name
        assert OF_STATUS[row.good] == 0, name


def test_every_plot_is_some_commands() -> None:
    """Each function of ``report/plots`` that draws is in the row of a command, under one name."""
    plots = (ROOT / "robodyn_cli" / "report" / "plots").glob("[!_]*.py")
    modules = [importlib.import_module(f"robodyn_cli.report.plots.{path.stem}") for path in plots]
    drawn = {name: x for module in modules for name, x in vars(module).items() if isinstance(x, Plot)}
    assert drawn == dict(PLOTS)
    assert all(len(set(row.plots)) == len(row.plots) for row in COMMANDS.values())


def needed(function: Callable[..., Any]) -> list[str]:
    """Return the parameters that a caller must give."""
    return [p.name for p in inspect.signature(function).parameters.values() if p.default is p.empty]


def is_run(name: str, member: Any) -> None:
    parameters = inspect.signature(member).parameters
    assert needed(member)[:1] == ["scene"] and {"progress", "watch"} <= set(parameters)
    assert ("writer" in parameters) == COMMANDS[name].streamed
    assert ("journal" in parameters) == COMMANDS[name].goes_on


def is_check(name: str, member: Any) -> None:
    assert needed(member) == ["scene"]


def is_plan(name: str, member: Any) -> None:
    assert needed(member) == ["scene"] and isinstance(member.inner, str)
    assert all(
        callable(getattr(member, x)) for x in ("outputs", "terms", "kernels", "choices", "equation_36")
    )


def is_batch(name: str, member: Any) -> None:
    assert issubclass(member, BatchCommand) and member().name == name


def is_slopes(name: str, member: Any) -> None:
    """A function, or the class of what is computed without any integration: of two scenes, which are compared."""
    assert needed(member) == (
        ["asked", "scene", "numbers"] if isinstance(member, type) else ["asked", "numbers"]
    )


def is_together(name: str, member: Any) -> None:
    assert COMMANDS[name].batch and COMMANDS[name].slopes
    assert needed(member) == [] and needed(member.__call__)[1:] == ["structure", "values", "of"]


CONTRACTS = {
    "run": is_run, "check": is_check, "plan": is_plan, "batch": is_batch, "slopes": is_slopes, "together": is_together,
}  # fmt: skip


@pytest.mark.parametrize("column", CONTRACTS)
def test_every_place_is_there_and_keeps_its_contract(column: str) -> None:
    found: Registry[Any] = Registry("robodyn_cli", places(column))
    for name, member in found.items():
        CONTRACTS[column](name, member)
    assert len({id(member) for member in found.values()}) == len(found)


# -- no other table ----------------------------------------------------------------------------------------
# by module, how often it tells commands apart by their names, and why it may; this list only ever shrinks
ALLOWED = {
    "robodyn_cli/__init__.py": (1, "functions of the package for Python, some of which are commands"),
    "robodyn_cli/commands.py": (1, "the rows"),
    "robodyn_cli/kernels/rolled/kernels.py": (1, "`inverse` is a recursion there, no command"),
    "robodyn_cli/over/many/keys.py": (1, "`simulate` is a section of the scene there, no command"),
    "robodyn_cli/scene/starters.py": (1, "the words of `robodyn new`, some of which are commands"),
    "robodyn_cli/cli/commands/crosscheck.py": (1, "what can be asked for by option: the keys of its table"),
    "robodyn_cli/over/crosscheck/crosscheck.py": (1, "a table without a default: what is compared"),
    "robodyn_cli/works/linearise/nominal.py": (1, "a table without a default: along what is linearised"),
    "robodyn_cli/report/figures.py": (1, "tables of main figures, which become a column"),
}
RUNS = frozenset(SCENE_COMMANDS)


def names_in(node: ast.AST | None) -> list[str]:
    """Return the texts that a node is or lists."""
    listed = node.elts if isinstance(node, (ast.Tuple, ast.List, ast.Set)) else [node]
    return [x.value for x in listed if isinstance(x, ast.Constant) and isinstance(x.value, str)]


def tells_apart(node: ast.AST) -> bool:
    """Tell whether a node decides by the names of commands: compares one, or lists several as keys or texts.

    A text that is the name of a command and means something else there (a size, a plan) is common as a key, so a map counts
    from two names on that scenes may give, or where all of its keys are commands.
    """
    if isinstance(node, ast.Compare):
        return any(RUNS & set(names_in(x)) for x in (node.left, *node.comparators))
    if isinstance(node, ast.MatchValue):
        return bool(RUNS & set(names_in(node.value)))
    if isinstance(node, ast.Dict):
        keys = [text for key in node.keys for text in names_in(key)]
        return len(RUNS & set(keys)) > 1 or (
            len(keys) == len(node.keys) and bool(keys) and set(keys) <= set(COMMANDS)
        )
    if isinstance(node, ast.Call):
        return len(RUNS & {x for argument in node.args for x in names_in(argument)}) > 1
    return isinstance(node, (ast.Tuple, ast.List, ast.Set)) and len(RUNS & set(names_in(node))) > 1


def decisions(tree: ast.AST) -> Iterator[int]:
    """Yield the lines that tell commands apart by their names, a listing within a comparison or a call once."""
    inside: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Compare, ast.Call)) and tells_apart(node):
            inside |= {x for x in ast.walk(node) if x is not node}
        if node not in inside and tells_apart(node):
            yield node.lineno  # type: ignore[attr-defined]


def test_no_other_table_knows_commands() -> None:
    found = {}
    named = re.compile(rf"""["']({"|".join(COMMANDS)})["']""")  # most files need not be taken apart
    for path in files():
        if named.search(path.read_text("utf-8")) and (lines := list(decisions(tree_of(path)))):
            found[name_of(path)] = lines
    assert {path: len(lines) for path, lines in found.items()} == {
        path: n for path, (n, _) in ALLOWED.items()
    }, found


@pytest.mark.parametrize(
    "code",
    [
        'if command == "deploy": pass',
        'if result.command in ("statics", "reach"): pass',
        'TABLE = {"inverse": 1, "simulate": 2}',
        'TABLE = {"size": 1}',
        'NAMES = ("inverse", "simulate")',
        'TABLE = dict.fromkeys(["inverse", "simulate"], 1)',
        'parser = choice("inverse", "simulate")',
        'match command:\n    case "deploy":\n        pass',
    ],
)  # fmt: skip
def test_another_table_would_be_found(code: str) -> None:
    assert len(list(decisions(ast.parse(code)))) == 1


@pytest.mark.parametrize(
    "code", ['facts = {"status": 1, "size": 2}', 'path = ("simulate", "step")', 'of("inverse")']
)
def test_texts_that_are_no_commands_are_left_alone(code: str) -> None:
    assert not list(decisions(ast.parse(code)))


def test_no_command_is_silent_for_long() -> None:
    """Those that need no time are named."""
    folder = ROOT / "robodyn_cli" / "cli" / "commands"
    silent = {
        path.stem
        for path in folder.glob("[!_]*.py")
        if not {"console.waiting(", "run_scene("} & set(re.findall(r"[\w.]+\(", path.read_text()))
    }
    assert silent == {"cache", "check", "new", "schema"}


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_in_the_help_parse_and_name_scenes_that_exist(name: str) -> None:
    group: Any = typer.main.get_command(app)
    command = group.get_command(None, name)
    examples = importlib.import_module(f"robodyn_cli.cli.commands.{name.replace('-', '_')}").EXAMPLES
    assert len(examples) >= (3 if name != "schema" else 2)  # which has no options
    for example in examples:
        first, *words = shlex.split(example.partition(" > ")[0])
        assert first == name
        command.make_context(name, list(words))
        for word in words:
            assert not word.startswith("configs/") or list(ROOT.glob(word)), word

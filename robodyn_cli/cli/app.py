"""The command line: one group over the table of commands, of which only the one that is called is imported."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

from robodyn_cli.cli.console import Console, guarded, output_lost
from robodyn_cli.cli.offers import words_whole
from robodyn_cli.cli.options import with_shared
from robodyn_cli.commands import COMMANDS, JOBS
from robodyn_cli.errors import WRONG_USAGE, RobodynError, did_you_mean, nearest_word
from robodyn_cli.version import __version__

PROGRAM = "robodyn"
HELP = "help"  # `robodyn help COMMAND` is `robodyn COMMAND --help`
WIDEST = max(map(len, COMMANDS))
LEAST_WIDTH = 50  # of help, to the parser
INDENTED = f"\n  {PROGRAM} "
EXAMPLES = f"\b\nExamples:{INDENTED}"  # the parser keeps the lines of a text that begins with a backspace
COMPLETION = "_ROBODYN_COMPLETE"  # set by the shell when it asks for completions


class UsageError(RobodynError):
    """The words on the command line make no sense (exit code 2)."""

    exit_code = WRONG_USAGE


def _read_at_once(parameter: Any) -> None:
    """Let a parameter read its words by its own parser, as a path or as text, and not through pydantic.

    Typer 0.29 and later import pydantic for that, which takes longer than all of a small run. What has no such parser,
    and an argument that is missing, stays with typer; so does everything in versions that describe no types.
    """
    described = vars(parameter).get("type_descriptor")
    if described is None or "process_value" in vars(parameter):
        return
    many = parameter.multiple or parameter.nargs == -1
    kind = get_args(described.annotation)[0] if many else described.annotation
    read: Any = described.parameter_info.parser or (kind if kind in (str, Path) else None)
    by_typer = parameter.process_value

    def process_value(ctx: Any, value: Any) -> Any:
        missing = parameter.value_is_missing(value)
        if parameter.required if missing else read is None:
            return by_typer(ctx, value)
        if many:
            value = [read(word) for word in value or ()]
        elif not missing:
            value = read(value)
        return value if parameter.callback is None else parameter.callback(ctx, parameter, value)

    parameter.process_value = process_value


def _no_type(ctx: Any) -> str:
    """Return what help says of the type of an argument, whose name says more than that of a class of Python."""
    return ""


class ReadsAtOnce:
    """A command or a group whose parameters read their words at once."""

    def get_params(self, ctx: Any) -> Any:
        parameters = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            _read_at_once(parameter)
            if parameter.param_type_name == "argument":
                parameter.display_type_rich = _no_type
        return parameters


class OneCommand(ReadsAtOnce, TyperCommand):
    """A command of the table."""


class Commands(ReadsAtOnce, TyperGroup):
    """The commands of the table, each imported when it is looked up."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in COMMANDS and cmd_name not in self.commands:
            module = importlib.import_module(f"robodyn_cli.cli.commands.{cmd_name.replace('-', '_')}")
            alone = typer.Typer(add_completion=False, rich_markup_mode=None)
            epilog = EXAMPLES + INDENTED.join(module.EXAMPLES)
            alone.command(cmd_name, cls=OneCommand, help=COMMANDS[cmd_name].help, epilog=epilog)(
                guarded(with_shared(module.command))
            )
            self.commands[cmd_name] = typer.main.get_command(alone)
        return self.commands.get(cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if ctx.resilient_parsing and args[0] == HELP:
            return None, None, []  # the shell asks what follows: the names of commands
        if args[0] not in COMMANDS and not ctx.resilient_parsing:
            ctx.fail(f"No such command {args[0]!r}{did_you_mean(args[0], COMMANDS)}.")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        for job in JOBS:
            with formatter.section(job):
                rows = [(name, command.help) for name, command in COMMANDS.items() if command.job == job]
                formatter.write_dl([(name.ljust(WIDEST), text) for name, text in rows])
        formatter.write_paragraph()
        formatter.write_text(f"'{PROGRAM} help COMMAND' shows the options of a command, with examples.")

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command that the words call, and leave with its exit code."""
        if not standalone_mode:
            return super().main(args, PROGRAM, complete_var, False, windows_expand_args, **extra)
        sys.exit(_outcome(self, list(sys.argv[1:] if args is None else args)))


def run(words: list[str]) -> int:
    """Run the command that the words call; return its exit code."""
    group = typer.main.get_command(app)
    if COMPLETION in os.environ:
        with words_whole():
            return int(group.main(words, PROGRAM, COMPLETION, standalone_mode=False) or 0)
    return _outcome(group, words)


def _outcome(group: Any, words: list[str]) -> int:
    """Parse the words and run the command; return its exit code.

    ``guarded`` reports errors of the command. Handled here are words that the parser refuses, and its own text (help,
    version) that cannot be written.
    """
    if words[:1] == [HELP]:
        words = [*words[1:2], "--help"]
    console = Console(as_json="--json" in words)
    columns = shutil.get_terminal_size().columns - 2  # narrower than the least that the parser takes
    narrow = {"terminal_width": columns} if columns < LEAST_WIDTH else {}
    try:
        with group.make_context(PROGRAM, words.copy() or ["--help"], **narrow) as context:
            return int(group.invoke(context) or 0)
    except typer.Exit as done:
        return done.exit_code if words else WRONG_USAGE
    except OSError as error:
        lost = output_lost(error, sys.stdout)
        return console.fail(lost) if lost is not None else 0
    except Exception as error:
        # typer may use its own copy of click, so its errors are recognised by this method
        if not hasattr(error, "format_message"):
            raise
        return console.fail(UsageError(_message(error, words)))


def _message(error: Any, words: list[str]) -> str:
    """Return the parser's error as one line that names the page of help."""
    text = " ".join(str(error.format_message()).split())
    if offered := vars(error).get("possibilities"):  # the parser offers whatever shares a few letters
        option = str(error.option_name)
        near = nearest_word(option.lstrip("-"), [name.lstrip("-") for name in offered])
        text = f"No such option: {option}" + ("" if near is None else f" (did you mean --{near}?)")
    page = f"{PROGRAM} {words[0]}" if words[:1] and words[0] in COMMANDS else PROGRAM
    return f"{text}{'' if text.endswith(('.', '?')) else '.'} See '{page} --help'."


app = typer.Typer(
    name=PROGRAM,
    cls=Commands,
    help="Inverse dynamics and simulation of robots and closed-loop mechanisms described in YAML.",
    # plain text looks the same in terminals and logs
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"{PROGRAM} {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    pass

"""Mistakes on the command line, said as all other errors are: prefix, JSON where it was asked for, exit code 2."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from typer.core import TyperGroup

from robodyn_cli.errors import RobodynError

JSON = "--json"
# the parser's way of saying things, and ours
WORDS = (
    (r"\. Did you mean (.+?)\?$", r" (did you mean \1?)"),
    (r" \(Possible options?: (.+?)\)$", r" (did you mean \1?)"),
    (r"Input should be (.+?), unable to parse .*", r"must be \1"),
    (r"Input should be ", "must be "),
    (r"greater than or equal to", "at least"),
    (r"less than or equal to", "at most"),
)


class UsageError(RobodynError):
    """The words on the command line do not make sense (exit code 2)."""

    exit_code = 2


class Commands(TyperGroup):
    """The commands of the program."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command that the words call; leave with its exit code where ``standalone_mode``."""
        words = list(sys.argv[1:] if args is None else args)
        try:
            code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except Exception as error:
            # typer brings its own copy of click, or uses the one installed: know its errors by what they can do
            if not standalone_mode or not hasattr(error, "format_message"):
                raise
            if type(error).__name__ == "NoArgsIsHelpError":
                error.show()  # type: ignore[attr-defined]
                sys.exit(UsageError.exit_code)
            _fail(error, words)
        if standalone_mode:
            sys.exit(code if isinstance(code, int) else 0)
        return code


def _fail(error: Any, words: list[str]) -> NoReturn:
    """Report what the parser of the command line refused."""
    from robodyn_cli.cli.console import Console

    text = " ".join(error.format_message().split()).removesuffix(".")
    for pattern, plain in WORDS:
        text = re.sub(pattern, plain, text)
    value = _value_of(getattr(error, "param", None), words)
    if value is not None:
        text += f" (value {value!r})"
    context = getattr(error, "ctx", None)
    command = getattr(getattr(context, "command", None), "name", None)
    page = "robodyn --help" if context is None or context.parent is None else f"robodyn {command} --help"
    message = f"{text[:1].lower()}{text[1:]}; see '{page}'"
    Console(as_json=JSON in words).fail(UsageError(message), UsageError.exit_code, message)


def _value_of(parameter: Any, words: list[str]) -> str | None:
    """Return the value that was given to an option, where it stands in a word of its own."""
    for name in getattr(parameter, "opts", ()):
        if name.startswith("-") and name in words[:-1]:
            return words[words.index(name) + 1]
    return None

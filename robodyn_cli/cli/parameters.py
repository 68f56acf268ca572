"""What commands take, declared without Typer: only help, completion and mistakes need it (see ``cli/quick.py``)."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any, get_args, get_origin

from robodyn_cli.record import record


@record
class Parameter:
    """What stands beside the type of an argument or option: ``Annotated[Path, option("--out", help="...")]``.

    names : of an option; an argument has none. settings : the rest, as Typer calls it.
    """

    names: tuple[str, ...]
    settings: dict[str, Any] = dataclasses.field(compare=False)  # Python 3.10 hashes what stands in Annotated


def argument(metavar: str, help: str) -> Parameter:
    """Declare an argument."""
    return Parameter((), {"metavar": metavar, "help": help, "show_default": False})


def option(
    *names: str, help: str, metavar: str | None = None, min: float | None = None, max: float | None = None
) -> Parameter:
    """Declare an option by its names; ``min`` and ``max`` bound a number."""
    return Parameter(names, {"help": help, "metavar": metavar, "min": min, "max": max})


def for_typer(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command as Typer wants to see it."""
    signature = inspect.signature(function, eval_str=True)
    kinds = {name: _translated(p.annotation) for name, p in signature.parameters.items()}

    @functools.wraps(function)
    def command(**values: Any) -> None:
        function(**values)

    command.__annotations__ = kinds
    command.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[p.replace(annotation=kinds[name]) for name, p in signature.parameters.items()]
    )
    return command


def _translated(hint: Any) -> Any:
    import typer

    if get_origin(hint) is not Annotated:
        return hint
    kind, *notes = get_args(hint)
    note = notes[0]
    if len(notes) != 1 or not isinstance(note, Parameter):
        return hint
    known = {name: value for name, value in note.settings.items() if value is not None}
    info = typer.Option(*note.names, **known) if note.names else typer.Argument(**known)
    return Annotated[kind, info]

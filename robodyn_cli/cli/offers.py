"""What a shell is offered for the value of an option: words that are known, names of a list, keys of the scene.

Nothing heavy is loaded, and nothing is said of what is wrong: that is told when the command runs.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import typer

Offer = Callable[[str], list[str]]

# what a key of a study or a search may vary over
VARIED = ("[", "linspace(", "logspace(", "uniform(", "triangular(", "normal(")
# by the shells' scripts: the line as it stands
LINES = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")


def choice(*allowed: str) -> Callable[[str], str]:
    """Return the parser of one of some words: a function that raises BadParameter for any other."""

    def read(word: str) -> str:
        if word not in allowed:
            raise typer.BadParameter(f"{word!r}; allowed: {', '.join(allowed)}")
        return word

    return read


def one_of(option: str, *allowed: str, **more: Any) -> Any:
    """Return an option that takes one of some words, which a shell offers."""
    return typer.Option(option, parser=choice(*allowed), autocompletion=begun_by(allowed), **more)


def begun_by(names: Iterable[str]) -> Offer:
    """Return what offers names by their begin; ``names`` may be looked up when it is asked, as those of a registry."""

    def offer(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return offer


def listed_of(offer: Offer) -> Offer:
    """Return what offers the last name of a list with commas, behind the others."""

    def offer_last(incomplete: str) -> list[str]:
        before, comma, begun = incomplete.rpartition(",")
        return [f"{before}{comma}{name}" for name in offer(begun)]

    return offer_last


def scene_on_line() -> str | None:
    """Return the scene of the command that is typed.

    The parser stops at an option without a value, so it is the first word of the line that is a YAML file.
    """
    words = [word.strip("'\"") for name in LINES for word in os.environ.get(name, "").split()]
    scene = next((word for word in words if word.endswith((".yaml", ".yml"))), None)
    return None if scene is None else os.path.expanduser(scene)


def keys(incomplete: str) -> list[str]:
    """Return the keys of the scene on the line, each with its ``=``; behind it the words that the key may be."""
    from robodyn_cli.scene.text.offered import offered_values

    return _with_values(incomplete, offered_values)


def varied_keys(incomplete: str) -> list[str]:
    """Return the keys of the scene on the line, each with its ``=``; behind it what a key may vary over."""
    return _with_values(incomplete, lambda scene, key: VARIED)


def _with_values(incomplete: str, values: Callable[[str, str], Iterable[str]]) -> list[str]:
    from robodyn_cli.scene.text.offered import offered_keys

    scene = scene_on_line()
    key, sign, begun = incomplete.partition("=")
    if scene is None:
        return []
    if not sign:
        return offered_keys(scene, incomplete)
    return [f"{key}={word}" for word in values(scene, key) if word.startswith(begun)]


@contextlib.contextmanager
def words_whole() -> Iterator[None]:
    """Let the parser see the word that is typed whole, where bash has cut it at ``=``; of what is offered for such a
    word bash takes what stands behind the sign."""
    words = os.environ.get("COMP_WORDS", "").split(" ")
    sign = next((k for k in (len(words) - 1, len(words) - 2) if k > 1 and words[k] == "="), None)
    if sign is None or os.environ.get("COMP_CWORD") != str(len(words) - 1):
        yield
        return
    whole = [*words[: sign - 1], "".join(words[sign - 1 :])]
    os.environ.update({"COMP_WORDS": " ".join(whole), "COMP_CWORD": str(len(whole) - 1)})
    offered = io.StringIO()
    try:
        with contextlib.redirect_stdout(offered):
            yield
    finally:
        before = f"{words[sign - 1]}="
        sys.stdout.write("".join(line.removeprefix(before) for line in offered.getvalue().splitlines(True)))


def bare_keys(incomplete: str) -> list[str]:
    """Return the keys of the scene on the line that may hold a number."""
    from robodyn_cli.scene.text.offered import offered_keys

    scene = scene_on_line()
    if scene is None:
        return []
    return [key.removesuffix("=") for key in offered_keys(scene, incomplete, numbers=True)]


def names_in(*sections: str, before: Sequence[str] = ("",), after: str = "") -> Offer:
    """Return what offers the names of what stands in sections of the scene on the line, ``robot.joints``.

    before : what is written in front of a name, each a way of its own (``q.``). after : what follows it.
    """

    def offer(incomplete: str) -> list[str]:
        from robodyn_cli.scene.text.offered import names_below

        scene = scene_on_line()
        found = (
            [] if scene is None else [name for section in sections for name in names_below(scene, section)]
        )
        return begun_by(f"{front}{name}{after}" for front in before for name in found)(incomplete)

    return offer


def outputs(after: str = "") -> Offer:
    """Return what offers the numbers of the summary that the scene on the line gives, a level at a time."""

    def offer(incomplete: str) -> list[str]:
        from robodyn_cli.scene.text.offered import command_in, summary_names
        from robodyn_cli.summaries.keys import written_numbers

        scene = scene_on_line()
        command = None if scene is None else command_in(scene)
        if scene is None or command is None:
            return []
        found: dict[str, None] = {}
        for key in written_numbers(command, summary_names(scene)):
            if key.startswith(incomplete):
                step, dot, _ = key[len(incomplete) :].partition(".")
                found[incomplete + step + (dot or after)] = None
        return list(found)

    return offer


def any_of(*offers: Offer) -> Offer:
    """Return what offers all that others do."""
    return lambda incomplete: [word for offer in offers for word in offer(incomplete)]

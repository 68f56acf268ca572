"""Why a key of a summary is refused, and what is nearest to it."""

from __future__ import annotations

from collections.abc import Iterator

from robodyn_cli.errors import did_you_mean
from robodyn_cli.summaries.facts import ANY
from robodyn_cli.summaries.keys import SHORT, Names, leaf_of, leaves_of

NO_NAMES: Names = {}
SHOWN = 12  # keys that a refusal lists


def refusal(command: str, key: str, names: Names = NO_NAMES, number: bool = False) -> str:
    """Return why a key of the summaries of a command is refused, with the nearest; an empty text where it is not.

    number : whether it must be one.
    """
    leaf = leaf_of(command, key)
    if leaf is not None and leaf.fits(names):
        return "" if leaf.is_number or not number else "is not a number but a text"
    options = list(dict.fromkeys(_written(command, names)))
    inner = [option for option in options if option.startswith(f"{key}.")]
    if inner:
        return f"holds several values; name one: {', '.join(inner[:SHOWN])}"
    head = key.partition(".")[0]
    near = [option for option in options if option.partition(".")[0] == head]
    heads = dict.fromkeys(option.partition(".")[0] for option in options)
    allowed = f"below {head!r}: {', '.join(near[:SHOWN])}" if near else f"allowed: {', '.join(heads)}"
    return f"the summary of {command} has no such key{did_you_mean(key, options)}; {allowed}"


def _written(command: str, names: Names) -> Iterator[str]:
    """Yield the keys of a command's summary as they may be written, with the names of a scene, as far as known."""
    for steps, _ in leaves_of(command):
        ways = [""]
        for step in steps:
            known = names.get(step, (step,)) if step.isupper() and step != ANY else (step,)
            ways = [f"{way}.{name}" if way else name for way in ways for name in known]
        yield from ways
        if steps[0] == SHORT and len(steps) == 3:
            yield from (f"{steps[2]}.{name}" for name in names.get(steps[1], ()))

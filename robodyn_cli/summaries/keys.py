"""The keys of summaries: whether a run may have one, and what its field says of it. One walk answers all of it.

Why a key of a summary is refused, and what is nearest to it.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import re
import types
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Union, get_args, get_origin, get_type_hints

from robodyn_cli.commands import COMMANDS
from robodyn_cli.errors import did_you_mean
from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ANY, Fact, UnitOf, key_of

NUMBERS = (float, int, bool)
VALUES = (*NUMBERS, str, types.NoneType)
SHORT = "joints"  # keys below ``joints.NAME`` may be written ``KEY.NAME``
EVERY_RUN = "facts:EveryRun", "checks:Judged"  # records of what is written beside the summary of a command
Names = Mapping[
    str, Collection[str]
]  # of a scene by kind (``JOINT``); of a kind that is not given there may be any


@record
class Leaf:
    """What stands under a key: its type, what its field says, the names that were passed, with their kinds, the key."""

    kind: Any
    fact: Fact
    names: tuple[str, ...] = ()
    kinds: tuple[tuple[str, ...], ...] = ()
    key: str = ""

    def fits(self, names: Names) -> bool:
        """Tell whether a scene has the names that were passed."""
        passed = zip(self.names, self.kinds)
        return all(
            any(name in (names.get(x, (name,)) if x.isupper() else (x,)) for x in kinds)
            for name, kinds in passed
        )

    @property
    def is_number(self) -> bool:
        """Whether it is a number, or true or false; of what is known of a failure it may be one."""
        return self.kind in NUMBERS or self.kind is Any

    def unit(self, coordinates: Mapping[str, str]) -> str:
        """Return the unit, from those of coordinates (``rad`` or ``m``) by name."""
        unit = self.fact.unit
        if not isinstance(unit, UnitOf):
            return unit
        return unit(next((coordinates[name] for name in reversed(self.names) if name in coordinates), ""))

    @property
    def errors(self) -> tuple[str, ...]:
        """Keys of the summary that state its error."""
        return tuple(
            self._beside(key) if key.startswith(".") else self._with_names(key) for key in self.fact.errors
        )

    def _beside(self, key: str) -> str:
        """Return a key beside this one; where it has names, beside the map that has them."""
        if not any(map(str.isupper, key.split("."))):
            return self.key.rpartition(".")[0] + key
        of_map = self.key.removesuffix(f".{self.names[-1]}")
        return of_map.rpartition(".")[0] + self._with_names(key, self.names[-1:])

    def _with_names(self, key: str, names: Sequence[str] | None = None) -> str:
        left = iter(self.names if names is None else names)
        return ".".join(next(left) if step.isupper() else step for step in key.split("."))


@functools.cache
def fields_at(place: str | type) -> Mapping[str, tuple[Any, Fact]]:
    """Return the type and the declaration of each field of a record, itself or its place below ``summaries/``."""
    if isinstance(place, str):
        module, _, member = place.partition(":")
        place = getattr(importlib.import_module(f"robodyn_cli.summaries.{module}"), member)
    hints = get_type_hints(place)
    return {key_of(f.name): (hints[f.name], f.metadata["fact"]) for f in dataclasses.fields(place)}  # type: ignore[arg-type]


@functools.lru_cache(maxsize=4096)
def leaf_of(command: str, key: str) -> Leaf | None:
    """Return what some run of a command has under a key of its summary; None where none has such a key.

    Any name will do (see ``Leaf.fits``). ``peak_torque.theta1`` is ``joints.theta1.peak_torque``.
    """
    steps = key.split(".")
    readings = (steps, [SHORT, *steps[1:], steps[0]])
    # lazily, so that a record of what few runs have is loaded where those before it have no such number
    found = (
        (fields_at(place), head, rest)
        for place in (*COMMANDS[command].summary, *EVERY_RUN)
        for head, *rest in readings
    )
    return _number_first(
        dataclasses.replace(leaf, key=".".join((head, *rest)))
        for fields, head, rest in found
        if head in fields and (leaf := _leaf(*fields[head], rest)) is not None
    )


def _leaf(kind: Any, fact: Fact, steps: Sequence[str]) -> Leaf | None:
    """Return what steps lead to from a value of a type; of several that are possible a number."""
    inner = get_args(kind)
    if get_origin(kind) in (Union, types.UnionType):
        return _number_first([_leaf(x, fact, steps) for x in inner])
    if kind is Any or not steps:
        return Leaf(kind, fact) if kind is Any or kind in VALUES else None
    if get_origin(kind) is list:
        return _leaf(inner[0], fact, steps[1:]) if steps[0].isdecimal() else None
    if get_origin(kind) is dict:
        return _in_map(inner[1], fact, steps)
    fields = fields_at(kind) if dataclasses.is_dataclass(kind) else {}  # type: ignore[arg-type]
    leaf = _leaf(*fields[steps[0]], steps[1:]) if steps[0] in fields else None
    if leaf is not None and fact.about_run:
        return dataclasses.replace(leaf, fact=dataclasses.replace(leaf.fact, about_run=True))
    return leaf


def _in_map(kind: Any, fact: Fact, steps: Sequence[str]) -> Leaf | None:
    """Return what steps lead to from a map, whose keys may have dots in them: the shortest that fits is taken."""
    for k in range(1, len(steps) + 1):
        name = ".".join(steps[:k])
        if any(kind_of.isupper() or name == kind_of for kind_of in fact.names):
            leaf = _leaf(kind, fact, steps[k:])
            if leaf is not None:
                return dataclasses.replace(leaf, names=(name, *leaf.names), kinds=(fact.names, *leaf.kinds))
    return None


def _number_first(leaves: Iterable[Leaf | None]) -> Leaf | None:
    """Return the first leaf that is a number, else the first one."""
    first = None
    for leaf in leaves:
        if leaf is not None and leaf.is_number:
            return leaf
        first = first or leaf
    return first


@functools.cache
def leaves_of(command: str) -> Sequence[tuple[tuple[str, ...], Leaf]]:
    """Return every key of the summaries of a command as steps, with what stands there.

    A kind of names (``JOINT``) stands for each of these, 0 for each place in a list.
    """
    return tuple(
        ((name, *steps), leaf)
        for place in (*COMMANDS[command].summary, *EVERY_RUN)
        for name, (kind, fact) in fields_at(place).items()
        for steps, leaf in _below(kind, fact)
    )


def _below(kind: Any, fact: Fact) -> Iterator[tuple[tuple[str, ...], Leaf]]:
    inner = get_args(kind)
    if kind in VALUES or kind is Any:
        yield (), Leaf(kind, fact)
    elif dataclasses.is_dataclass(kind):
        for name, (one, declared) in fields_at(kind).items():  # type: ignore[arg-type]
            yield from (((name, *steps), leaf) for steps, leaf in _below(one, declared))
    elif get_origin(kind) is dict:
        below = list(_below(inner[1], fact))
        yield from (((name, *steps), leaf) for name in fact.names for steps, leaf in below)
    elif get_origin(kind) is list:
        yield from ((("0", *steps), leaf) for steps, leaf in _below(inner[0], fact))
    else:
        for one in inner:
            yield from _below(one, fact)


def headline_rank(command: str, key: str) -> int:
    """Return the place of a key among the headlines of a command, their number where it is none of them."""
    ways = _headlines(command)
    return next((k for k, way in enumerate(ways) if way.fullmatch(key)), len(ways))


@functools.cache
def _headlines(command: str) -> Sequence[re.Pattern[str]]:
    keys = COMMANDS[command].headlines if command in COMMANDS else ()
    steps = (["(.+)" if step.isupper() else re.escape(step) for step in key.split(".")] for key in keys)
    return [re.compile(r"\.".join(one)) for one in steps]


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


def written_numbers(command: str, names: Names) -> Iterator[str]:
    """Yield the keys of the numbers of a command's summary that tell what a mechanism does."""
    for steps, leaf in leaves_of(command):
        if leaf.kind in NUMBERS and not leaf.fact.about_run and ANY not in steps:
            yield from _ways(steps, names)


def _written(command: str, names: Names) -> Iterator[str]:
    """Yield the keys of a command's summary as they may be written, with the names of a scene, as far as known."""
    for steps, _ in leaves_of(command):
        yield from _ways(steps, names)


def _ways(steps: Sequence[str], names: Names) -> Iterator[str]:
    """Yield the ways in which one key may be written."""
    ways = [""]
    for step in steps:
        known = names.get(step, (step,)) if step.isupper() and step != ANY else (step,)
        ways = [f"{way}.{name}" if way else name for way in ways for name in known]
    yield from ways
    if steps[0] == SHORT and len(steps) == 3:
        yield from (f"{steps[2]}.{name}" for name in names.get(steps[1], ()))

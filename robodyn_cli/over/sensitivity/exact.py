"""Exact derivatives of the outputs of a command, where it has such."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from robodyn_cli.commands import COMMANDS, places
from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.expr.by_keys import ByKeys
from robodyn_cli.kernels.program import Program
from robodyn_cli.over.many.keys import NUMBER, STRUCTURE, Key
from robodyn_cli.over.sensitivity.asked import Asked
from robodyn_cli.over.sensitivity.slope import Slope
from robodyn_cli.registry import Registry
from robodyn_cli.scene.types import Scene

Programs = Sequence[Program]
Found = dict[str, list[Slope]]  # by output, a derivative for each key
Work = Callable[[Asked, Sequence[int]], Found]  # of keys by their numbers
FOLLOWS = 1e-2  # part of a small change of a number by which its derivatives may miss it
ROUNDING = 1e-11  # of numbers that are computed, far below NEARBY
NEARBY = 1e-6  # part of a key's value, by which another scene differs whose equations are compared

works: Registry[Work] = Registry("robodyn_cli", places("slopes"))


def exact_slopes(asked: Asked) -> tuple[dict[tuple[str, int], Slope], dict[int, str]]:
    """Return exact derivatives by output and number of the key, and for keys without any the reason."""
    why = {k: reason for k, key in enumerate(asked.keys) if (reason := _obstacle(asked, key))}
    work = works.get(asked.task.command)
    found: dict[tuple[str, int], Slope] = {}
    if work is None:
        return found, dict.fromkeys(range(len(asked.keys)), f"{asked.task.command} has no exact derivatives")

    def attempt(numbers: Sequence[int]) -> None:
        try:
            slopes = work(asked, numbers)
        except RobodynError as obstacle:
            if len(numbers) == 1:
                why[numbers[0]] = obstacle.message
            for k in numbers if len(numbers) > 1 else ():  # one key may stand in the way of the others
                attempt([k])
            return
        found.update({(name, k): s for name, column in slopes.items() for k, s in zip(numbers, column)})

    if able := [k for k in range(len(asked.keys)) if k not in why]:
        attempt(able)
    return found, why


def _obstacle(asked: Asked, key: Key) -> str:
    """Return why a key has no exact derivatives; nothing where it may have them."""
    if key.name.partition(".")[0] in COMMANDS[asked.task.command].given:
        return ""
    if key.sort in (NUMBER, STRUCTURE) and (key.place or key.name) not in asked.placed:
        return "the key is part of the code (structure), not a number that it reads"
    return ""


def refuse_structure(asked: Asked, numbers: Sequence[int], own: Programs, other: Programs) -> None:
    """Refuse keys whose values are part of the code, or of numbers that do not know it: derivatives would not see them.

    Parameters
    ----------
    own, other : of the scene as it stands, and with the keys changed by ``NEARBY``.

    Raises
    ------
    CapabilityError
    """
    if [x.digest for x in own] != [x.digest for x in other]:
        raise CapabilityError(
            "the key is structure: an axis, an attitude, or what decides which terms there are"
        )
    by_keys = ByKeys({place: k for k, place in enumerate(asked.places(numbers)) if place})
    names = asked.task.keys  # of which no option sets a number of a formula, which stays
    steps = [0.0 if "#" in names[k] else NEARBY * (abs(asked.values[k]) or 1.0) for k in numbers]
    pairs = zip(
        (x for program in own for x in program.numbers), (y for program in other for y in program.numbers)
    )
    for x, y in pairs:
        slopes: Mapping[int, Any] = by_keys(x)
        expected = math.fsum(float(slope) * steps[k] for k, slope in slopes.items())
        found, size = float(y) - float(x), abs(float(x)) + abs(float(y))
        if abs(found - expected) > FOLLOWS * max(abs(found), abs(expected)) + ROUNDING * size:
            raise CapabilityError(
                "numbers of the equations follow from the key in a way that has no derivative"
            )


class Direct(Protocol):
    """What a command computes without any integration, for some keys: its programs, and their derivatives."""

    @property
    def programs(self) -> Programs: ...
    def slopes(self) -> Found: ...


def compared(
    kind: Callable[[Asked, Scene, Sequence[int]], Direct], asked: Asked, numbers: Sequence[int]
) -> Found:
    """Return the derivatives of a command without any integration, by keys that are no structure."""
    found = kind(asked, asked.scene, numbers)
    other = kind(asked, asked.changed(numbers, NEARBY), numbers)
    refuse_structure(asked, numbers, found.programs, other.programs)
    return found.slopes()

"""What a key of a scene varies over in a study: values of a grid, or a distribution to draw from."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.expr import formula as fm
from robodyn_cli.record import record

FORMS = (
    "allowed: [a, b, ...], linspace(a, b, n), logspace(a, b, n), uniform(low, high), "
    "triangular(low, mode, high), normal(mean, sd), where sd may be a percentage of the mean (5 %)"
)
MOST_VALUES = 1_000_000  # of one grid
_CALL = re.compile(r"\s*([A-Za-z_]\w*)\s*\((.*)\)\s*", re.DOTALL)
_LIST = re.compile(r"\s*\[(.*)\]\s*", re.DOTALL)


@record
class Variation:
    """What one key varies over.

    text : as it is written. values : of a grid, in SI units. distribution, arguments : the name of a distribution and
    its parameters, in SI units; without values. degrees : the numbers are given with ``deg``.
    """

    text: str
    values: tuple[float, ...] = ()
    distribution: str = ""
    arguments: tuple[float, ...] = ()
    degrees: bool = False

    @property
    def is_grid(self) -> bool:
        return not self.distribution

    @property
    def example(self) -> float:
        """One value that it takes: the first of a grid, the middle of a distribution."""
        return self.values[0] if self.is_grid else self.arguments[MIDDLE[self.distribution]]


# the argument that lies inside each distribution
MIDDLE = {"uniform": 0, "triangular": 1, "normal": 0}


def parse_variation(given: Any) -> Variation:
    """Return what a text, or a list of numbers and texts, varies over.

    Raises
    ------
    SceneError : it is none of the forms.
    """
    if isinstance(given, (list, tuple)):
        return _listed([str(x) for x in given], "[" + ", ".join(str(x) for x in given) + "]")
    text = " ".join(str(given).split())
    if match := _LIST.fullmatch(text):
        return _listed(_split(match.group(1)), text)
    match = _CALL.fullmatch(text)
    if match is None or match.group(1) not in _FORMS:
        raise SceneError(f"{text!r} is no range of values; {FORMS}")
    return _FORMS[match.group(1)](match.group(1), _split(match.group(2)), text)


def _listed(parts: Sequence[str], text: str) -> Variation:
    if not parts:
        raise SceneError(f"{text!r} has no values; {FORMS}")
    values, degrees = _numbers(parts, text)
    return Variation(text, values, degrees=degrees)


def _space(name: str, parts: Sequence[str], text: str) -> Variation:
    """Return ``linspace`` or ``logspace``: n values from a to b, equally spaced or with equal ratios."""
    if len(parts) != 3:
        raise SceneError(f"{text!r}: {name} takes three numbers; {FORMS}")
    (a, b, n), degrees = _numbers(parts, text)
    if not n.is_integer() or not 1 <= n <= MOST_VALUES:
        raise SceneError(
            f"{text!r}: the number of values is {parts[2].strip()}; allowed: a whole number from 1 to {MOST_VALUES}"
        )
    count = int(n)
    if name == "logspace" and not (a * b > 0.0):
        raise SceneError(f"{text!r}: logspace needs two numbers other than 0 of the same sign")
    parts_of_way = [k / (count - 1) if count > 1 else 0.0 for k in range(count)]
    linear = name == "linspace"
    values = [a + (b - a) * s if linear else a * (b / a) ** s for s in parts_of_way]
    if count > 1:
        values[-1] = b
    return Variation(text, tuple(values), degrees=degrees)


def _uniform(name: str, parts: Sequence[str], text: str) -> Variation:
    (low, high), degrees = _arguments(name, parts, 2, text)
    if not low < high:
        raise SceneError(f"{text!r}: the lower bound is not below the upper one")
    return Variation(text, distribution=name, arguments=(low, high), degrees=degrees)


def _triangular(name: str, parts: Sequence[str], text: str) -> Variation:
    (low, mode, high), degrees = _arguments(name, parts, 3, text)
    if not (low <= mode <= high and low < high):
        raise SceneError(f"{text!r}: needed are low <= mode <= high and low < high")
    return Variation(text, distribution=name, arguments=(low, mode, high), degrees=degrees)


def _normal(name: str, parts: Sequence[str], text: str) -> Variation:
    percent = len(parts) == 2 and parts[1].rstrip().endswith("%")
    plain = [parts[0], parts[1].rstrip().removesuffix("%")] if percent else parts
    (mean, sd), degrees = _arguments(name, plain, 2, text)
    if percent:
        if mean == 0.0:
            raise SceneError(f"{text!r}: a percentage of a mean of 0 is no scale; give sd as a number")
        sd *= abs(mean) / 100.0
    if not sd > 0.0:
        raise SceneError(f"{text!r}: the standard deviation is {sd:g}; allowed: a number > 0")
    return Variation(text, distribution=name, arguments=(mean, sd), degrees=degrees)


_FORMS: dict[str, Callable[[str, Sequence[str], str], Variation]] = {
    "linspace": _space,
    "logspace": _space,
    "uniform": _uniform,
    "triangular": _triangular,
    "normal": _normal,
}


def _arguments(name: str, parts: Sequence[str], count: int, text: str) -> tuple[tuple[float, ...], bool]:
    if len(parts) != count:
        raise SceneError(f"{text!r}: {name} takes {count} numbers; {FORMS}")
    return _numbers(parts, text)


def _numbers(parts: Sequence[str], text: str) -> tuple[tuple[float, ...], bool]:
    """Return the values of constant expressions, and whether any is in degrees."""
    values, degrees = [], False
    for part in parts:
        try:
            tree = fm.parse(part.strip())
        except SceneError as error:
            raise SceneError(f"{text!r}: {error.message}; {FORMS}") from error
        if tree.constant is None or not math.isfinite(tree.constant):
            raise SceneError(f"{text!r}: {part.strip()!r} is not a finite number; {FORMS}")
        values.append(tree.constant)
        degrees = degrees or tree.degrees
    return tuple(values), degrees


def _split(text: str) -> list[str]:
    """Return the parts between commas that are not inside brackets."""
    parts, depth, start = [], 0, 0
    for place, sign in enumerate(text):
        depth += (sign in "([") - (sign in ")]")
        if sign == "," and depth == 0:
            parts.append(text[start:place])
            start = place + 1
    parts.append(text[start:])
    return parts if any(part.strip() for part in parts) else []

"""Statements about values, as a scene writes them: what is expected of one, and what a key varies over."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.expr import formula as fm
from robodyn_cli.record import record

FORMS = (
    "allowed: a value, 'a +- b', 'a +- b %', 'a .. b', '< a', '<= a', '> a', '>= a' (the last two in quotes)"
)
# keys of summaries whose figures are in degrees
IN_DEGREES = frozenset({"angles_deg", "smallest_deg", "largest_deg"})
_MOST_DIGITS = 17  # of a float
_BOUND = re.compile(r"(<=|>=|<|>)(.*)", re.DOTALL)


@record
class Expectation:
    """The value that is expected: between ``low`` and ``high`` (excluded where ``strict``), or exactly ``value``.

    unit : of its numbers here, the SI unit of that in which they are written (``deg`` of figures in degrees); empty
    where they are written without one.
    """

    text: str
    low: float = -math.inf
    high: float = math.inf
    strict: bool = False
    value: bool | str | None = None
    numeric: bool = False
    unit: str = ""

    def holds(self, actual: Any) -> bool:
        """Tell whether a value is as expected."""
        if not self.numeric:
            return type(actual) is type(self.value) and actual == self.value
        if isinstance(actual, bool) or not isinstance(actual, (int, float)):
            return False
        if self.strict:
            return self.low < actual and (actual < self.high or self.high == math.inf)
        return self.low <= actual <= self.high

    def shown(self, actual: Any) -> str:
        """Return a value in words: in the unit of its bounds, with as many digits as tell whether it is as expected."""
        if actual is None or isinstance(actual, bool):
            return "null" if actual is None else str(actual).lower()
        unit, factor = self._written()
        if not isinstance(actual, (int, float)) or (isinstance(actual, int) and not unit):
            return str(actual)
        for digits in range(9, _MOST_DIGITS + 1):
            text = f"{actual / factor:.{digits}g}"
            if self.holds(float(text) * factor) == self.holds(actual):
                break
        return f"{text} {unit}".rstrip()

    def _written(self) -> tuple[str, float]:
        """Return the unit in which its numbers are written, and how many of ``unit`` it is."""
        from robodyn_cli.expr import units

        own = units.of(self.unit) if self.unit else None
        for match in re.finditer(r"(?<=[0-9.)])\s*(?=[A-Za-z])", self.text if own else ""):
            read = units.match(self.text, match.end())
            if own and read and read[0].dims == own.dims:
                return self.text[match.end() : read[1]], read[0].factor / own.factor
        return self.unit, 1.0


def parse_expectation(value: bool | int | float | str | None, key: str = "") -> Expectation:
    """Return the expectation that a YAML scalar means of a key of the summary.

    Raises
    ------
    SceneError : it is none.
    """
    expected = _expectation(value)
    if expected.unit != "rad" or not IN_DEGREES.intersection(key.split(".")):
        return expected
    low, high = math.degrees(expected.low), math.degrees(expected.high)
    return dataclasses.replace(expected, low=low, high=high, unit="deg")


def _expectation(value: bool | int | float | str | None) -> Expectation:
    if value is None or isinstance(value, bool):
        return Expectation("null" if value is None else str(value).lower(), value=value)
    if not isinstance(value, str):
        if not math.isfinite(value):
            raise SceneError(f"is not finite (value {value}); {FORMS}")
        return Expectation(
            f"{value:.17g}" if isinstance(value, float) else str(value), value, value, numeric=True
        )
    text = " ".join(value.replace("\N{PLUS-MINUS SIGN}", "+-").split())
    if match := _BOUND.match(text):
        sign, (limit,), unit = match.group(1), *quantities([match.group(2)], text, FORMS)
        bounds = (limit, math.inf) if sign.startswith(">") else (-math.inf, limit)
        return Expectation(text, *bounds, strict="=" not in sign, numeric=True, unit=unit)
    if "+-" in text:
        return _around(text)
    if ".." in text:
        (least, most), unit = quantities(text.split("..", 1), text, FORMS)
        expectation = Expectation(text, least, most, numeric=True, unit=unit)
        if expectation.low > expectation.high:
            raise SceneError(f"{text!r}: the first number is the larger one; {FORMS}")
        return expectation
    try:
        (exact,), unit = quantities([text] if any(c.isdigit() for c in text) else ["no number"], text, FORMS)
    except SceneError:
        return Expectation(text, value=text)
    return Expectation(text, exact, exact, numeric=True, unit=unit)


def _around(text: str) -> Expectation:
    left, _, right = text.partition("+-")
    percent = right.rstrip().endswith("%")
    (centre, width), unit = quantities([left, right.rstrip().removesuffix("%")], text, FORMS)
    if percent:
        width *= abs(centre) / 100.0
    if width < 0.0:
        raise SceneError(f"{text!r}: the tolerance is negative; {FORMS}")
    return Expectation(text, centre - width, centre + width, numeric=True, unit=unit)


RANGES = (
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
    its parameters, in SI units; without values. unit : in which the numbers are written, as SI unit.
    """

    text: str
    values: tuple[float, ...] = ()
    distribution: str = ""
    arguments: tuple[float, ...] = ()
    unit: str = ""

    @property
    def is_grid(self) -> bool:
        return not self.distribution

    @property
    def example(self) -> float:
        """One value that it takes: the first of a grid, the middle of a distribution."""
        return self.values[0] if self.is_grid else self.arguments[MIDDLE[self.distribution]]


def written_arguments(variation: Variation) -> list[str]:
    """Return the parameters of a distribution as they are written: ``5 deg`` and ``10 deg``."""
    match = _CALL.fullmatch(variation.text)
    return [part.strip() for part in _split(match.group(2))] if match else []


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
    if match is None or match.group(1) not in _READERS:
        raise SceneError(f"{text!r} is no range of values; {RANGES}")
    return _READERS[match.group(1)](match.group(1), _split(match.group(2)), text)


def _listed(parts: Sequence[str], text: str) -> Variation:
    if not parts:
        raise SceneError(f"{text!r} has no values; {RANGES}")
    values, unit = quantities(parts, text)
    return Variation(text, values, unit=unit)


def _space(name: str, parts: Sequence[str], text: str) -> Variation:
    """Return ``linspace`` or ``logspace``: n values from a to b, equally spaced or with equal ratios."""
    if len(parts) != 3:
        raise SceneError(f"{text!r}: {name} takes three numbers; {RANGES}")
    (a, b), unit = quantities(parts[:2], text)
    (n,), unit_of_n = quantities(parts[2:], text)
    if unit_of_n or not n.is_integer() or not 1 <= n <= MOST_VALUES:
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
    return Variation(text, tuple(values), unit=unit)


def _uniform(name: str, parts: Sequence[str], text: str) -> Variation:
    (low, high), unit = _arguments(name, parts, 2, text)
    if not low < high:
        raise SceneError(f"{text!r}: the lower bound is not below the upper one")
    return Variation(text, distribution=name, arguments=(low, high), unit=unit)


def _triangular(name: str, parts: Sequence[str], text: str) -> Variation:
    (low, mode, high), unit = _arguments(name, parts, 3, text)
    if not (low <= mode <= high and low < high):
        raise SceneError(f"{text!r}: needed are low <= mode <= high and low < high")
    return Variation(text, distribution=name, arguments=(low, mode, high), unit=unit)


def _normal(name: str, parts: Sequence[str], text: str) -> Variation:
    percent = len(parts) == 2 and parts[1].rstrip().endswith("%")
    plain = [parts[0], parts[1].rstrip().removesuffix("%")] if percent else parts
    (mean, sd), unit = _arguments(name, plain, 2, text)
    if percent:
        if mean == 0.0:
            raise SceneError(f"{text!r}: a percentage of a mean of 0 is no scale; give sd as a number")
        sd *= abs(mean) / 100.0
    if not sd > 0.0:
        raise SceneError(f"{text!r}: the standard deviation is {sd:g}; allowed: a number > 0")
    return Variation(text, distribution=name, arguments=(mean, sd), unit=unit)


_READERS: dict[str, Callable[[str, Sequence[str], str], Variation]] = {
    "linspace": _space,
    "logspace": _space,
    "uniform": _uniform,
    "triangular": _triangular,
    "normal": _normal,
}


def _arguments(name: str, parts: Sequence[str], count: int, text: str) -> tuple[tuple[float, ...], str]:
    if len(parts) != count:
        raise SceneError(f"{text!r}: {name} takes {count} numbers; {RANGES}")
    return quantities(parts, text)


def quantities(parts: Sequence[str], text: str, forms: str = RANGES) -> tuple[tuple[float, ...], str]:
    """Return the values of constant expressions in SI units, and their unit; empty where none has one.

    text, forms : what all of it is, and what it may be, for errors.

    Raises
    ------
    SceneError : a part is no finite number, or they are of different kinds.
    """
    from robodyn_cli.expr import units

    values = []
    unit: units.Dims | None = None
    for part in parts:
        try:
            tree = fm.parse(part.strip())
            unit = units.combined("+", unit, tree.dims)
        except SceneError as error:
            raise SceneError(f"{text!r}: {error.message}; {forms}") from error
        if tree.constant is None or not math.isfinite(tree.constant):
            raise SceneError(f"{text!r}: {part.strip()!r} is not a finite number; {forms}")
        values.append(tree.constant)
    return tuple(values), "" if unit is None else units.written(unit) or "1"


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

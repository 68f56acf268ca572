"""What is expected of a value: ``12.283 +- 0.001``, ``< 170``, ``1 .. 2``, or exactly a number, a text, true."""

from __future__ import annotations

import math
import re
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.expr import formula as fm
from robodyn_cli.record import record

FORMS = (
    "allowed: a value, 'a +- b', 'a +- b %', 'a .. b', '< a', '<= a', '> a', '>= a' (the last two in quotes)"
)
_BOUND = re.compile(r"(<=|>=|<|>)(.*)", re.DOTALL)


@record
class Expectation:
    """The value that is expected: between ``low`` and ``high`` (excluded where ``strict``), or exactly ``value``."""

    text: str
    low: float = -math.inf
    high: float = math.inf
    strict: bool = False
    value: bool | str | None = None
    numeric: bool = False

    def holds(self, found: Any) -> bool:
        """Tell whether a value is as expected."""
        if not self.numeric:
            return type(found) is type(self.value) and found == self.value
        if isinstance(found, bool) or not isinstance(found, (int, float)):
            return False
        if self.strict:
            return self.low < found < self.high
        return self.low <= found <= self.high


def parse_expectation(value: bool | int | float | str | None) -> Expectation:
    """Return the expectation that a YAML scalar means.

    Raises
    ------
    SceneError : it is none.
    """
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
        sign, limit = match.group(1), _number(match.group(2), text)
        bounds = (limit, math.inf) if sign.startswith(">") else (-math.inf, limit)
        return Expectation(text, *bounds, strict="=" not in sign, numeric=True)
    if "+-" in text:
        return _around(text)
    if ".." in text:
        low, _, high = text.partition("..")
        found = Expectation(text, _number(low, text), _number(high, text), numeric=True)
        if found.low > found.high:
            raise SceneError(f"{text!r}: the first number is the larger one; {FORMS}")
        return found
    exact = _constant(text) if any(c.isdigit() for c in text) else None
    return Expectation(text, value=text) if exact is None else Expectation(text, exact, exact, numeric=True)


def _around(text: str) -> Expectation:
    left, _, right = text.partition("+-")
    centre = _number(left, text)
    percent = right.rstrip().endswith("%")
    width = _number(right.rstrip().removesuffix("%"), text)
    if percent:
        width *= abs(centre) / 100.0
    if width < 0.0:
        raise SceneError(f"{text!r}: the tolerance is negative; {FORMS}")
    return Expectation(text, centre - width, centre + width, numeric=True)


def _number(part: str, text: str) -> float:
    found = _constant(part.strip())
    if found is None:
        raise SceneError(f"{text!r}: {part.strip()!r} is not a number; {FORMS}")
    return found


def _constant(text: str) -> float | None:
    """Return the value of a constant expression, None if the text is something else."""
    try:
        return fm.parse(text).constant
    except SceneError:
        return None

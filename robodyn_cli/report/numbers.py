"""Numbers, units and words as people read them in drawings, pages and terminals: without matplotlib."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from robodyn_cli.summaries.facts import rounded_up

if TYPE_CHECKING:
    from robodyn_cli.results.result import Result
    from robodyn_cli.results.stated_errors import Stated

_SUPERSCRIPT = str.maketrans("-\N{MINUS SIGN}.0123456789", "⁻⁻·⁰¹²³⁴⁵⁶⁷⁸⁹")


def raised(exponent: str) -> str:
    """Return a number as an exponent: ``1.3`` -> ``¹·³``."""
    return exponent.translate(_SUPERSCRIPT)


def unit(units: str) -> str:
    """Return units of the file as printed: ``N m`` -> ``N·m``, ``rad/s^2`` -> ``rad/s²``."""
    text = units.replace("^2", "²").replace("^3", "³")
    for word in (" or ", " and ", ", ", "; ", " of a ", "per "):
        text = text.replace(word, word.replace(" ", "\N{NO-BREAK SPACE}"))
    return text.replace(" ", "·").replace("\N{NO-BREAK SPACE}", " ")


def labelled(quantity: str, units: str) -> str:
    """Return an axis label with its units, which are 1 for a plain number."""
    return f"{quantity} [{unit(units) or '1'}]"


def load_label(quantity: str, units: str) -> str:
    """Return the label of an axis of joint loads, which are torques or forces by their units; else ``quantity``."""
    return labelled({"N m": "torque", "N": "force"}.get(units, quantity), units)


def position_word(units: str) -> str:
    """Return what positions of joints in these units are."""
    return {"rad": "joint angle", "m": "joint displacement"}.get(units, "joint position")


def number(value: float, digits: int = 3) -> str:
    """Return a number for a caption: short, with a true minus and a power of ten where it helps."""
    if not math.isfinite(value):
        return "not finite"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa}·{power(int(exponent))}"
    return text.replace("-", "−")


def error_number(value: float, digits: int = 3) -> str:
    """Return an error for a caption: like ``number``, rounded up."""
    return number(rounded_up(float(value), digits), digits)


_BEFORE_UNIT = re.compile(r"(?<=[\d⁰¹²³⁴⁵⁶⁷⁸⁹]) (?=[A-Za-zµ°%])")


def tied(text: str) -> str:
    """Return a text in which no line ends between a number and its unit."""
    return _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", text)


def power(exponent: int) -> str:
    """Return ten to a power with raised digits."""
    return "10" + str(exponent).translate(_SUPERSCRIPT)


PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
# units that prefixes go before, and from which size on they do; longer times are seconds all the same
PREFIXED = {"s": 1e15, "m": 1e4, "m/s": 1e4, "m/s²": 1e4, "N": 1e4, "N·m": 1e4, "J": 1e4, "W": 1e4}
SMALL = 0.1  # size below which they do


def prefix(size: float, units: str) -> tuple[str, float]:
    """Return a unit as printed, with an SI prefix where that suits values as large as ``size``, and how many of it
    make one of the unit."""
    if units not in PREFIXED or not 0.0 < size < math.inf or SMALL <= size < PREFIXED[units]:
        return units, 1.0
    exponent = 3 * math.floor(math.log10(size * (1.0 + 1e-9)) / 3.0)
    return (PREFIXES[exponent] + units, 10.0**-exponent) if exponent in PREFIXES else (units, 1.0)


def times(values: Sequence[float], digits: int = 4) -> list[str]:
    """Return times [s] for captions, all in the same unit: ``497 ns``."""
    word, factor = prefix(max((abs(x) for x in values if math.isfinite(x)), default=0.0), "s")
    return [f"{number(float(x) * factor, digits)} {word}" for x in values]


NUMBER = re.compile(r"(?<![\w.])(-?)(\d+(?:\.\d+)?)(?:e([+-]?\d+))?(?![\w.])")
PRODUCT = re.compile(r"(?<=\bN) (?=[ms]\b)|(?<=\bm) (?=s\b)")  # a space that stands for a product of units


def typeset(text: str) -> str:
    """Return words as printed: numbers with true signs and powers of ten, products and powers of units."""

    if text == "-":
        return "–"

    def one(found: re.Match[str]) -> str:
        sign, mantissa, exponent = found.groups()
        raised = f"·{power(int(exponent))}" if exponent else ""
        return f"{'−' if sign else ''}{mantissa}{raised}"

    signs = text.replace("^2", "²").replace("^3", "³").replace(" +- ", " ± ")
    return PRODUCT.sub("·", NUMBER.sub(one, signs))


def stated_words(one: Stated, result: Result) -> str:
    """Return what the summary of a result states of an error in words, with its unit."""
    from robodyn_cli.report.figures import unit_of_error  # where an error is printed

    own = unit_of_error(result, one)
    parts = one.words, error_number(one.value, 2), unit(own) if own != "1" else ""
    return " ".join(filter(None, parts))

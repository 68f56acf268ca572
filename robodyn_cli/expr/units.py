"""Units that a number of a scene may carry: one table of words with exact factors, their products and quotients.

A library of units (pint) loads longer than a whole scene, takes words without end, among them names that a formula may
have, and multiplies by factors that are rounded. The words of mechanisms are few. Each is a ratio of whole numbers, and
a power of pi, times units of the SI, so ``500 mm`` is the float that is nearest to 0.5, as if it were written so.
"""

from __future__ import annotations

import functools
import math
import re

from robodyn_cli.errors import SceneError, did_you_mean
from robodyn_cli.record import record

BASES = ("kg", "m", "s", "rad", "A", "K", "degC")
Dims = tuple[int, ...]  # powers of the bases
PLAIN: Dims = (0,) * len(BASES)

# a word, its factor, and what it is of; an angle is a kind of its own, so that neither 5 Hz nor 5 N m is taken for 5
# rad/s or 5 N m/rad
_TABLE = """
km 1000 m | dm 1/10 m | cm 1/100 m | mm 1/1000 m | um 1/1000000 m | nm 1/1000000000 m
inch 254/10000 m | ft 3048/10000 m
mrad 1/1000 rad | deg pi/180 rad | arcmin pi/10800 rad | arcsec pi/648000 rad | rev 2*pi rad
ms 1/1000 s | us 1/1000000 s | min 60 s | h 3600 s | Hz 1 s^-1 | kHz 1000 s^-1 | rpm pi/30 rad s^-1
g 1/1000 kg | gram 1/1000 kg | mg 1/1000000 kg | tonne 1000 kg | lb 45359237/100000000 kg
N 1 kg m s^-2 | mN 1/1000 N | kN 1000 N | MN 1000000 N | lbf 44482216152605/10000000000000 N
Nm 1 N m | Nmm 1/1000 N m | Ncm 1/100 N m | mNm 1/1000 N m | kNm 1000 N m
J 1 N m | mJ 1/1000 J | kJ 1000 J | W 1 J s^-1 | mW 1/1000 W | kW 1000 W
Pa 1 N m^-2 | kPa 1000 Pa | MPa 1000000 Pa | GPa 1000000000 Pa | bar 100000 Pa
mA 1/1000 A | V 1 W A^-1 | mV 1/1000 V | kV 1000 V | ohm 1 V A^-1 | mohm 1/1000 ohm
H 1 V s A^-1 | mH 1/1000 H | uH 1/1000000 H
"""

# what a quantity is called, by its unit
KINDS = {
    "m": "length", "kg": "mass", "s": "time", "rad": "angle", "1": "number without unit", "1/s": "frequency",
    "m/s": "speed", "m/s^2": "acceleration", "m/s^3": "jerk", "rad/s": "angular rate",
    "rad/s^2": "angular acceleration", "rad/s^3": "angular jerk", "N": "force", "N m": "torque",
    "N/m": "stiffness", "N m/rad": "angular stiffness", "N s/m": "damping", "N m s/rad": "angular damping",
    "kg m^2": "moment of inertia", "W": "power", "Pa": "pressure", "m^2": "area", "m/rad": "pitch",
    "A": "current", "V": "voltage", "ohm": "resistance", "H": "inductance", "K": "temperature difference",
    "degC": "temperature", "N m/A": "torque constant", "K/W": "thermal resistance", "J": "energy", "N s": "impulse",
    "N m s": "angular impulse",
}  # fmt: skip

_STEP = re.compile(
    r"(\s*[*/]\s*|\s*)([A-Za-z]+)(?![A-Za-z0-9_.]|\s*\()(?:\s*(?:\^|\*\*)\s*(-?[0-9])(?![.0-9]))?"
)
_NUMBER = re.compile(r"([0-9]*)\.?([0-9]*)(?:[eE]([-+]?[0-9]+))?")
_MOST_DIGITS = 400  # of a number, and as an exponent, up to which its value is exact


@record
class Unit:
    """A unit: numerator / denominator * pi^pi times the bases to the powers ``dims``; ``words`` of which it is made."""

    numerator: int
    denominator: int
    pi: int
    dims: Dims
    words: tuple[str, ...] = ()

    @property
    def factor(self) -> float:
        """How many SI units it is."""
        return float(self.numerator * math.pi**self.pi / self.denominator)

    def times(self, other: Unit, power: int) -> Unit:
        """Return the product with a power of another unit."""
        up, down = (other.numerator, other.denominator)[:: 1 if power > 0 else -1]
        size = abs(power)
        dims = tuple(a + power * b for a, b in zip(self.dims, other.dims))
        words = (*self.words, *other.words)
        return Unit(
            self.numerator * up**size, self.denominator * down**size, self.pi + power * other.pi, dims, words
        )

    def value(self, written: str) -> float:
        """Return a number of the formula, as it is written, in SI units: the nearest float, where there is no pi."""
        number = float(written)
        match = _NUMBER.fullmatch(written)
        power = int(match.group(3) or 0) if match else 0
        long = abs(power) > _MOST_DIGITS or len(written) > _MOST_DIGITS
        if self.pi or match is None or not number or long:
            return number * self.factor
        power -= len(match.group(2))
        digits = int(match.group(1) + match.group(2))
        up, down = digits * self.numerator, self.denominator
        up, down = (up * 10**power, down) if power > 0 else (up, down * 10**-power)
        try:
            return up / down  # of whole numbers: correctly rounded
        except OverflowError:
            return math.inf


ONE = Unit(1, 1, 0, PLAIN)


@functools.cache
def table() -> dict[str, Unit]:
    """Return the units by their words."""
    units = {word: Unit(1, 1, 0, tuple(int(word == base) for base in BASES), (word,)) for word in BASES}
    for line in _TABLE.strip().splitlines():
        for entry in line.split("|"):
            word, factor, of = entry.split(maxsplit=2)
            up, _, down = factor.partition("/")
            whole = up.replace("2*pi", "2").replace("pi", "1")
            base = ONE
            for part in of.split():
                name, _, power = part.partition("^")
                base = base.times(units[name], int(power or 1))
            own = Unit(int(whole), int(down or 1), int("pi" in up), PLAIN).times(base, 1)
            units[word] = Unit(own.numerator, own.denominator, own.pi, own.dims, (word,))
    return units


def match(text: str, start: int) -> tuple[Unit, int] | None:
    """Return the unit that stands at a place of a text, and where it ends; None where there is none.

    Words follow one another with a space or ``*``; behind a ``/`` each word has its own, as ``N/m s`` reads two ways.
    A name with a dot or a parenthesis behind it is none, so ``2 deg * min(a, b)`` ends behind ``deg``.
    """
    unit, end, divided = ONE, start, False
    while (step := _STEP.match(text, end)) is not None:
        sign, word = step.group(1).strip(), step.group(2)
        other = table().get(word)
        if other is None or word in unit.words or (sign and unit is ONE) or (divided and sign != "/"):
            break
        divided = sign == "/"
        power = int(step.group(3) or 1)
        unit = unit.times(other, -power if divided else power)
        end = step.end()
    return None if unit is ONE else (unit, end)


@functools.cache
def of(text: str) -> Unit | None:
    """Return the unit that a text is, such as ``N m s/rad``, ``1/s^2``, ``1``; None for other texts."""
    # 1/(N m)^2 is 1/N^2/m^2, and N/(m s) N/m/s
    text = re.sub(r"/\((\w+) (\w+)\)$", r"/\1/\2", text)
    text = re.sub(r"\((\w+) (\w+)\)\^([0-9])", r"\1^\3/\2^\3", text)
    if text == "1":
        return ONE
    if text.startswith("1/"):
        unit = ONE
        for part in text[2:].split("/"):
            below = of(part)
            if below is None:
                return None
            unit = unit.times(below, -1)
        return unit
    read = match(text, 0)
    return read[0] if read is not None and read[1] == len(text) else None


def forms(unit: str) -> tuple[str, ...]:
    """Return the units that a key may have: two of ``N m/rad or N/m``."""
    return tuple(form for part in unit.split(", ") for form in part.split(" or "))


def written(dims: Dims) -> str:
    """Return the SI unit of a quantity, such as ``m`` or ``kg m s^-2``; by its usual name where it has one."""
    usual = next((unit for unit in KINDS if (known := of(unit)) is not None and known.dims == dims), "")
    parts = [base if power == 1 else f"{base}^{power}" for base, power in zip(BASES, dims) if power]
    return usual or " ".join(parts)


def fault(dims: Dims, unit: str, value: str) -> str:
    """Return why a quantity does not fit the unit of a key, an empty text where it does.

    A plain angle fits rates, too: ``180 deg`` of a speed are meant a second. value : the text, for the words.
    """
    allowed = forms(unit)
    known = [known for form in allowed if (known := of(form)) is not None]
    angle = table()["rad"].dims
    fits = any(one.dims == dims for one in known)
    if fits or (dims == angle and any(form.startswith("rad") for form in allowed)):
        return ""
    wanted = " or ".join(
        f"{KINDS.get(form, 'value')} in {form}" if form != "1" else KINDS["1"] for form in allowed
    )
    name = KINDS.get(written(dims), "")
    article = "an" if name[:1] in "aeiou" else "a"
    is_what = f"{article} {name}" if name else f"in {written(dims) or 'no unit'}"
    return f"{wanted} expected, {value} is {is_what}"


def alike(a: Dims, b: Dims) -> bool:
    """Tell whether two units differ in angles at most: those of r theta and r."""
    angle = BASES.index("rad")
    return all(x == y for k, (x, y) in enumerate(zip(a, b)) if k != angle)


def combined(op: str, a: Dims | None, b: Dims | None) -> Dims | None:
    """Return the unit of a sum, a product or a quotient; None of a plain number, which fits sums with any unit.

    Raises
    ------
    SceneError : a sum of different kinds.
    """
    if op in "+-":
        if a is not None and b is not None and a != b:
            raise SceneError(f"{written(a)} and {written(b)} do not add up")
        return b if a is None else a
    if a is None and b is None:
        return None
    sign = 1 if op == "*" else -1
    return tuple(x + sign * y for x, y in zip(a or PLAIN, b or PLAIN))


def raised(dims: Dims | None, power: float, of_what: str = "^") -> Dims | None:
    """Return the unit of a power.

    Raises
    ------
    SceneError : it is none, as that of sqrt(2 m).
    """
    if dims is None:
        return None
    powers = [x * power for x in dims]
    if any(not x.is_integer() for x in map(float, powers)):
        raise SceneError(f"{of_what} of a quantity in {written(dims)} has no unit here")
    return tuple(int(x) for x in powers)


def unknown(word: str) -> str:
    """Return what to say of a word behind a number that is no unit."""
    return f"{word!r} is no unit{did_you_mean(word, list(table()))}"

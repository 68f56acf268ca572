"""Keys that ``--key`` and ``--input`` ask for, with bounds that the scene allows."""

from __future__ import annotations

import dataclasses
import math

from robodyn_cli.errors import CapabilityError, SceneError, of_option
from robodyn_cli.expr.statements import quantities
from robodyn_cli.over.many.keys import START, setting, understand
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.text.overrides import AskedSetting

SPAN = "KEY, or KEY=LOW:HIGH with two numbers, LOW < HIGH"


@record
class AskedKey:
    """A key that was asked for by an option, with the bounds of its values in SI units, if any; unit : SI unit of those
    written with one."""

    name: str
    low: float | None = None
    high: float | None = None
    unit: str = ""
    option: str = "--key"

    def times(self, scale: float) -> AskedKey:
        """Return it with bounds that are so many times as large."""
        if self.low is None or self.high is None:
            return self
        low, high = sorted((scale * self.low, scale * self.high))
        return dataclasses.replace(self, low=low, high=high)

    @property
    def asked(self) -> str:
        """How messages name it."""
        return f"{self.option} {self.name}"

    @property
    def ends(self) -> tuple[float, float]:
        """The bounds, infinite where there are none."""
        return (-math.inf if self.low is None else self.low), (math.inf if self.high is None else self.high)


def asked_key(text: str, option: str = "--key") -> AskedKey:
    """Return what ``KEY`` or ``KEY=LOW:HIGH`` of an option asks for.

    Raises
    ------
    CapabilityError : it is neither.
    """
    name, sign, span = text.partition("=")
    if not sign:
        return AskedKey(name, option=option)
    try:
        (low, high), unit = quantities(span.split(":"), span, f"allowed: {SPAN}")
    except ValueError:  # not two
        low, high, unit = math.nan, math.nan, ""
    except SceneError as error:
        raise CapabilityError(f"{option} {name}={error.message}") from error
    if not low < high:
        raise of_option(f"{option} {text}", f"allowed: {SPAN}", CapabilityError)
    return AskedKey(name, low, high, unit, option)


def is_start(family: Family, one: AskedKey) -> bool:
    """Tell whether a key is where motions start."""
    return understand(family, one.name, one.asked).sort == START


def refuse_bounds(family: Family, one: AskedKey) -> None:
    """Refuse bounds that the scene does not allow.

    Raises
    ------
    SceneError
    """
    for bound in (one.low, one.high):
        if bound is not None:
            with_unit = AskedSetting(f"{one.name}={bound!r} {one.unit}", one.asked)
            family.scene([with_unit if one.unit else setting(one.name, bound, one.asked)])

"""Keys that vary within ranges in a scene that runs elsewhere, and the structure that serves all of them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from robodyn_cli.errors import CapabilityError, GeometryError, RobodynError, of_option
from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.expr.many import Decision
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.compiler import Target
from robodyn_cli.kernels.program import make_program
from robodyn_cli.kernels.wasm import WASM, WasmModule, write_wasm
from robodyn_cli.model.model import Model
from robodyn_cli.over.live.code import StateEquations, equations_text, numbers_text
from robodyn_cli.over.many.groups import Built
from robodyn_cli.over.many.keys import (
    NO_VALUE,
    OPTION,
    START,
    STRUCTURE,
    Key,
    key_unit,
    settings,
    understand,
    value_of,
)
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family
from robodyn_cli.spatial.algebra import Array

BESIDE = 1e-3  # of a range, from an end where the equations are others
MOST_CORNERS = 6  # keys of whose ranges all corners are looked at; of more, the ends of each alone
SORTS = {STRUCTURE: "decides which equations there are", OPTION: "is an option of the run"}
# functions of the C library that a browser has under the same names
LIBRARY = frozenset(
    {"exp", "log", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "pow", "atan2", "sin", "cos"}
)
AnyBuilt = TypeVar("AnyBuilt", bound=Built)


def cannot(where: str) -> tuple[str]:
    """Return what a refusal is about: what a scene cannot do."""
    return (f"this scene cannot {where}",)


@record
class LiveKey:
    """A key with a range: what it is, and its value in the scene."""

    key: Key
    value: float
    low: float
    high: float


class LiveScene:
    """A scene with some keys that vary within ranges, as code and data that need no Python.

    Parameters
    ----------
    ranges : lowest and highest value of keys, in SI units. commands : those whose scenes can leave, by name.

    Raises
    ------
    CapabilityError : what cannot leave, by name.
    SceneError : the scene has no such key, or does not allow values of the range.
    """

    where = "run in a page"  # what the scene is to do, as refusals say it
    in_page = True

    def __init__(
        self, family: Family, ranges: Mapping[str, tuple[float, float]], commands: Mapping[str, Any]
    ) -> None:
        self.family = family
        scene = family.own
        command = commands.get(scene.command or "")
        if command is None:
            raise CapabilityError(
                f"a scene of {scene.command} cannot {self.where}; allowed: {', '.join(commands)}"
            )
        keys = tuple(self._understood(name) for name in ranges)
        self.command, self.mechanism = command, Mechanism(family, list(ranges), keys)
        self.keys = [self._live_key(self.mechanism, key, ranges[key.name]) for key in keys]
        self.row = np.array([key.value for key in self.keys])

    def _understood(self, name: str) -> Key:
        """Return what a key is.

        Raises
        ------
        SceneError : the scene has no such key. CapabilityError : it cannot vary here.
        """
        option = self._option(name)
        key = understand(self.family, name, f"{option} {name}")
        if key.sort in SORTS:
            allowed = "allowed: numbers of the equations, and starts"
            raise of_option(f"{option} {name}", f"it {SORTS[key.sort]}; {allowed}", CapabilityError)
        return key

    def _live_key(self, mechanism: Mechanism, key: Key, ends: tuple[float, float]) -> LiveKey:
        """Return a key with its range.

        Raises
        ------
        CapabilityError : it has no value, or one outside.
        """
        (low, high), asked = ends, f"{self._option(key.name)} {key.name}"
        if key.scale != 1.0:
            told = "it has a unit or a sign in the scene; allowed: the key without '#'"
            raise of_option(asked, told, CapabilityError)
        value = value_of(mechanism.family, key.name)
        if value is None:
            raise of_option(asked, NO_VALUE, CapabilityError)
        if self.in_page and not (low < high and math.isfinite(low) and math.isfinite(high)):
            raise of_option(
                f"{asked}={low:g}:{high:g}", "allowed: LOW:HIGH with LOW below HIGH", CapabilityError
            )
        if not low <= value <= high:
            told = f"the scene's own value {value:.6g} lies outside {low:.6g}:{high:.6g}"
            raise of_option(asked, told, CapabilityError)
        return LiveKey(key, value, low, high)

    def _option(self, name: str) -> str:
        """Return the option that asks for a key."""
        return "--live"

    def _built(self, mechanism: Mechanism, kind: type[AnyBuilt]) -> AnyBuilt:
        """Return the structure that serves the scene and the corners of its ranges."""
        rows = np.array([self.row, *self._corners()])
        for error in mechanism.refusals(rows).values():
            raise error
        for key in self.keys:
            if key.value in key.key.special:
                raise CapabilityError(
                    f"{key.key.name} is {key.value:g} in this scene, where the equations are others than beside it; "
                    "give it another value by --set"
                )
        groups = list(mechanism.groups(self.command, rows))
        own, served = next(
            ((own, group) for own, group in groups if own is not None and 0 in group), (None, np.zeros(0))
        )
        if not isinstance(own, kind):
            self.command.structure(self.family, mechanism.keys, self.row)  # which says why not
            why = "its equations cannot be built for many runs"
            if self.family.own.control is not None:
                why = "its controller follows from the keys by computations in Python"
            raise CapabilityError(why, cannot(self.where))
        if own.obstacle:
            raise CapabilityError(own.obstacle, cannot(self.where))
        others = sorted(set(range(len(rows))) - set(served.tolist()))
        left = [k for k in others if not self._serves(own, mechanism, rows[k])]
        if left:
            at = ", ".join(settings([key.key.name for key in self.keys], rows[left[0]]))
            raise CapabilityError(
                f"within these ranges the equations change: those at {at} are others; narrow them"
            )
        self.keys = [self._without_ends(own, mechanism, k) for k in range(len(self.keys))]
        return own

    def _without_ends(self, own: Built, mechanism: Mechanism, k: int) -> LiveKey:
        """Return a key for which values count as special, of those within its range, only where the equations are
        others."""
        key = self.keys[k]
        within = [
            x for x in key.key.special if math.isfinite(key.high - key.low) and key.low <= x <= key.high
        ]
        rows = [np.where(np.arange(len(self.row)) == k, x, self.row) for x in within]
        same = {x for x, row in zip(within, rows) if self._serves(own, mechanism, row)}
        special = tuple(x for x in key.key.special if x not in same)
        return LiveKey(dataclasses.replace(key.key, special=special), key.value, key.low, key.high)

    def _serves(self, own: Built, mechanism: Mechanism, row: Array) -> bool:
        """Tell whether a structure has the equations of a row, or the loops do not close there, which runs find out."""
        try:
            other = self.command.structure(self.family, mechanism.keys, row)
        except GeometryError:
            return True
        except RobodynError:
            return False
        return bool(own.fits(row[None])[0]) and own.has_numbers_of(other)

    def _corners(self) -> list[Array]:
        """Return rows of values at the ends of the ranges."""
        ends = [ends_of(key) for key in self.keys]
        if len(ends) <= MOST_CORNERS:
            return [np.array(row) for row in itertools.product(*ends)]
        rows = []
        for k, both in enumerate(ends):
            for x in both:
                row = self.row.copy()
                row[k] = x
                rows.append(row)
        return rows

    def _key_data(self, key: LiveKey, model: Model) -> dict[str, Any]:
        place: Any = None
        if key.key.sort == START:
            group, _, name = key.key.place.partition(".")
            place = [group, (model.q_names if group == "q" else model.v_names).index(name)]
        return {
            "name": key.key.name, "unit": key_unit(self.family, key.key, model), "value": key.value,
            "low": key.low, "high": key.high, "special": list(key.key.special), "start": place,
        }  # fmt: skip

    def _module(self, texts: Sequence[str], exports: Sequence[str], given: Sequence[str] = ()) -> WasmModule:
        """Return code of texts; given : functions that the caller has.

        Raises
        ------
        CapabilityError : it needs functions that browsers do not have.
        """
        made = write_wasm(texts, exports)
        if others := sorted(set(made.imports) - LIBRARY - set(given)):
            raise CapabilityError(f"browsers have no function {', '.join(others)}", cannot(self.where))
        return made


class LiveMotion(LiveScene):
    """What is evaluated along a motion."""

    structure: Any
    deciding: Sequence[Decision]
    tables: Tables

    @cached_property
    def equations(self) -> dict[str, StateEquations]:
        """The equations of a sample, by name."""
        raise NotImplementedError

    def _find_what_decides(self) -> None:
        """Build the equations, and note the comparisons of numbers on the way there: they decide as well."""
        with witnessed() as witnesses:
            equations = self.equations
        self.deciding = [*self.structure.deciding, *self.structure.recipe.deciding(witnesses)]
        self.tables = Tables([own.program for own in equations.values()])

    @property
    def _places(self) -> list[str]:
        return [key.key.place for key in self.keys]

    def _with_places(
        self, sizes: Mapping[str, int], outputs: Mapping[str, dict[str, Any]]
    ) -> dict[str, StateEquations]:
        """Return programs of outputs, whose groups of symbols follow one another in a sample."""
        own, at = {}, 0
        for group, size in sizes.items():
            own[group] = range(at, at + size)
            at += size
        return {name: StateEquations(make_program(of, tuple(own)), own) for name, of in outputs.items()}

    def texts(self, target: Target) -> list[str]:
        """Return the code as IR.

        Raises
        ------
        CapabilityError : a number follows from a key in Python.
        """
        recipe, entries = self.structure.recipe, entries_of(self.tables)
        return [
            numbers_text(recipe, entries, self._places, self.deciding, target),
            equations_text(self.equations, self.tables, target),
        ]

    def module(self) -> WasmModule:
        """Return the code.

        Raises
        ------
        CapabilityError : it needs functions that browsers do not have, or a number follows from a key in Python.
        """
        return self._module(self.texts(WASM), ["numbers", *self.equations])


def ends_of(key: LiveKey) -> tuple[float, float]:
    """Return the ends of a range; a little inside where the equations are others at that very value."""
    beside = BESIDE * (key.high - key.low)
    low, high = (x in key.key.special for x in (key.low, key.high))
    return (key.low + beside if low else key.low), (key.high - beside if high else key.high)


def entries_of(tables: Tables) -> list[Any]:
    """Return the numbers of all tables, one after another."""
    return [x for p in tables.programs for x in (p.numbers or (0.0,))]


def columns(names: Sequence[str], units: Sequence[str], places: Sequence[int]) -> dict[str, Any]:
    """Return columns of a state, or of samples, as data."""
    return {"names": list(names), "units": list(units), "places": [int(k) for k in places]}

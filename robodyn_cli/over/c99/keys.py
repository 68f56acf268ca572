"""Keys of a scene that stay parameters of its C: which they are, their bounds, and what follows from them."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from robodyn_cli.errors import CapabilityError, RobodynError, listed, of_option
from robodyn_cli.expr.fixed import Witness, places, witnessed
from robodyn_cli.expr.many import Decision, ManyNumbers, Recipe
from robodyn_cli.kernels.program import Program
from robodyn_cli.model.places import numbers_at_places, with_free
from robodyn_cli.over.c99.asked_keys import AskedKey, refuse_bounds
from robodyn_cli.over.c99.functions import ModelFunctionsOfScene, functions_of, ready
from robodyn_cli.over.many.keys import (
    NO_VALUE,
    NUMBER,
    OPTION,
    START,
    Key,
    settings,
    understand,
    value_of,
)
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.text.numbers import at_key
from robodyn_cli.scene.types import Scene
from robodyn_cli.scene.units import refuse_doubles, unit_of
from robodyn_cli.schema.fields import Either, Number, Section
from robodyn_cli.spatial.algebra import Array

LEAST = 2.2250738585072014e-308  # the smallest normal double: a bound that excludes zero
ALIKE = 1e-9  # relative difference of numbers that were computed in two ways
ALONG = 33  # values of a range at which comparisons are looked at
CHANGES = (0.05, 1e-3)  # relative changes of all keys with which equations are built once more
# what keys are by default: masses, inertias and data of forces, which cost nothing while functions are evaluated
CHEAP = re.compile(
    r"robot\.links\.[^.]+\.(mass|com\.\d|inertia\.\w+)|gravity\.\d|(forces|payloads|control)\..*"
    r"|parameters\.[^.]+|robot\.joints\.[^.]+(\.\w+)?\.(spring|damper|friction|rotor_inertia|limits\.stop)(\..*)?"
)
CLOCKS = ("control.period", "control.delay")  # what the target's clock has to follow


@record
class CKey:
    """A key that C can set: name, unit, value, and bounds (inclusive)."""

    name: str
    unit: str
    value: float
    low: float
    high: float


@record
class Parametrised:
    """The functions of a scene with the keys that they depend on.

    programs : by name of the function. recipe : how numbers follow from the keys. decisions : comparisons of these that
    have to turn out as they did. changed : the functions of the scene with other values (keys,) of all keys; None
    where there are none.
    """

    own: ModelFunctionsOfScene
    programs: Mapping[str, Program]
    keys: tuple[CKey, ...]
    recipe: Recipe
    decisions: tuple[Decision, ...]
    changed: tuple[Array, ModelFunctionsOfScene] | None

    def numbers(self, values: Array) -> ManyNumbers:
        """Return the numbers of the scene for rows of values (N, keys)."""
        given = {key.name: values[:, k] for k, key in enumerate(self.keys)}
        return ManyNumbers(self.recipe, given, len(values))

    @property
    def nominal(self) -> Array:
        """The values of the keys in the scene (keys,)."""
        return np.array([key.value for key in self.keys])


class _Build:
    """The functions of a scene, with all comparisons of its numbers that were made while they were built.

    free : places of numbers that are no structure whatever they are, those of the keys that were asked for.
    """

    def __init__(self, scene: Scene, free: Iterable[str]) -> None:
        self.free = frozenset(free)
        with witnessed() as witnesses:
            self.own = functions_of(with_free(scene, self.free))
            self.programs = {f.name: f.program for f in self.own.functions}
        self.witnesses: list[Witness] = witnesses

    @property
    def numbers(self) -> list[float]:
        return [x for program in self.programs.values() for x in program.numbers]


def parametrised(family: Family, asked: Sequence[AskedKey], simulated: bool = False) -> Parametrised:
    """Return the functions of a scene with the keys that are asked for, or those that cost nothing.

    simulated : whether a simulation goes with them, so that they need not depend on all keys (see ``key_bounds``).

    Raises
    ------
    CapabilityError, SceneError : a key is structure, or nothing depends on it; a range crosses a change of structure.
    """
    refuse_doubles(family.root, [one.name for one in asked], "--key")
    understood = [_number(family, one) for one in asked]
    scene = ready(family.own)
    build = _Build(scene, [key.place for key in understood])
    depends = places(build.numbers)
    for one, key in zip(asked, understood):
        if key.place not in depends and not simulated:
            raise of_option(
                one.asked,
                f"no function depends on it as a number; allowed: {listed(depends) or 'none'}",
                CapabilityError,
            )
    names = [key.place for key in understood if key.place in depends]
    names = names if understood else [x for x in depends if _is_cheap(family, x)]
    names, behind = _without_python(build, names)
    if behind and asked:
        raise of_option(
            f"--key {behind[0]}",
            "numbers follow from it by a function in Python (base inertial parameters); "
            f"allowed: {listed([x for x in depends if x not in behind])}",
            CapabilityError,
        )
    ranges = {key.place: one.times(key.scale) for one, key in zip(asked, understood)}
    values = numbers_at_places(build.own.problem.scene)
    keys = tuple(_described(family, name, values[name], ranges.get(name)) for name in names)
    return _confirmed(family, scene, build, keys)


def key_bounds(family: Family, asked: Sequence[AskedKey]) -> dict[str, tuple[float, float]]:
    """Return the bounds of numbers of the equations in a simulation, by name: those asked for, or those of the scene.

    Raises
    ------
    CapabilityError : the scene has no value, or one outside.
    """
    bounds = {}
    for one in asked:
        value = value_of(family, one.name)
        if value is None:
            raise of_option(one.asked, NO_VALUE, CapabilityError)
        key = _described(family, one.name, value, one)
        bounds[one.name] = key.low, key.high
    return bounds


def input_bounds(family: Family, inputs: Sequence[AskedKey]) -> dict[str, tuple[float, float]]:
    """Return the bounds of those inputs that are numbers of the equations, as of ``key_bounds``.

    Raises
    ------
    CapabilityError : as of ``key_bounds``. SceneError : the scene does not allow a bound.
    """
    numbers = [one for one in inputs if understand(family, one.name, one.asked).sort == NUMBER]
    for one in numbers:
        refuse_bounds(family, one)
    return key_bounds(family, numbers)


def _number(family: Family, one: AskedKey) -> Key:
    key = understand(family, one.name, one.asked)
    if key.sort in (START, OPTION):
        raise of_option(
            one.asked,
            f"it is {'the start' if key.sort == START else 'an option'} of a simulation; functions "
            "take q and qd as arguments; allowed: numbers of the equations",
            CapabilityError,
            key=one.name,
        )
    refuse_bounds(family, one)
    return key


def _is_cheap(family: Family, place: str) -> bool:
    """Tell whether a place is that of a key that is a parameter by default."""
    return (
        bool(CHEAP.fullmatch(place))
        and place not in CLOCKS
        and at_key(family.root, Section(Scene), place)[0] is not None
    )


def _without_python(build: _Build, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the keys from which all numbers follow by arithmetic, and the others."""
    recipe = Recipe(names)
    recipe.values_of(build.numbers)
    recipe.deciding(build.witnesses)
    shared = [data for op, data, _ in recipe.steps if op == "derived"]
    behind = {place for inputs in shared for place in places(inputs)} & set(names)
    return [name for name in names if name not in behind], sorted(behind)


def _described(family: Family, name: str, value: float, asked: AskedKey | None) -> CKey:
    """Return a key with its bounds: those asked for, or those of the scene's description."""
    kind = at_key(family.root, Section(Scene), name.partition("#")[0])[1]
    kinds = kind.kinds if isinstance(kind, Either) else (kind,)
    number = next((k for k in kinds if isinstance(k, Number)), Number())
    low = -math.inf if number.minimum is None else number.minimum
    low = LEAST if low == 0.0 and number.exclusive else low
    high = math.inf if number.maximum is None else number.maximum
    if asked is not None and asked.low is not None and asked.high is not None:
        low, high = max(low, asked.low), min(high, asked.high)
    if not low <= value <= high:
        raise of_option(
            f"--key {name}" if asked is None else asked.asked,
            f"the scene's own value {value:.6g} lies outside {low:.6g}:{high:.6g}",
            CapabilityError,
        )
    return CKey(name, unit_of(family.root, name), value, low, high)


def _confirmed(family: Family, scene: Scene, build: _Build, keys: tuple[CKey, ...]) -> Parametrised:
    """Return the functions with the keys for which equations that are built once more have the numbers that follow."""
    while True:
        recipe = Recipe([key.name for key in keys])
        recipe.values_of(build.numbers)
        decisions = tuple(recipe.deciding(build.witnesses))
        made = Parametrised(build.own, build.programs, keys, recipe, decisions, None)
        for key in keys if build.free else ():
            _refuse_crossing(made, key)
        changed = _changed(family, scene, keys, build.free) if keys else None
        if changed is None or _agrees(made, *changed):
            return dataclasses.replace(
                made, changed=None if changed is None else (changed[0], changed[1].own)
            )
        deciding = _deciding(made, changed[0])
        off = [key for key in keys if key.name in deciding]
        off = off or [key for key in keys if not _follows(family, scene, made, key, build.free)]
        if build.free or not off:
            names = listed([key.name for key in off or keys])
            raise of_option(
                f"--key {names}",
                "the equations do not follow from it by its numbers alone; it is structure",
                CapabilityError,
            )
        keys = tuple(key for key in keys if key not in off)


def _refuse_crossing(made: Parametrised, key: CKey) -> None:
    """Refuse a range over which the equations change.

    Raises
    ------
    CapabilityError
    """
    if not (math.isfinite(key.low) and math.isfinite(key.high)):
        return
    column = np.linspace(key.low, key.high, ALONG)
    values = np.tile(made.nominal, (ALONG, 1))
    values[:, [k.name for k in made.keys].index(key.name)] = column
    alike = made.numbers(values).decided_alike(made.decisions)
    if not alike.all():
        x = column[int(np.argmin(alike))]
        raise of_option(
            f"--key {key.name}={key.low:.6g}:{key.high:.6g}",
            f"the range crosses a change of structure, at {x:.6g} the "
            "equations are others; allowed: ranges on one side of it",
            CapabilityError,
        )


def _changed(
    family: Family, scene: Scene, keys: Sequence[CKey], free: frozenset[str]
) -> tuple[Array, _Build] | None:
    """Return other values (keys,) of all keys, and the functions of the scene with them; None where none is allowed."""
    for most in CHANGES:
        values = np.array([_moved(key, most * math.sin(k + 1.0)) for k, key in enumerate(keys)])
        try:
            return values, _Build(_with_values(family, scene, keys, values), free)
        except RobodynError:
            continue
    return None


def _moved(key: CKey, change: float) -> float:
    """Return another value of a key between its bounds."""
    x = key.value + change * (abs(key.value) or 1.0)
    return x if key.low <= x <= key.high else key.value - change * (abs(key.value) or 1.0)


def _with_values(family: Family, scene: Scene, keys: Sequence[CKey], values: Array) -> Scene:
    """Return the ready scene with other values; what was found ahead for its controller stays what it was."""
    other = family.scene(settings([key.name for key in keys], values))
    if other.control is None or scene.control is None or scene.control is family.own.control:
        return ready(other)
    changed = {
        field.name: getattr(other.control, field.name)
        for field in dataclasses.fields(other.control)
        if getattr(other.control, field.name) != getattr(family.own.control, field.name)
    }
    return dataclasses.replace(other, control=dataclasses.replace(scene.control, **changed))


def _agrees(made: Parametrised, values: Array, build: _Build) -> bool:
    """Tell whether equations that were built with other values have the numbers that follow from these."""
    numbers = made.numbers(values[None])
    if not numbers.decided_alike(made.decisions).all() or build.programs.keys() != made.programs.keys():
        return False
    for name, program in made.programs.items():
        other = build.programs[name]
        if other.digest != program.digest:
            return False
        own = numbers.table(program.numbers)[0] if program.numbers else np.zeros(0)
        there = np.array(other.numbers, dtype=float)
        if np.any(np.abs(own - there) > ALIKE * (np.abs(own) + np.abs(there))):
            return False
    return True


def _deciding(made: Parametrised, values: Array) -> set[str]:
    """Return the keys on which comparisons depend that turn out otherwise with other values (keys,)."""
    numbers, steps = made.numbers(values[None]), made.recipe.steps
    pending = [
        side
        for decision in made.decisions
        if not numbers.decided_alike([decision]).all()
        for side in decision[1:3]
    ]
    names = set()
    while pending:
        op, data, args = steps[pending.pop()]
        if op == "literal":
            names.add(data)
        pending += args
    return names


def _follows(family: Family, scene: Scene, made: Parametrised, key: CKey, free: frozenset[str]) -> bool:
    """Tell whether the equations follow from one key alone."""
    values = made.nominal
    values[made.keys.index(key)] = _moved(key, CHANGES[0])
    try:
        scene = _with_values(family, scene, made.keys, values)
        build = _Build(scene, free)
    except RobodynError:
        return False
    return _agrees(made, values, build)

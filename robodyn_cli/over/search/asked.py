"""What a search is asked for: keys between bounds or of some values, a goal, and constraints."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.commands import STUDIED
from robodyn_cli.errors import SceneError, of_option
from robodyn_cli.expr.statements import Expectation, Variation
from robodyn_cli.kernels.cache import code_digest
from robodyn_cli.model.build import build_model
from robodyn_cli.over.many.keys import Allowed, Key, key_unit, understand, value_of
from robodyn_cli.over.study.rows import Task
from robodyn_cli.over.study.study import check_key, repeated, units_of_keys, varied
from robodyn_cli.record import record
from robodyn_cli.results.summary import sha256
from robodyn_cli.scene.checks.keys import key_names, unit_fault
from robodyn_cli.scene.checks.options import is_inequality, search_problems
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.nested_options import SearchOptions
from robodyn_cli.scene.units import refuse_doubles
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.keys import leaf_of, refusal

GOALS = ("minimise", "maximise", "reach")
MOST_NAMED = 4  # targets
MOST_BEGINNINGS = 10_000  # combinations of values times starts
EDGE = 1e-12  # of the way between bounds, within which a value is that of the bound
UNJUDGED = ("expect={}",)  # runs are judged here, by the constraints


@record
class Constraint:
    """A constraint: what holds of an output, by its number among those of the search.

    source : ``keep`` or ``expect``.
    """

    output: int
    name: str
    expected: Expectation
    source: str

    def excess(self, y: float) -> float:
        """Return by how much a value breaks it; negative inside."""
        return max(self.expected.low - y, y - self.expected.high)


@record
class Goal:
    """What outputs, by their numbers, are to be: one the least or the largest, or several at their targets.

    sign : of the output in what is minimised; 0 where targets are to be reached.
    """

    sign: float
    outputs: tuple[int, ...]
    targets: tuple[Expectation, ...] = ()

    @property
    def is_reach(self) -> bool:
        return not self.sign

    def words(self, names: Sequence[str]) -> str:
        """Return the goal in words; names : of the outputs."""
        if not self.is_reach:
            return f"{'least' if self.sign > 0.0 else 'largest'} {names[self.outputs[0]]}"
        if len(self.outputs) > MOST_NAMED:
            return f"{len(self.outputs)} outputs at their targets"
        return ", ".join(f"{names[k]} = {target.text}" for k, target in zip(self.outputs, self.targets))


def middle(target: Expectation) -> float:
    """Return the value that a target asks for."""
    return 0.5 * (target.low + target.high)


@record
class Search:
    """A search that makes sense.

    family : as it was asked for. task : of its runs. keys : what each key is. variations : of the keys. stands : values
    of the keys in the scene as it stands, nan where it has none. left_out : what of ``expect`` is no constraint, with
    the reason.
    """

    family: Family
    task: Task
    options: SearchOptions
    keys: tuple[Key, ...]
    variations: tuple[Variation, ...]
    goal: Goal
    limits: tuple[Constraint, ...]
    stands: tuple[float, ...]
    left_out: dict[str, str]

    @cached_property
    def units(self) -> tuple[str, ...]:
        """The units of the keys."""
        model = build_model(self.family.own)
        return tuple(key_unit(self.family, key, model) for key in self.keys)

    @cached_property
    def output_units(self) -> tuple[str, ...]:
        """The units of the outputs."""
        return tuple(units_of_keys(self.task, build_model(self.family.own)).values())

    @cached_property
    def continuous(self) -> tuple[int, ...]:
        """The keys that lie between bounds."""
        return tuple(k for k, v in enumerate(self.variations) if not v.is_grid)

    @cached_property
    def bounds(self) -> Array:
        """Lower and upper bounds (n, 2) of these."""
        return np.array([self.variations[k].arguments for k in self.continuous]).reshape(-1, 2)

    def combinations(self) -> Iterator[Array]:
        """Yield the values of all keys (K,) for each combination of those that take some values; others are nan."""
        grids = [v.values if v.is_grid else (math.nan,) for v in self.variations]
        yield from (np.array(values) for values in itertools.product(*grids))

    @property
    def count(self) -> int:
        """Number of combinations."""
        return math.prod(len(v.values) for v in self.variations if v.is_grid)

    @property
    def digest(self) -> str:
        """What a search must share with an earlier one to go on from there."""
        return sha256("\n".join([code_digest(), self.family.own.text, self.task.command, repr(self.options)]))

    def repeat(self, values: Sequence[float]) -> str:
        """Return the command that repeats a run."""
        return repeated(self.family, self.task, values)

    def value_of(self, unit: Array, values: Array) -> Array:
        """Return the values of all keys (K,) from those of a combination and the place u (n,) between the bounds."""
        x = values.copy()
        low, high = self.bounds.T
        between = np.clip(low + (high - low) * unit, low, high)
        x[list(self.continuous)] = np.where(unit <= EDGE, low, np.where(unit >= 1.0 - EDGE, high, between))
        return x

    def place(self, x: Array) -> Array:
        """Return the place u (n,) between the bounds of values of all keys (K,)."""
        low, high = self.bounds.T
        return np.asarray(np.clip((x[list(self.continuous)] - low) / (high - low), 0.0, 1.0))


def prepare(family: Family, options: SearchOptions) -> Search:
    """Check a search.

    Raises
    ------
    SceneError : the scene names no command; nothing varies, or between no bounds; there is no goal; a key does not
        exist or takes no such values; an output is not in the summary; there are too many combinations.
    """
    scene = family.own
    if scene.command not in STUDIED:
        message = "is missing" if scene.command is None else f"is {scene.command}"
        raise SceneError(
            f"key 'command' {message}: it says what each run does; allowed: {', '.join(STUDIED)}",
            (family.path,),
        )
    for path, message in search_problems(options):
        option = "".join(f"--{path[0]} {path[1]}" if len(path) > 1 else f"--{path[0]}")
        raise of_option(option, message, key=".".join(("search", *map(str, path))))
    if not options.vary:
        raise SceneError("nothing varies; give --vary 'KEY=uniform(low, high)', or search.vary in the scene")
    named = options.minimise or options.maximise
    wanted = (named,) if named else tuple(options.reach)
    if not wanted:
        raise SceneError(
            "there is no goal; give --minimise, --maximise or --reach, or one of these below search"
        )
    for key, variation in options.vary.items():
        check_key(family, key, variation)
    refuse_doubles(family.root, options.vary, "--vary")
    constraints, left_out = _constraints(family, options)
    outputs = tuple(dict.fromkeys((*wanted, *(name for name, _, _ in constraints))))
    for name in outputs:
        if wrong := refusal(scene.command, name, key_names(scene), number=True):
            raise SceneError(wrong, (name,), key=name)
    for option, values in (("--reach", options.reach), ("--keep", options.keep)):
        for name, expected in values.items():
            if fault := unit_fault(scene, scene.command, name, expected):
                raise of_option(f"{option} {name}", fault, key=name)
    number = outputs.index
    sign = 0.0 if not named else 1.0 if options.minimise else -1.0
    task = Task(family.with_values(UNJUDGED), scene.command, tuple(options.vary), outputs)
    search = Search(
        family, task, options, tuple(understand(family, key) for key in options.vary),
        tuple(options.vary.values()),
        Goal(sign, tuple(map(number, wanted)), tuple(options.reach.values())),
        tuple(Constraint(number(name), name, expected, source) for name, expected, source in constraints),
        tuple(_standing(family, key) for key in options.vary), left_out,
    )  # fmt: skip
    _check_bounds(search)
    return search


def _standing(family: Family, key: str) -> float:
    """Return the value of a key in the scene as it stands; nan where it has none."""
    value = value_of(family, key)
    return math.nan if value is None else value


def _constraints(
    family: Family, options: SearchOptions
) -> tuple[list[tuple[str, Expectation, str]], dict[str, str]]:
    """Return the constraints, and what of ``expect`` is none, with the reason."""
    scene, left_out = family.own, {}
    constraints = [(name, kept, "keep") for name, kept in options.keep.items()]
    goals = {options.minimise, options.maximise, *options.reach}
    for name, expected in scene.expect.items():
        leaf = leaf_of(scene.command or "", name)
        if not expected.numeric or leaf is None or name == "exit_code":
            continue
        if not is_inequality(expected):
            left_out[name] = "a value, which other values of the keys change"
        elif leaf.fact.about_run:
            left_out[name] = "it tells how a run went; the run of the optimum is held to it"
        elif name not in goals and name not in options.keep:
            constraints.append((name, expected, "expect"))
    return constraints, left_out


def _check_bounds(search: Search) -> None:
    """Refuse bounds that a key does not take, and more beginnings than can be made."""
    options = search.options
    starts = options.starts if search.continuous else 1
    if search.count * starts > MOST_BEGINNINGS:
        raise SceneError(
            f"{search.count} combinations of values with {starts} starts each; allowed: {MOST_BEGINNINGS} in all"
        )
    for k in search.continuous:
        name, variation = search.task.keys[k], search.variations[k]
        ends = np.array(variation.arguments)[:, None]
        allowed = Allowed(search.family, [search.keys[k]], varied(name, variation))
        for error in allowed.refusals(ends).values():
            raise error


def options_of(given: SearchOptions | None, changes: Mapping[str, object]) -> SearchOptions:
    """Return the options of a scene with others in their place; a goal among these takes the place of all.

    changes : options that are given, by name; None, or an empty map, leaves one as it is.
    """
    own: dict[str, Any] = {name: value for name, value in changes.items() if value not in (None, {})}
    options = given or SearchOptions(vary={}, reach={}, keep={})
    if set(GOALS) & set(own):
        options = dataclasses.replace(options, minimise=None, maximise=None, reach={})
    return dataclasses.replace(options, **own)

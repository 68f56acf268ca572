"""Figures of several results beside one another: which there are, and whether they differ beyond their errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robodyn_cli.commands import COMMANDS
from robodyn_cli.record import record
from robodyn_cli.report.page.summary import told_of
from robodyn_cli.report.page.tables import Quantity, written
from robodyn_cli.report.page.verdict import verdicts
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import beyond
from robodyn_cli.scene.text.leaves import leaves_of_text
from robodyn_cli.summaries.keys import headline_rank, leaf_of

ROBOT, JOINTS = "robot.", "robot.joints."
TOLD = ("title", "command")  # keys of a scene that stand elsewhere
NAMED = 8  # joints
LACKING = 12  # keys that only some scenes have; more are scenes of different things
# what marks figures: more apart than their errors, less, or apart by what cannot be judged since an error is not stated
DIFFER, WITHIN, OPEN = "differ", "within", "open"


@record
class SideBySide:
    """A figure of several results: its name, what each has (None where it has none), whether it is of the scene."""

    name: str
    values: Sequence[Any]
    given: bool = False

    @property
    def mark(self) -> str:
        """How the values are to one another, as of ``judged``."""
        return judged(self.values)

    def difference(self, k: int) -> Quantity | None:
        """Return the k-th value less the first, with the sum of both errors where both are stated; None where they are
        not numbers in the same unit."""
        one, other = number_of(self.values[k]), number_of(self.values[0])
        if one is None or other is None or unit_of(self.values[k]) != unit_of(self.values[0]):
            return None
        known = error_of(self.values[k]) is not None and error_of(self.values[0]) is not None
        return Quantity(one[0] - other[0], unit_of(self.values[k]), one[1] + other[1] if known else None)


def judged(values: Sequence[Any]) -> str:
    """Return how values are to one another, two or more: empty where they are equal.

    They differ where two are more apart than the sum of their errors, so where no number is within the errors of all;
    they are open where the errors that are stated do not say so and one is not. Whole numbers are exact; what is no
    number, or in another unit, differs where it is written otherwise. None is no value.
    """
    there = [value for value in values if value is not None]
    numbers = [one for one in map(number_of, there) if one is not None]
    if len(numbers) < len(there) or len(set(map(unit_of, there))) > 1:
        return DIFFER if len(set(map(written, there))) > 1 else ""
    if len({x for x, _ in numbers}) < 2:
        return ""
    known = [one for one, value in zip(numbers, there) if _is_known(value)]
    if known:
        (low, one), (high, other) = min(known, key=sum), max(known, key=lambda x: x[0] - x[1])
        if beyond(high - low, one + other):
            return DIFFER
    return WITHIN if len(known) == len(there) else OPEN


def _is_known(value: Any) -> bool:
    """Tell whether it is known how far a number is off."""
    inner = value.value if isinstance(value, Quantity) else value
    return isinstance(inner, int) or error_of(value) is not None


def number_of(value: Any) -> tuple[float, float] | None:
    """Return a number and its error, 0 where none is stated."""
    inner, error = (value.value, value.error) if isinstance(value, Quantity) else (value, None)
    plain = isinstance(inner, int | float) and not isinstance(inner, bool) and math.isfinite(inner)
    return (float(inner), error or 0.0) if plain else None


def unit_of(value: Any) -> str:
    """Return the unit of a value, empty where it has none."""
    return value.unit if isinstance(value, Quantity) else ""


def error_of(value: Any) -> float | None:
    """Return the error that is stated of a value; None where none is."""
    return value.error if isinstance(value, Quantity) else None


def compared(results: Sequence[Result]) -> list[SideBySide]:
    """Return what tells scenes apart, how runs ended, and the figures that any of the results has: those that differ
    first, and of these those that the results are told by."""
    ends = [", ".join(one.words for one in verdicts(result)) for result in results]
    # what was run, which need not be the command that the scene names
    run = SideBySide("command", [result.command for result in results], given=True)
    found = [SideBySide("outcome", ends), *([run] if run.mark else []), *scene_differences(results)]
    told = [dict(_figures(result)) for result in results]
    names = list(dict.fromkeys(name for one in told for name in one))
    figures = [SideBySide(name, [one.get(name) for one in told]) for name in names]
    commands = {result.command for result in results}

    def place(one: SideBySide) -> tuple[int, int]:
        return (DIFFER, OPEN, WITHIN, "").index(one.mark), min(headline_rank(x, one.name) for x in commands)

    return [*found, *sorted(figures, key=place)]


def scene_differences(results: Sequence[Result]) -> Iterator[SideBySide]:
    """Yield keys of the scenes that have other values in some of them; those that some lack if these are few.

    Of other robots, those with other joints, the joints are told. Their parts are others even where names agree, so
    that keys of a robot, and keys that some lack, are compared among scenes of the same one.
    """
    scenes = [leaves_of_text(result.scene_text) for result in results]
    joints = [_joints(one) for one in scenes]
    same = [[k for k, own in enumerate(joints) if own == one] for one in dict.fromkeys(joints)]
    changed, lacking = [], []
    for key in dict.fromkeys(key for one in scenes for key in one):
        values = [one.get(key) for one in scenes]
        apart = [{values[k] for k in group} for group in same]
        if None not in values and not key.startswith(ROBOT):
            apart.append(set(values))
        if key in TOLD:
            continue
        if any(len(one - {None}) > 1 for one in apart):
            changed.append(SideBySide(key, values, given=True))
        elif any(len(one) > 1 for one in apart):
            lacking.append(SideBySide(key, values, given=True))
    if len(same) > 1:
        yield SideBySide(JOINTS.rstrip("."), [_named(one) for one in joints], given=True)
    yield from changed
    if len(lacking) <= LACKING:
        yield from lacking


def _joints(scene: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the joints of a scene."""
    return tuple(
        dict.fromkeys(key.removeprefix(JOINTS).partition(".")[0] for key in scene if key.startswith(JOINTS))
    )


def _named(joints: Sequence[str]) -> str:
    more = f", and {len(joints) - NAMED} more" if len(joints) > NAMED else ""
    return ", ".join(joints[:NAMED]) + more or "none"


def without_loners(found: Sequence[SideBySide], results: Sequence[Result]) -> list[SideBySide]:
    """Return figures without those that one result has and no other could: none of its robot and command is there."""
    kinds = [(result.command, _joints(leaves_of_text(result.scene_text))) for result in results]
    kept = []
    for one in found:
        having = [k for k, value in enumerate(one.values) if value is not None]
        if one.given or len(having) > 1 or kinds.count(kinds[having[0]]) > 1:
            kept.append(one)
    return kept


def _figures(result: Result) -> Iterator[tuple[str, Any]]:
    """Yield the figures of a result that have an error, or a place among the main ones, by their keys."""
    if result.command in COMMANDS:
        told_values = dict(_flat(told_of(result)))
        for key, value in told_values.items():
            leaf = leaf_of(result.command, key)
            if leaf is not None and leaf.fact.same_as and _has(told_values, leaf.fact.same_as):
                continue
            told = leaf is not None and not leaf.fact.about_run and (leaf.errors or leaf.fact.column)
            if told and number_of(value) is not None:
                yield key, value


def _has(values: Mapping[str, Any], key: str) -> bool:
    """Tell whether there is a value under a key, or below it."""
    return any(f"{one}.".startswith(f"{key}.") for one in values)


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    items: Any = ()
    if isinstance(value, Mapping):
        items = value.items()
    elif isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
        items = enumerate(value)
    else:
        yield key, value
    for name, item in items:
        yield from _flat(item, f"{key}.{name}" if key else str(name))

"""Errors of figures from other runs: how far the figures of these are from those of a first one is added to its errors.

Which errors are those of which figure is what the fields of records declare (``fact``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.summaries.facts import ABSENT, Fact, key_of

ROUNDED = (
    1e-14  # of a figure, or of the largest of its map or list: agreement of two runs says no more than that
)
Steps = tuple[str, ...]


def with_others(one: Any, others: Sequence[Any], factor: float, place: Steps = ()) -> Any:
    """Return a record, or a map of records, with errors for how far its figures are from those of other runs.

    An error, 0 where none stands there yet, grows by ``factor`` times the largest distance of the figures that it is
    of, and by as much as the others are apart: one of them may agree with the first by chance. It becomes None where
    only the first run has a figure: all do where there is no other. Figures whose errors stand outside the record keep
    them.

    Parameters
    ----------
    others : the same of more accurate runs. place : steps of the record's key, with kinds of names (``drives.JOINT``).
    """
    if isinstance(one, Mapping):
        return {
            name: with_others(value, [other[name] for other in others], factor, place)
            if all(name in other for other in others)
            else value
            for name, value in one.items()
        }
    if not dataclasses.is_dataclass(one) or isinstance(one, type):
        return one
    if any(type(other) is not type(one) for other in others):
        return one
    values: dict[str, Any] = {}
    growth: dict[Steps, Any] = {}
    for field in dataclasses.fields(one):
        fact: Fact = field.metadata["fact"]
        first, seconds = getattr(one, field.name), [getattr(other, field.name) for other in others]
        named = fact.names[:1] if isinstance(first, Mapping) else ()
        values[field.name] = with_others(first, seconds, factor, (*place, key_of(field.name), *named))
        for key in fact.errors:
            steps = _inside(key, place)
            if steps is not None and first is not ABSENT and first is not None:
                apart = _apart(first, seconds, factor)
                growth[steps] = _larger(growth[steps], apart) if steps in growth else apart
    changed = dataclasses.replace(one, **values)
    for steps, more in growth.items():
        changed = _grown(changed, steps, more)
    return changed


def _inside(key: str, place: Steps) -> Steps | None:
    """Return the steps from a record to the key of an error, None where it stands outside."""
    steps = tuple(key.split("."))
    if not steps[0]:
        return steps[1:]
    inside = steps[len(place) :]
    return inside if steps[: len(place)] == place and inside else None


def _apart(first: Any, others: Sequence[Any], factor: float) -> Any:
    """Return how far values are apart, None where not all are numbers, or there are no others; of a map by name, of a
    list the largest."""
    if isinstance(first, Mapping):
        maps = [other if isinstance(other, Mapping) else {} for other in others]
        least = ROUNDED * max((abs(x) for x in first.values() if isinstance(x, float)), default=0.0)
        parts = {name: _apart(x, [other.get(name) for other in maps], factor) for name, x in first.items()}
        return {name: None if x is None else max(x, least) for name, x in parts.items()}
    if isinstance(first, list):
        if any(not isinstance(other, list) or len(first) != len(other) for other in others):
            return None
        parts = _apart(dict(enumerate(first)), [dict(enumerate(other)) for other in others], factor)
        return None if None in parts.values() else max(parts.values(), default=0.0)
    if not others:
        return None
    if not isinstance(first, (int, float)):
        return 0.0 if all(first is other or first == other for other in others) else None
    if not all(isinstance(other, (int, float)) for other in others):
        return None
    return distance(first, others, factor)


def distance(first: float, others: Sequence[float], factor: float) -> float:
    """Return the error of a figure from the same of more accurate runs: how far they are off, times ``factor``, by how
    much they differ, and rounding."""
    farthest = max(abs(other - first) for other in others)
    return factor * farthest + (max(others) - min(others)) + ROUNDED * abs(first)


def _larger(one: Any, other: Any) -> Any:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return {name: _larger(x, other[name]) for name, x in one.items()}
    one, other = _most(one), _most(other)
    return None if one is None or other is None else max(one, other)


def _grown(record: Any, steps: Steps, more: Any) -> Any:
    """Return a record, a map or a number with the error at some steps larger by so much."""
    if dataclasses.is_dataclass(record) and steps:
        inner = _grown(getattr(record, steps[0]), steps[1:], more)
        return dataclasses.replace(record, **{steps[0]: inner})  # type: ignore[type-var]
    if isinstance(record, Mapping):
        return {
            name: _grown(x, (), more.get(name) if isinstance(more, Mapping) else more)
            for name, x in record.items()
        }
    more = _most(more)
    begun = 0.0 if record is ABSENT or record is None else record
    return None if more is None else begun + more


def _most(more: Any) -> Any:
    """Return the largest number of a map, None where one is not known; other values as they are."""
    if not isinstance(more, Mapping):
        return more
    return None if None in more.values() else max(more.values(), default=0.0)

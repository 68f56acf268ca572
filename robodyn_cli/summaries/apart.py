"""Errors of figures from a second run: how far the figures of two runs are apart is added to the errors of the first.

Which errors are those of which figure is what the fields of records declare (``fact``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from robodyn_cli.summaries.facts import ABSENT, Fact, key_of

ROUNDED = (
    1e-14  # of a figure, or of the largest of its map or list: agreement of two runs says no more than that
)
Steps = tuple[str, ...]


def with_second(one: Any, other: Any, factor: float, place: Steps = ()) -> Any:
    """Return a record, or a map of records, with errors for how far its figures are from those of a second run.

    An error, 0 where none stands there yet, grows by ``factor`` times the largest distance of the figures that it is
    of. It becomes None where only the first run has a figure. Figures whose errors stand outside the record keep them.

    Parameters
    ----------
    other : the same of the second run. place : steps of the record's key, with kinds of names (``drives.JOINT``).
    """
    if isinstance(one, Mapping):
        return {
            name: with_second(value, other[name], factor, place) if name in other else value
            for name, value in one.items()
        }
    if not dataclasses.is_dataclass(one) or isinstance(one, type) or type(one) is not type(other):
        return one
    values: dict[str, Any] = {}
    growth: dict[Steps, Any] = {}
    for field in dataclasses.fields(one):
        fact: Fact = field.metadata["fact"]
        first, second = getattr(one, field.name), getattr(other, field.name)
        named = fact.names[:1] if isinstance(first, Mapping) else ()
        values[field.name] = with_second(first, second, factor, (*place, key_of(field.name), *named))
        for key in fact.errors:
            steps = _inside(key, place)
            if steps is not None and first is not ABSENT and first is not None:
                apart = _apart(first, second, factor)
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


def _apart(first: Any, second: Any, factor: float) -> Any:
    """Return how far values are apart, None where only one is a number; of a map by name, of a list the largest."""
    if isinstance(first, Mapping):
        others = second if isinstance(second, Mapping) else {}
        least = ROUNDED * max((abs(x) for x in first.values() if isinstance(x, float)), default=0.0)
        parts = {name: _apart(x, others.get(name), factor) for name, x in first.items()}
        return {name: None if x is None else max(x, least) for name, x in parts.items()}
    if isinstance(first, list):
        if not isinstance(second, list) or len(first) != len(second):
            return None
        parts = _apart(dict(enumerate(first)), dict(enumerate(second)), factor)
        return None if None in parts.values() else max(parts.values(), default=0.0)
    if not isinstance(first, (int, float)):
        return 0.0 if first is second or first == second else None
    if not isinstance(second, (int, float)):
        return None
    return factor * abs(second - first) + ROUNDED * abs(first)


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

"""Summaries as records: one a command, whose fields are the documented keys of ``summary.json``."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any, Final


class Absent(enum.Enum):
    """The value of a field whose key a run does not have; ``None`` is a value, written as null."""

    ABSENT = "absent"


ABSENT: Final = Absent.ABSENT


def as_keys(summary: Any) -> dict[str, Any]:
    """Return the keys and values of a summary record, in the order of its fields.

    Records inside, in lists and maps too, become dictionaries likewise; fields that are ``ABSENT`` are left out.
    """
    found = {f.name: getattr(summary, f.name) for f in dataclasses.fields(summary)}
    return {name: _plain(value) for name, value in found.items() if value is not ABSENT}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return as_keys(value)
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value

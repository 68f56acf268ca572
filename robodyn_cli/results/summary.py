"""The summary of a run as JSON: strict, full precision, the same key order every time."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.results.atomic import write_bytes

# Keys of the contract come first and in this order; a command's own results follow in the order given.
LEADING_KEYS = (
    "status",
    "command",
    "title",
    "termination",
    "error",
    "error_estimate",
    "energy_drift",
    "constraint_residual",
)
TRAILING_KEYS = ("counters", "wall_time_s", "outputs")


def jsonable(value: Any) -> Any:
    """Return ``value`` in terms of JSON; NaN and infinities become None, numpy types plain ones."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float | np.floating):
        number = float(value)
        return number if math.isfinite(number) else None
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        items = sorted(value, key=str) if isinstance(value, set | frozenset) else value
        return [jsonable(item) for item in items]
    if isinstance(value, Path):
        return value.as_posix()
    raise TypeError(f"a summary cannot hold {type(value).__name__}: {value!r}")


def ordered(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``summary`` with the keys of the contract first, housekeeping last."""
    middle = [key for key in summary if key not in LEADING_KEYS and key not in TRAILING_KEYS]
    keys = [*LEADING_KEYS, *middle, *TRAILING_KEYS]
    return {key: summary[key] for key in keys if key in summary}


def dumps(summary: Mapping[str, Any], indent: int | None = 2) -> str:
    """Return ``summary`` as strict JSON text."""
    return json.dumps(jsonable(ordered(summary)), indent=indent, ensure_ascii=False, allow_nan=False)


def write_summary(summary: Mapping[str, Any], path: str | Path) -> None:
    """Write ``summary`` to ``path`` atomically."""
    write_bytes(Path(path), (dumps(summary) + "\n").encode())


def read_summary(path: str | Path) -> dict[str, Any]:
    """Return the summary stored at ``path``; an empty one if there is none or it is not ours."""
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}

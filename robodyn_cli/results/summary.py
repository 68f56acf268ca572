"""The summary of a run (a record, a dictionary of its keys, strict JSON in the same key order every time), and where a
result comes from: versions of the libraries in use, and the processor."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import os
import platform
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.foreign import contents
from robodyn_cli.results.atomic import write_bytes
from robodyn_cli.results.json_text import NUMBERS, indented
from robodyn_cli.summaries.facts import ABSENT, key_of

MOST_BYTES = 100_000_000  # of a summary
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
PLAIN = NUMBERS | {str}
TRAILING_KEYS = ("counters", "wall_time_s", "scene_file", "run_id", "outputs")


def as_keys(summary: Any) -> dict[str, Any]:
    """Return the keys and values of a summary record, in the order of its fields.

    Records inside, in lists and maps too, become dictionaries likewise, numbers of numpy those of Python; fields
    that are ``ABSENT`` are left out.
    """
    entries = {key_of(f.name): getattr(summary, f.name) for f in dataclasses.fields(summary)}
    return {name: _plain(value) for name, value in entries.items() if value is not ABSENT}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return as_keys(value)
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        # matrices have a million numbers
        return list(value) if PLAIN.issuperset(map(type, value)) else [_plain(entry) for entry in value]
    return value.item() if isinstance(value, np.generic) else value


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
        if {float}.issuperset(map(type, items)) and all(map(math.isfinite, items)):
            return list(items)
        return [jsonable(item) for item in items]
    if isinstance(value, Path):
        return value.as_posix()
    raise TypeError(f"a summary cannot hold {type(value).__name__}: {value!r}")


def ordered(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``summary`` with the keys of the contract first, housekeeping last."""
    middle = [key for key in summary if key not in LEADING_KEYS and key not in TRAILING_KEYS]
    keys = [*LEADING_KEYS, *middle, *TRAILING_KEYS]
    return {key: summary[key] for key in keys if key in summary}


def dumps(summary: Mapping[str, Any]) -> str:
    """Return ``summary`` as strict JSON text on one line."""
    return json.dumps(jsonable(ordered(summary)), ensure_ascii=False, allow_nan=False)


def write_summary(summary: Mapping[str, Any], path: str | Path) -> None:
    """Write ``summary`` to ``path`` atomically."""
    write_bytes(Path(path), (indented(jsonable(ordered(summary))) + "\n").encode())


def read_summary(path: str | Path) -> dict[str, Any]:
    """Return the summary stored at ``path``; an empty one if there is none, or another program wrote it."""
    try:
        content = json.loads(contents(path, MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries loaded so far, without importing any."""
    by_name = {"python": platform.python_version()}
    for name in ("numpy", "h5py", "llvmlite", "scipy", "casadi"):
        module = sys.modules.get(name)
        if module is not None:
            by_name[name] = str(getattr(module, "__version__", "unknown"))
    h5py = sys.modules.get("h5py")
    if h5py is not None:
        by_name["hdf5"] = str(h5py.version.hdf5_version)
    by_name["platform"] = f"{platform.system()} {platform.release()} {platform.machine()}"
    return by_name


@functools.cache
def cpu_name() -> str:
    """Return the processor's name, without starting another program to find it."""
    if sys.platform.startswith("linux"):
        try:
            # Each further block makes the kernel query the clock of every core; the first one is enough.
            with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as stream:
                head = stream.read(2048)
        except OSError:
            head = ""
        for line in head.splitlines():
            if line.startswith(("model name", "Model", "cpu model")):
                return line.partition(":")[2].strip()
    return os.environ.get("PROCESSOR_IDENTIFIER") or platform.machine()


def sha256(text: str) -> str:
    """Return the SHA-256 of ``text`` in UTF-8, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()

"""Every number of a summary, in many runs beside single ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest

from robodyn_cli.over.many.keys import value_of
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, beyond, make_one

ONE_RUN = ("counters", "run_id", "wall_time_s")  # what single runs count, and when they were made


def numbers_of(facts: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Yield the keys of the numbers in a summary, those in lists too."""
    for name, value in facts.items():
        if path or name not in ONE_RUN:
            inner = dict(enumerate(value)) if isinstance(value, list) else value
            if isinstance(inner, Mapping):
                yield from numbers_of({str(k): x for k, x in inner.items()}, f"{path}{name}.")
            elif isinstance(value, (int, float)):
                yield f"{path}{name}"


def compare_all(task: Task, runs: int, part: float = 0.02, made: int | None = None) -> list[str]:
    """Compare all numbers that code for many runs gives, and their errors, with those of the command; return the keys.

    part : of the values of keys, by which they vary. made : how many runs code makes; default: all.
    """
    _, summary = make_one(dataclasses.replace(task, keys=()), 0, np.empty(0))
    wanted = dataclasses.replace(task, outputs=tuple(numbers_of(summary)))
    task = dataclasses.replace(wanted, outputs=tuple(set(wanted.outputs) - set(beyond(wanted))))
    own = [value_of(task.family, key) for key in task.keys]
    values = np.array(own, dtype=float) * (
        1.0 + part * np.random.default_rng(1).uniform(-1, 1, (runs, len(own)))
    )
    rows = Compiled(task, 1).make(Points(np.arange(runs), values))
    assert len(rows) == (runs if made is None else made)
    for run, row in zip(rows.runs.tolist(), rows.rows):
        one = make_one(task, run, values[run])[0].rows[0]
        for key, value, error, there, stated in zip(
            task.outputs, row["outputs"], row["errors"], one["outputs"], one["errors"]
        ):
            if "error" in key:  # at rounding they are draws of it
                assert value == pytest.approx(there, rel=2.0, abs=1e-9, nan_ok=True), key
                continue
            room = 1e-11 * max(1.0, abs(there)) + (0.0 if np.isnan(stated) else 3.0 * stated)
            assert value == pytest.approx(there, rel=0.0, abs=room, nan_ok=True), key
            assert np.isnan(error) == np.isnan(stated), key
            assert np.isnan(error) or error == pytest.approx(stated, rel=2.0, abs=3e-12), key
    return list(task.outputs)

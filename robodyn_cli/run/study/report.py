"""The result of a study: its rows as datasets, and the summary."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from robodyn_cli.errors import ResultFileError
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import ABSENT, Absent, as_keys
from robodyn_cli.run.batch.stored import read_stored
from robodyn_cli.run.study.row import Row, Values
from robodyn_cli.run.study.statistics import (
    Index,
    Influence,
    Share,
    Spread,
    extremes,
    influences,
    share,
    sobol,
    spread,
)
from robodyn_cli.run.study.study import Study
from robodyn_cli.spatial.algebra import Array

DIGEST = "study_digest"  # attribute of the file


@record
class Case:
    """One run: its number, why it is named, its values and the command that repeats it."""

    run: int
    why: str
    values: dict[str, float]
    command: str


@record
class InputKeys:
    """A key that varies: as it was asked for, and its unit."""

    spec: str
    unit: str


@record
class StudySummary:
    """Keys of the summary of a study, in their order; ``yield``, a word of Python, is added where there is one.

    failures : number of runs by exit code. cases : extremes and first failures.
    """

    runs: int
    of: str
    sampler: str | Absent
    seed: int | Absent
    inputs: dict[str, InputKeys]
    results: dict[str, Spread | None]
    failures: dict[str, int]
    failed: Share
    cases: list[Case]
    influence: dict[str, dict[str, Influence]]
    sobol_indices: dict[str, dict[str, Index] | None] | Absent
    seconds: float


def report(study: Study, rows: Sequence[Row], seconds: float) -> Result:
    """Return the result of a study: inputs, outputs, their estimated errors and exit codes by run."""
    design, task = study.design, study.task
    result = Result("sweep", study.scene.title or task.command, "ok", study.scene.text)
    result.attributes[DIGEST] = study.digest
    for k, key in enumerate(design.keys):
        result.add(
            f"inputs/{key}", design.values[:, k], units=study.units[key] or "1", dims=("run",),
            long_name=f"value of {key}",
        )  # fmt: skip
    outputs = np.array([row.outputs for row in rows]).reshape(len(rows), len(task.outputs))
    errors = np.array([row.errors for row in rows]).reshape(len(rows), len(task.outputs))
    for k, key in enumerate(task.outputs):
        for group, column, meaning in (
            ("outputs", outputs[:, k], key),
            ("errors", errors[:, k], f"estimated error of {key}"),
        ):
            result.add(
                f"{group}/{key}", column, units=study.output_units[key], dims=("run",), long_name=meaning
            )
    code = [float(row.code) for row in rows]
    result.add("runs/exit_code", code, units="1", dims=("run",), long_name="exit code of each run")
    held = [float(row.holds) for row in rows]
    result.add(
        "runs/holds", held, units="1", dims=("run",), long_name="1 where all that the scene expects holds"
    )
    _summarise(result, study, rows, outputs, errors, seconds)
    return result


def _summarise(
    result: Result, study: Study, rows: Sequence[Row], outputs: Array, errors: Array, seconds: float
) -> None:
    design, options = study.design, study.asked.options
    sampled = options.n is not None
    failures = Counter(row.code for row in rows if row.code)
    columns = {key: outputs[:, k] for k, key in enumerate(study.task.outputs)}
    summary = StudySummary(
        runs=len(rows),
        of=study.task.command,
        sampler=options.sampler if sampled else ABSENT,
        seed=options.seed if sampled else ABSENT,
        inputs={key: InputKeys(v.text, study.units[key]) for key, v in options.vary.items()},
        results={
            key: spread(column, errors[:, k], study.nominal.outputs[k], study.output_units[key], sampled)
            for k, (key, column) in enumerate(columns.items())
        },
        failures={str(code): count for code, count in sorted(failures.items())},
        failed=share(sum(failures.values()), len(rows), sampled),
        cases=_cases(study, rows, columns),
        influence={key: influences(design, column) for key, column in columns.items()},
        sobol_indices={key: sobol(design, column) for key, column in columns.items()}
        if design.indices
        else ABSENT,
        seconds=seconds,
    )
    result.summarise(summary)
    if study.scene.expect:
        result.summary["yield"] = as_keys(share(sum(row.holds for row in rows), len(rows), sampled))


def _cases(study: Study, rows: Sequence[Row], columns: Mapping[str, Array]) -> list[Case]:
    """Return the extremes of each output, and the first run that failed with each exit code."""
    named: dict[int, list[str]] = {}
    for key, column in columns.items():
        for word, run in zip(("smallest", "largest"), extremes(column)):
            named.setdefault(run, []).append(f"{word} {key}")
    seen: set[int] = set()
    for k, row in enumerate(rows):
        if row.code and row.code not in seen:
            seen.add(row.code)
            named.setdefault(k, []).append(f"exit code {row.code}: {row.reason}")
    return [
        Case(k, "; ".join(why), dict(zip(study.task.keys, rows[k].values)), study.repeat(rows[k].values))
        for k, why in named.items()
    ]


def earlier_rows(study: Study, directory: Path) -> dict[Values, Row]:
    """Return the rows that a directory holds of a study of the same scene and outputs, by their values.

    Runs that failed are left out: they run again.
    """
    try:
        result = read_stored(directory)
    except ResultFileError:
        return {}
    if result.attributes.get(DIGEST) != study.digest:
        return {}
    inputs = np.column_stack([result[f"inputs/{key}"] for key in study.task.keys])
    outputs = np.column_stack([result[f"outputs/{key}"] for key in study.task.outputs])
    errors = np.column_stack([result[f"errors/{key}"] for key in study.task.outputs])
    return {
        tuple(values): Row(tuple(values), 0, tuple(out), tuple(error), bool(holds), "", math.nan)
        for values, out, error, code, holds in zip(
            inputs.tolist(),
            outputs.tolist(),
            errors.tolist(),
            result["runs/exit_code"],
            result["runs/holds"],
        )
        if code == 0
    }

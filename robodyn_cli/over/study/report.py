"""The result of a study: its rows as datasets, how outputs spread over its runs, the influence of each key. Statistics
take a memory that does not grow with the number of runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import ResultFileError
from robodyn_cli.over.batch.stored import read_stored
from robodyn_cli.over.study.design import strata
from robodyn_cli.over.study.rows import RowFile
from robodyn_cli.over.study.statistics import (
    Blocks,
    Moments,
    SampleSpread,
    influences,
    quantiles,
    share,
    sobol,
)
from robodyn_cli.over.study.study import Study
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.study import (
    Influence,
    InputKeys,
    NamedRun,
    Share,
    SobolIndex,
    Spread,
    StudySummary,
)

if TYPE_CHECKING:
    from robodyn_cli.results.hdf5.writer import ResultWriter

MOST = 1 << 15  # runs that are held in memory at once
DIGEST = "study_digest"  # attribute of the file


def report(study: Study, file: RowFile, writer: ResultWriter, seconds: float) -> Result:
    """Write inputs, outputs, their estimated errors and exit codes by run; return the result without them."""
    by_series = any(rows["series"].any() for _, rows in file.blocks())
    for first, rows in file.blocks():
        _store(study, first, rows, writer)
        if by_series:
            writer.append("runs/series", rows["series"])
    result = Result("sweep", study.scene.title or study.task.command, "ok", study.scene.text)
    result.attributes[DIGEST] = study.digest
    findings = StudyFindings(study, file)
    options, sampled = study.asked.options, findings.sampled
    summary = StudySummary(
        runs=len(file),
        of=study.task.command,
        sampler=options.sampler if sampled else ABSENT,
        seed=options.seed if sampled else ABSENT,
        inputs={key: InputKeys(v.text, study.units[key]) for key, v in options.vary.items()},
        results=findings.spreads(),
        failures={str(code): count for code, count in sorted(findings.failures.items())},
        failed=findings.share(findings.failed),
        cases=findings.cases(),
        influence=findings.influences(),
        series={f"taylor{order}": count for order, count in sorted(findings.orders.items())} or ABSENT,
        sobol_indices=findings.sobol_indices() if study.design.indices else ABSENT,
        seconds=seconds,
        yield_=findings.share(findings.held) if study.scene.expect else ABSENT,
        least_yield=ABSENT if options.least_yield is None else options.least_yield,
    )
    result.summarise(summary)
    return result


def _store(study: Study, first: int, rows: NDArray[Any], writer: ResultWriter) -> None:
    """Add a block of rows to the result file."""
    values = study.design.rows(first, first + len(rows))
    for k, key in enumerate(study.design.keys):
        writer.append(
            f"inputs/{key}", values[:, k], units=study.units[key] or "1", long_name=f"value of {key}"
        )
    for k, key in enumerate(study.task.outputs):
        unit = study.output_units[key]
        writer.append(f"outputs/{key}", rows["outputs"][:, k], units=unit, long_name=key)
        writer.append(
            f"errors/{key}", rows["errors"][:, k], units=unit, long_name=f"estimated error of {key}"
        )
    writer.append("runs/exit_code", rows["code"])
    writer.append("runs/holds", rows["holds"])


class StudyFindings:
    """What the rows of a study say together.

    failures, orders : numbers of runs by exit code, by order of the Taylor series that made them. failed, held : how
    many of those that count (``Design.counted``) failed, and hold what the scene expects. sample : the rows of
    ``MOST`` runs at most, from which influences are told.
    """

    def __init__(self, study: Study, file: RowFile) -> None:
        self.study, self._file = study, file
        self.sampled = study.asked.options.n is not None
        self.failures: Counter[int] = Counter()
        self.orders: Counter[int] = Counter()
        self.failed = self.held = 0
        self._moments = [Moments() for _ in study.task.outputs]
        chosen, parts = strata(len(file), MOST), []
        for first, rows in file.blocks():
            for name, found in (("code", self.failures), ("series", self.orders)):
                numbers, counts = np.unique(rows[name], return_counts=True)
                found.update({int(c): int(n) for c, n in zip(numbers, counts) if c})
            own = max(0, study.design.counted - first)  # of this block, the first ones
            self.failed += int(np.count_nonzero(rows["code"][:own]))
            self.held += int(np.count_nonzero(rows["holds"][:own]))
            for k, moments in enumerate(self._moments):
                moments.add(first, rows["outputs"][:, k], rows["errors"][:, k], own)
            low, high = np.searchsorted(chosen, (first, first + len(rows)))
            parts.append(rows[chosen[low:high] - first])
        self.sample = np.concatenate(parts)
        self._counted = chosen < study.design.counted

    def share(self, count: int) -> Share:
        """Return the share of the runs that count."""
        design = self.study.design
        return share(count, design.counted, design.independent if self.sampled else 0)

    def _columns(self) -> Iterator[tuple[str, Array, Blocks]]:
        """Yield each output: its key, its values in the sample, and what gives all of them by blocks."""
        for k, key in enumerate(self.study.task.outputs):

            def blocks(k: int = k, last: int = len(self._file)) -> Iterator[Array]:
                parts = ((first, rows["outputs"][:, k]) for first, rows in self._file.blocks())
                return (values[: last - first] for first, values in parts if first < last)

            yield key, self.sample["outputs"][:, k], blocks

    def spreads(self) -> dict[str, Spread | None]:
        """Return how each output spreads."""
        study, spreads = self.study, {}
        design = study.design
        for k, (key, sample, blocks) in enumerate(self._columns()):
            moments, own = self._moments[k], sample[self._counted]
            # of runs without the output as large a part is taken to be independent as of all
            independent = max(1, design.independent * moments.counted // design.counted)
            spreads[key] = moments.spread(
                study.nominal["outputs"][k],
                study.output_units[key],
                SampleSpread.of(own, independent) if self.sampled else None,
                partial(quantiles, partial(blocks, last=design.counted), moments.counted, own),
            )
        return spreads

    def influences(self) -> dict[str, dict[str, Influence]]:
        """Return the influence of each key on each output."""
        keys, values = self.study.design.keys, self.sample["values"]
        return {key: influences(keys, values, sample) for key, sample, _ in self._columns()}

    def sobol_indices(self) -> dict[str, dict[str, SobolIndex] | None]:
        """Return Sobol's indices of each output, which takes all of its values at once."""
        keys = self.study.design.keys
        return {
            key: sobol(keys, np.concatenate([*blocks()]), max(0.0, moments.largest_error))
            for (key, _, blocks), moments in zip(self._columns(), self._moments)
        }

    def cases(self) -> list[NamedRun]:
        """Return the extremes of each output, and the first run that failed with each exit code."""
        named: dict[int, list[str]] = {}
        for key, moments in zip(self.study.task.outputs, self._moments):
            for word, run in (("smallest", moments.least_run), ("largest", moments.greatest_run)):
                if run >= 0 and f"smallest {key}" not in named.get(run, ()):
                    named.setdefault(run, []).append(f"{word} {key}")
        for code, (run, reason) in sorted(self._file.reasons.items(), key=lambda item: item[1][0]):
            named.setdefault(run, []).append(f"exit code {code}: {reason}")
        return [self._case(run, "; ".join(why)) for run, why in named.items()]

    def _case(self, run: int, why: str) -> NamedRun:
        values = self.study.design.rows(run, run + 1)[0].tolist()
        return NamedRun(run, why, dict(zip(self.study.task.keys, values)), self.study.repeat(values))


def earlier_rows(study: Study, directory: Path) -> NDArray[Any] | None:
    """Return the rows that a directory holds of a study of the same scene and outputs, None where there are none."""
    try:
        result = read_stored(directory)
    except ResultFileError:
        return None
    if result.attributes.get(DIGEST) != study.digest:
        return None
    task = study.task
    rows = np.zeros(len(result["runs/exit_code"]), task.layout)
    for k, key in enumerate(task.keys):
        rows["values"][:, k] = result[f"inputs/{key}"]
    for k, key in enumerate(task.outputs):
        rows["outputs"][:, k], rows["errors"][:, k] = result[f"outputs/{key}"], result[f"errors/{key}"]
    rows["code"], rows["holds"], rows["done"] = result["runs/exit_code"], result["runs/holds"], True
    if "runs/series" in result:
        rows["series"] = result["runs/series"]
    return rows

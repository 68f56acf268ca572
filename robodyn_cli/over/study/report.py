"""The result of a study: its rows as datasets, how outputs spread over its runs, the influence of each key. Statistics
take a memory that does not grow with the number of runs.

Mean, deviation and extremes come from one pass. Quantiles of more than ``MOST`` runs take a second one: those of a
sample tell between which values a quantile lies, values below are counted, and those between are kept.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import ResultFileError
from robodyn_cli.over.batch.stored import read_stored
from robodyn_cli.over.study.design import strata
from robodyn_cli.over.study.rows import RowFile
from robodyn_cli.over.study.study import Study
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.study import (
    LEVELS,
    QUANTILES,
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
WIDTH = 6.0  # standard errors on both sides of a sample's quantile, where that of all is looked for
Blocks = Callable[[], Iterator[Array]]


class Moments:
    """Number, mean, variance and extremes of an output over the runs that have it.

    Source of the joined variance: Chan, Golub, LeVeque, Updating formulae and a pairwise algorithm for computing sample
    variances, Stanford STAN-CS-79-773 (1979).
    """

    def __init__(self) -> None:
        self.runs, self.mean, self._squares = 0, 0.0, 0.0
        self.least, self.greatest = math.inf, -math.inf
        self.least_run = self.greatest_run = -1
        self.largest_error = -math.inf

    def add(self, first: int, values: Array, errors: Array) -> None:
        """Take values and their errors of runs from ``first`` on into account, nan where there are none."""
        known = errors[np.isfinite(errors)]
        self.largest_error = max(self.largest_error, float(known.max(initial=-math.inf)))
        there = np.isfinite(values)
        finite = values[there]
        if not finite.size:
            return
        runs, mean = self.runs + finite.size, float(finite.mean())
        away = mean - self.mean
        self._squares += float(((finite - mean) ** 2).sum()) + away**2 * self.runs * finite.size / runs
        self.mean += away * finite.size / runs
        self.runs = runs
        self._extremes(first, np.where(there, values, math.nan))

    def _extremes(self, first: int, values: Array) -> None:
        low, high = int(np.nanargmin(values)), int(np.nanargmax(values))
        if values[low] < self.least:
            self.least, self.least_run = float(values[low]), first + low
        if values[high] > self.greatest:
            self.greatest, self.greatest_run = float(values[high]), first + high

    def spread(self, nominal: float, unit: str, quantiles: Array | None) -> Spread | None:
        """Return the spread, None where no run has the output; quantiles : at ``LEVELS``, of samples alone."""
        if not self.runs:
            return None
        ends = self.least, self.greatest, nominal if math.isfinite(nominal) else None, unit
        largest_error = self.largest_error if math.isfinite(self.largest_error) else ABSENT
        if quantiles is None:
            return Spread(self.runs, *ends, largest_error=largest_error)
        sd = math.sqrt(self._squares / (self.runs - 1)) if self.runs > 1 else 0.0
        return Spread(
            self.runs,
            *ends,
            mean=self.mean,
            sd=sd,
            quantiles=dict(zip(QUANTILES, quantiles.tolist())),
            mean_error=sd / math.sqrt(self.runs),
            largest_error=largest_error,
        )


def quantiles(blocks: Blocks, runs: int, sample: Array, levels: Sequence[float] = LEVELS) -> Array:
    """Return quantiles as ``np.quantile`` has them, of the finite ones of all values.

    Parameters
    ----------
    blocks : gives all values, block by block. runs : number of finite ones. sample : some of them, or all.
    """
    there = np.sort(sample[np.isfinite(sample)])
    if len(there) == runs:
        return np.quantile(there, levels)
    return np.array([_quantile(blocks, runs, there, level) for level in levels])


def _quantile(blocks: Blocks, runs: int, sample: Array, level: float) -> float:
    """Return a quantile of many values from a bracket that the sorted sample gives; a wider one where it is missed."""
    place = level * (runs - 1)
    half = WIDTH * math.sqrt(level * (1.0 - level) / max(len(sample), 1))
    while True:
        low = _of_sorted(sample, level - half, -math.inf)
        high = _of_sorted(sample, level + half, math.inf)
        below, at_low, at_high, inside = 0, 0, 0, [np.empty(0)]
        for block in blocks():
            values = block[np.isfinite(block)]
            below += int(np.count_nonzero(values < low))
            at_low += int(np.count_nonzero(values == low))
            at_high += int(np.count_nonzero(values == high)) if high > low else 0
            inside.append(values[(values > low) & (values < high)])
        between = np.sort(np.concatenate(inside))
        # the values at the ends may be many, and are counted
        first, last = math.floor(place) - below, math.ceil(place) - below
        if first >= 0 and last < at_low + len(between) + at_high:
            a, b = (
                low if k < at_low else high if k >= at_low + len(between) else float(between[k - at_low])
                for k in (first, last)
            )
            return a + (place - math.floor(place)) * (b - a)
        half *= 4.0


def _of_sorted(sample: Array, level: float, beyond: float) -> float:
    """Return the value at a level of a sorted sample, ``beyond`` outside."""
    k = math.floor(level * len(sample))
    return float(sample[k]) if 0 <= k < len(sample) else beyond


CONFIDENCE = 0.95  # of all intervals


def share(count: int, runs: int, sampled: bool = True) -> Share:
    """Return the share of runs; of random samples with the interval that holds its true value with 95 % confidence."""
    if not sampled:
        return Share(count / runs)
    from scipy.special import betaincinv

    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(betaincinv(count, runs - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, runs - count, 1.0 - tail)) if count < runs else 1.0
    return Share(count / runs, low, high, CONFIDENCE)


def influences(keys: Sequence[str], values: Array, output: Array) -> dict[str, Influence]:
    """Return the influence of each key that takes several values, the largest first; none for too few runs.

    values : (N, keys). output : (N,), nan where a run has none.
    """
    fit = np.isfinite(output)
    moving = [k for k in range(len(keys)) if np.ptp(values[:, k]) > 0.0]
    if np.count_nonzero(fit) < len(moving) + 2:
        return {}
    x, y = values[fit][:, moving], output[fit]
    slopes = np.linalg.lstsq(np.column_stack([x - x.mean(axis=0), np.ones(len(x))]), y, rcond=None)[0][:-1]
    low, high = np.quantile(x, (0.05, 0.95), axis=0)
    ranks = _ranks(y)
    found = {
        keys[key]: Influence(float(slope * (b - a)), _correlation(_ranks(x[:, k]), ranks))
        for k, (key, slope, a, b) in enumerate(zip(moving, slopes, low, high))
    }
    return dict(sorted(found.items(), key=lambda item: -abs(item[1].swing)))


def _ranks(x: Array) -> Array:
    """Return ranks, equal values with their mean rank."""
    _, which, counts = np.unique(x, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return np.asarray(ends - (counts - 1) / 2.0)[which]


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / size if size else 0.0


def sobol(keys: Sequence[str], output: Array) -> dict[str, SobolIndex] | None:
    """Return Sobol's indices of an output of Saltelli's design; None where it has gaps or does not vary.

    Source: Saltelli et al. 2010, as ``scipy.stats.sobol_indices`` has it, with its bootstrap.
    """
    from scipy.stats import sobol_indices

    k = len(keys)
    n = len(output) // (k + 2)
    if not np.all(np.isfinite(output)) or np.ptp(output) == 0.0:
        return None
    blocks = output.reshape(k + 2, n)
    # scipy fails on the single number of one output and one key, so the output stands there twice
    twice = np.stack([blocks, blocks], axis=1)
    indices = sobol_indices(func={"f_A": twice[0], "f_B": twice[1], "f_AB": twice[2:]}, n=n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # resamples may not vary, see _sides
        spreads = indices.bootstrap(confidence_level=CONFIDENCE)
    orders = ((indices.first_order, spreads.first_order), (indices.total_order, spreads.total_order))
    columns = [column for value, order in orders for column in (value, *_sides(order))]
    by_key = np.array([column.reshape(2, k)[0] for column in columns]).T
    return {key: SobolIndex(*(float(x) for x in row)) for key, row in zip(keys, by_key)}


def _sides(order: Any) -> tuple[Array, Array]:
    """Return both ends of a bootstrap's interval.

    Where the corrected one (BCa) does not exist, because no resample varies or hardly one does (a key without
    influence, very few samples), it is that between quantiles.
    """
    tail = (1.0 - CONFIDENCE) / 2.0
    plain = np.nanquantile(order.bootstrap_distribution, (tail, 1.0 - tail), axis=-1)
    low, high = order.confidence_interval
    there = np.isfinite(low) & np.isfinite(high)
    return np.where(there, low, plain[0]), np.where(there, high, plain[1])


DIGEST = "study_digest"  # attribute of the file


def report(study: Study, file: RowFile, writer: ResultWriter, seconds: float) -> Result:
    """Write inputs, outputs, their estimated errors and exit codes by run; return the result without them."""
    for first, rows in file.blocks():
        _store(study, first, rows, writer)
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
        failed=share(findings.failures.total(), len(file), sampled),
        cases=findings.cases(),
        influence=findings.influences(),
        sobol_indices=findings.sobol_indices() if study.design.indices else ABSENT,
        seconds=seconds,
        yield_=share(findings.held, len(file), sampled) if study.scene.expect else ABSENT,
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

    failures : numbers of runs by exit code. held : how many hold what the scene expects. sample : the rows of ``MOST``
    runs at most, from which influences are told.
    """

    def __init__(self, study: Study, file: RowFile) -> None:
        self.study, self._file = study, file
        self.sampled = study.asked.options.n is not None
        self.failures: Counter[int] = Counter()
        self.held = 0
        self._moments = [Moments() for _ in study.task.outputs]
        chosen, parts = strata(len(file), MOST), []
        for first, rows in file.blocks():
            codes, counts = np.unique(rows["code"], return_counts=True)
            self.failures.update({int(c): int(n) for c, n in zip(codes, counts) if c})
            self.held += int(np.count_nonzero(rows["holds"]))
            for k, moments in enumerate(self._moments):
                moments.add(first, rows["outputs"][:, k], rows["errors"][:, k])
            low, high = np.searchsorted(chosen, (first, first + len(rows)))
            parts.append(rows[chosen[low:high] - first])
        self.sample = np.concatenate(parts)

    def _columns(self) -> Iterator[tuple[str, Array, Blocks]]:
        """Yield each output: its key, its values in the sample, and what gives all of them by blocks."""
        for k, key in enumerate(self.study.task.outputs):

            def blocks(k: int = k) -> Iterator[Array]:
                return (rows["outputs"][:, k] for _, rows in self._file.blocks())

            yield key, self.sample["outputs"][:, k], blocks

    def spreads(self) -> dict[str, Spread | None]:
        """Return how each output spreads."""
        study, spreads = self.study, {}
        for k, (key, sample, blocks) in enumerate(self._columns()):
            moments = self._moments[k]
            levels = quantiles(blocks, moments.runs, sample) if self.sampled and moments.runs else None
            spreads[key] = moments.spread(study.nominal["outputs"][k], study.output_units[key], levels)
        return spreads

    def influences(self) -> dict[str, dict[str, Influence]]:
        """Return the influence of each key on each output."""
        keys, values = self.study.design.keys, self.sample["values"]
        return {key: influences(keys, values, sample) for key, sample, _ in self._columns()}

    def sobol_indices(self) -> dict[str, dict[str, SobolIndex] | None]:
        """Return Sobol's indices of each output, which takes all of its values at once."""
        keys = self.study.design.keys
        return {key: sobol(keys, np.concatenate([*blocks()])) for key, _, blocks in self._columns()}

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
    return rows

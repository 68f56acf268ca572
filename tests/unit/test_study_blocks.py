"""Studies by blocks: points, rows on disk and statistics are those of the whole, in a memory that stays the same."""

from __future__ import annotations

import json
import tracemalloc
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.expr.statements import parse_variation
from robodyn_cli.over.study.design import Design, make_design, strata
from robodyn_cli.over.study.report import MOST, report
from robodyn_cli.over.study.rows import BLOCK, REASONS_NAME, ROWS_NAME, RowFile, RunRows
from robodyn_cli.over.study.statistics import Moments, SampleSpread, quantiles
from robodyn_cli.over.study.study import AskedStudy, Study, prepare
from robodyn_cli.results.hdf5 import ResultWriter, read
from robodyn_cli.scene.load import Family, load_scene_text
from robodyn_cli.scene.nested_options import Correlation
from robodyn_cli.scene.types import StudyOptions
from robodyn_cli.summaries.study import LEVELS

SLIDER = """
schema: 1
command: simulate
gravity: [0, 0, -9.81]
robot:
  joints: [{name: z, type: prismatic, parent: base, axis: [0, 0, 1]}]
  links: [{name: ball, mass: 2.0}]
parameters: {k: 3.0}
initial: {q: {z: 0}}
simulate: {duration: 0.1, samples: 2}
"""


def study_of(**options: Any) -> Study:
    options["vary"] = {key: parse_variation(spec) for key, spec in options["vary"].items()}
    family = Family.of(load_scene_text(SLIDER))
    return prepare(AskedStudy(family, StudyOptions(of=("final.q.z",), **options)))


def filled(file: RowFile, output: Any, codes: Any = None) -> None:
    """Give all missing runs an output, as a function of their values, and an exit code."""
    missing = file.missing()
    while len(points := missing.take(3000)):
        rows = np.zeros(len(points), file.layout)
        rows["values"], rows["done"] = points.values, True
        rows["outputs"][:, 0] = output(points.values)
        rows["errors"] = 1e-9
        rows["code"] = 0 if codes is None else codes(points.values)
        failed = np.flatnonzero(rows["code"]).tolist()
        file.add(RunRows(points.runs, rows, {int(points.runs[k]): f"run {points.runs[k]}" for k in failed}))


# -- points ---------------------------------------------------------------------------------------------
DESIGNS = {
    "samples": {"vary": {"a": "normal(0, 1)", "b": "triangular(0, 1, 3)"}, "n": 60},
    "grid": {"vary": {"a": "[1, 2, 5]", "b": "linspace(0, 1, 21)"}},
    "both": {"vary": {"g": "[1, 2]", "a": "normal(0, 1)", "h": "linspace(0, 1, 3)"}, "n": 16},
    "correlated": {"vary": {"a": "normal(0, 1)", "b": "uniform(0, 1)"}, "n": 60,
                   "correlation": (Correlation(("a", "b"), 0.5),)},
    "indices": {"vary": {"a": "normal(0, 1)", "b": "uniform(0, 1)"}, "n": 16},
}  # fmt: skip


def design_of(name: str, sampler: str) -> Design:
    options = dict(DESIGNS[name])
    vary = {key: parse_variation(spec) for key, spec in options.pop("vary").items()}
    given = StudyOptions(vary=vary, sampler=sampler, seed=3, **options)
    return make_design(given, indices=name == "indices")


@pytest.mark.parametrize("sampler", ["random", "sobol", "latin"])
@pytest.mark.parametrize("name", DESIGNS)
def test_blocks_of_points_are_parts_of_the_whole(name: str, sampler: str) -> None:
    whole = design_of(name, sampler).rows()
    for size in (1, 5, 37, 1000):
        design = design_of(name, sampler)
        parts = [design.rows(k, min(k + size, len(design))) for k in range(0, len(design), size)]
        assert np.array_equal(np.vstack(parts), whole), size
        assert np.array_equal(design.rows(7, 9), whole[7:9])  # back again


def test_a_sample_of_runs_has_one_of_each_part() -> None:
    assert np.array_equal(strata(5, 10), np.arange(5))
    chosen, edges = strata(1003, 100), np.linspace(0, 1003, 101).astype(int)
    assert np.all((edges[:-1] <= chosen) & (chosen < edges[1:])) and len(set(chosen % 10)) > 3


# -- rows on disk ---------------------------------------------------------------------------------------
def test_rows_of_other_samples_are_taken_over_by_their_values(tmp_path: Path) -> None:
    vary = {"robot.links.ball.mass": "[1, 2, 3]", "parameters.k": "uniform(1, 2)"}
    few, many = (
        study_of(vary=dict(vary), n=40),
        study_of(vary={**vary, "robot.links.ball.mass": "[3, 1]"}, n=90),
    )
    with RowFile(tmp_path, few.task, few.design, few.rows_head) as file:
        filled(file, lambda x: x[:, 0] + x[:, 1], lambda x: np.where(x[:, 1] > 1.9, 4, 0))
        failed = np.count_nonzero(file.read(0, 120)["code"][40:] == 0) - 40  # of the masses 2 and 3
    kept = sum(
        int(np.count_nonzero(x[:, 1] <= 1.9)) for x in (few.design.rows(0, 40), few.design.rows(80, 120))
    )
    assert failed < 40
    with RowFile(tmp_path, many.task, many.design, many.rows_head) as file:
        # all of those that went well, and not one more
        assert file.done == kept
        rows = file.read(0, len(file))
        there = rows["done"]
        assert np.array_equal(rows["values"][there], many.design.rows()[there])
        assert np.array_equal(rows["outputs"][there, 0], rows["values"][there].sum(axis=1))
        assert not rows["code"].any() and file.missing().left == 180 - kept
    assert {path.name for path in tmp_path.iterdir()} == {ROWS_NAME, REASONS_NAME}


def test_rows_survive_a_process_that_was_killed_as_it_took_them_over(tmp_path: Path) -> None:
    vary = {"parameters.k": "uniform(1, 2)"}
    few, many = study_of(vary=dict(vary), n=50), study_of(vary=dict(vary), n=70)
    with RowFile(tmp_path, few.task, few.design, few.rows_head) as file:
        filled(file, lambda x: x[:, 0])
    content = (tmp_path / ROWS_NAME).read_bytes()
    size = few.task.layout.itemsize
    for head, there in ((few.rows_head, 0), (many.rows_head, 0), (many.rows_head, 20)):
        (tmp_path / ROWS_NAME).with_suffix(".old").write_bytes(content)
        (tmp_path / ROWS_NAME).write_bytes(content[: there * size] + bytes((70 - there) * size))
        (tmp_path / REASONS_NAME).write_text(json.dumps(head) + "\n")
        with RowFile(tmp_path, many.task, many.design, many.rows_head) as file:
            assert file.done == 50


def test_rows_of_another_scene_are_left(tmp_path: Path) -> None:
    study = study_of(vary={"parameters.k": "uniform(1, 2)"}, n=50)
    with RowFile(tmp_path, study.task, study.design, study.rows_head) as file:
        filled(file, lambda x: x[:, 0])
    with RowFile(tmp_path, study.task, study.design, {**study.rows_head, "study": "another"}) as file:
        assert file.done == 0 and not file.read(0, 50)["done"].any()


# -- statistics -----------------------------------------------------------------------------------------
def values_of(kind: str, runs: int) -> Any:
    rng = np.random.default_rng(1)
    found = {
        "normal": rng.normal(3.0, 2.0, runs),
        "sorted": np.linspace(0.0, 1.0, runs) ** 3,
        "tied": rng.integers(0, 5, runs) / 4.0,
        "half tied": np.where(rng.random(runs) < 0.5, 7.0, rng.normal(7.0, 1.0, runs)),
        "equal": np.full(runs, 2.5),
        "gaps": np.where(rng.random(runs) < 0.3, np.nan, rng.exponential(1.0, runs)),
    }[kind]
    return found


@pytest.mark.parametrize("kind", ["normal", "sorted", "tied", "half tied", "equal", "gaps"])
def test_moments_and_quantiles_by_blocks_are_those_of_the_whole(kind: str) -> None:
    x = values_of(kind, 5 * BLOCK + 17)
    there = x[np.isfinite(x)]
    moments = Moments()
    for first in range(0, len(x), BLOCK):
        moments.add(first, x[first : first + BLOCK], np.full(len(x[first : first + BLOCK]), 1e-3))

    def blocks() -> Any:
        return (x[k : k + BLOCK] for k in range(0, len(x), BLOCK))

    for sample in (x, x[strata(len(x), 700)], x[:3]):
        assert np.array_equal(quantiles(blocks, len(there), sample), np.quantile(there, LEVELS))
    sampled, of = SampleSpread.of(sample, len(there)), partial(quantiles, blocks, moments.counted, sample)
    found = moments.spread(1.0, "m", sampled, of)
    assert found is not None
    assert found.mean == pytest.approx(there.mean(), rel=1e-12)
    assert found.sd == pytest.approx(there.std(ddof=1), rel=1e-12, abs=1e-15)
    assert (found.runs, found.minimum, found.maximum) == (len(there), there.min(), there.max())
    assert x[moments.least_run] == there.min() and x[moments.greatest_run] == there.max()
    assert found.largest_error == 1e-3


def reported(study: Study, directory: Path, output: Any, codes: Any = None) -> tuple[Any, int]:
    """Return the result of a study whose outputs are given, and the most memory that it took meanwhile [bytes]."""
    with RowFile(directory, study.task, study.design, study.rows_head) as file:
        tracemalloc.start()
        filled(file, output, codes)
        with ResultWriter(directory / "result.h5", command="sweep") as writer:
            result = report(study, file, writer, 1.0)
            writer.finish(summary=result.summary)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return result, most


def test_more_runs_take_no_more_memory_and_tell_the_same(tmp_path: Path) -> None:
    vary = {"parameters.k": "uniform(0, 1)", "robot.links.ball.mass": "uniform(1, 3)"}
    most = {}
    for runs in (MOST, 8 * MOST):
        directory = tmp_path / str(runs)
        directory.mkdir()
        study = study_of(vary=dict(vary), n=runs)
        result, most[runs] = reported(
            study, directory, lambda x: 3.0 * x[:, 0] - x[:, 1], lambda x: np.where(x[:, 0] > 0.999, 4, 0)
        )
        summary = result.summary
        x = study.design.rows()
        y, stored = 3.0 * x[:, 0] - x[:, 1], read(directory / "result.h5")
        assert np.array_equal(stored["outputs/final.q.z"], y)
        assert np.array_equal(stored["inputs/parameters.k"], x[:, 0])
        first = int(np.flatnonzero(x[:, 0] > 0.999)[0])
        assert summary["failures"] == {"4": int(np.count_nonzero(x[:, 0] > 0.999))}
        spread = summary["results"]["final.q.z"]
        assert spread["quantiles"]["5 %"] == np.quantile(y, 0.05)
        assert [case["run"] for case in summary["cases"]] == [int(y.argmin()), int(y.argmax()), first]
        assert summary["cases"][2]["why"] == f"exit code 4: run {first}"
        influence = summary["influence"]["final.q.z"]
        assert influence["parameters.k"]["swing"] == pytest.approx(2.7, abs=0.02)
    assert most[8 * MOST] < 1.2 * most[MOST]

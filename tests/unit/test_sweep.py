"""Studies: what keys vary over, their points, runs side by side, going on, statistics."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.statements import parse_variation
from robodyn_cli.model.build import build_model
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.over.study.design import make_design
from robodyn_cli.over.study.rows import ROWS_NAME, RowFile, Task
from robodyn_cli.over.study.runs import run_here
from robodyn_cli.over.study.statistics import influences, share, sobol
from robodyn_cli.over.study.study import AskedStudy, prepare
from robodyn_cli.results.hdf5 import read
from robodyn_cli.scene.load import Family, load_scene, load_scene_text
from robodyn_cli.scene.nested_options import Correlation
from robodyn_cli.scene.types import StudyOptions
from robodyn_cli.summaries.keys import leaf_of

# a falling point mass with drag-free motion has a closed form: z = v t - g t^2 / 2
FALL = """
schema: 1
command: simulate
gravity: [0, 0, -9.81]
robot:
  joints: [{name: z, type: prismatic, parent: base, axis: [0, 0, 1]}]
  links: [{name: ball, mass: 2.0}]
initial: {q: {z: 0}, qd: {z: 1.0}}
simulate: {duration: 1.0, samples: 3, rtol: 1e-10, atol: 1e-12}
expect: {final.q.z: -5 .. -3}
"""
CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PENDULUM = """
schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  joints: [{name: theta, type: revolute, parent: base, axis: [0, 0, 1]}]
  links: [{name: rod, mass: 1.3, com: [0.4, 0, 0], inertia: {zz: 0.02}}]
initial: {q: {theta: 20 deg}}
simulate: {duration: 1, samples: 11}
"""


@pytest.fixture
def fall(tmp_path: Path) -> Path:
    path = tmp_path / "fall.yaml"
    path.write_text(FALL)
    return path


def sweep(*words: object) -> Any:
    return CliRunner().invoke(app, ["sweep", *map(str, words)])


def stored(path: Path) -> tuple[Any, dict[str, Any]]:
    return read(path / "result.h5"), json.loads((path / "summary.json").read_text())


def test_a_study_in_which_nothing_locks_says_so(tmp_path: Path) -> None:
    """Each run meets a bifurcation in place of its lock, which compiled code leaves to whole commands."""
    scene = Path(__file__).resolve().parents[2] / "configs" / "four_bar_deploy.yaml"
    out = tmp_path / "out"
    done = sweep(scene, "--vary", "gravity.1=[-9.8, -9.9]", "--no-plots", "--out", out)
    assert done.exit_code == 0, done.output
    assert json.loads((out / "summary.json").read_text())["failures"] == {"4": 2}


# -- what a key varies over -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    "text, values",
    [
        ("[1, 2.5, 1e3]", (1.0, 2.5, 1e3)),
        ("linspace(0, 1, 5)", (0.0, 0.25, 0.5, 0.75, 1.0)),
        ("linspace(3, 3, 1)", (3.0,)),
        ("logspace(1, 1000, 4)", (1.0, 10.0, 100.0, 1000.0)),
        ("[0 deg, 90 deg]", (0.0, math.pi / 2)),
        ("[pi/2, max(1, 2)]", (math.pi / 2, 2.0)),
    ],
)
def test_a_grid_has_the_values_that_are_written(text: str, values: tuple[float, ...]) -> None:
    assert parse_variation(text).values == pytest.approx(values, rel=1e-15)


@pytest.mark.parametrize(
    "text, part",
    [
        ("", "no range"),
        ("5", "no range"),
        ("[]", "no values"),
        ("linspace(0, 1)", "three numbers"),
        ("linspace(0, 1, 2.5)", "whole number"),
        ("linspace(0, 1, 1e12)", "whole number"),
        ("logspace(-1, 1, 3)", "same sign"),
        ("uniform(2, 1)", "not below"),
        ("triangular(0, 3, 1)", "low <= mode <= high"),
        ("normal(0, 5 %)", "no scale"),
        ("normal(1, -1)", "> 0"),
        ("normal(1)", "takes 2 numbers"),
        ("cauchy(0, 1)", "no range"),
        ("[1, x]", "finite number"),
        ("[1, 1/0]", "allowed"),
    ],
)
def test_what_is_no_range_is_refused_with_the_forms(text: str, part: str) -> None:
    with pytest.raises(SceneError) as error:
        parse_variation(text)
    assert part in error.value.message


def options(n: int | None = None, sampler: str = "random", **vary: str) -> StudyOptions:
    return StudyOptions(vary={k: parse_variation(v) for k, v in vary.items()}, n=n, sampler=sampler)


def test_a_grid_is_every_combination_and_samples_stand_at_each_of_its_points() -> None:
    design = make_design(options(n=3, a="[1, 2]", u="uniform(0, 1)", b="[5, 6, 7]"))
    assert design.keys == ("a", "u", "b") and design.rows().shape == (18, 3)
    pairs = [(a, b) for a, _, b in design.rows()]
    combinations = [(a, b) for a in (1, 2) for b in (5, 6, 7)]
    assert sorted(set(pairs)) == combinations and all(pairs.count(p) == 3 for p in combinations)
    draws = design.rows()[:3, 1]
    assert len(set(draws)) == 3 and np.all(design.rows(3, 6)[:, 1] == draws)


@pytest.mark.parametrize("sampler", ["random", "sobol", "latin"])
def test_samples_have_the_quantiles_of_their_distributions(sampler: str) -> None:
    design = make_design(
        options(n=4096, sampler=sampler, u="uniform(-1, 3)", t="triangular(0, 1, 4)", z="normal(10, 5 %)")
    )
    u, t, z = design.rows().T
    levels = np.array([0.1, 0.5, 0.9])
    # closed forms: cumulative distributions (x+1)/4; x^2/4 below the mode, 1 - (4-x)^2/12 above; erf
    assert np.quantile(u, levels) == pytest.approx(-1 + 4 * levels, abs=0.1)
    assert np.mean(t <= 1.0) == pytest.approx(0.25, abs=0.03)
    assert np.mean(t <= 2.0) == pytest.approx(1 - 4 / 12, abs=0.03)
    assert np.mean(np.abs(z - 10) <= 0.5) == pytest.approx(math.erf(math.sqrt(0.5)), abs=0.03)


@pytest.mark.parametrize("sampler", ["random", "sobol"])
def test_more_samples_begin_with_those_that_were_there(sampler: str) -> None:
    few, many = (
        make_design(options(n=n, sampler=sampler, a="normal(0, 1)", b="uniform(0, 1)")) for n in (7, 50)
    )
    assert np.array_equal(many.rows(0, 7), few.rows())


def test_samples_are_correlated_as_asked() -> None:
    given = StudyOptions(
        vary={k: parse_variation("normal(0, 1)") for k in "abc"},
        n=20_000,
        correlation=(Correlation(("a", "b"), 0.8), Correlation(("b", "c"), -0.5)),
    )
    found = np.corrcoef(make_design(given).rows().T)
    assert found == pytest.approx(np.array([[1, 0.8, 0], [0.8, 1, -0.5], [0, -0.5, 1]]), abs=0.03)


@pytest.mark.parametrize(
    "given, part",
    [
        (StudyOptions(), "nothing varies"),
        (options(u="uniform(0, 1)"), "number of samples"),
        (options(n=5, a="[1, 2]"), "nothing is drawn"),
        (options(**dict.fromkeys("abcd", "linspace(0, 1, 1000)")), "at most"),
    ],
)
def test_a_study_that_makes_no_sense_is_refused(given: StudyOptions, part: str) -> None:
    with pytest.raises(SceneError, match=part):
        make_design(given)


# -- statistics -----------------------------------------------------------------------------------------
def test_the_share_and_its_interval_are_those_of_the_binomial() -> None:
    from scipy.stats import binomtest

    for count, runs in ((0, 10), (3, 10), (10, 10), (450, 1000)):
        mine, theirs = share(count, runs, runs), binomtest(count, runs).proportion_ci(0.95, "exact")
        assert (mine.share, mine.low, mine.high) == pytest.approx((count / runs, theirs.low, theirs.high))


def test_influence_is_that_of_a_linear_function() -> None:
    design = make_design(options(n=500, a="uniform(0, 1)", b="uniform(0, 10)", c="normal(5, 1)"))
    found = influences(design.keys, design.rows(), design.rows() @ [3.0, -2.0, 0.0] + 7.0)
    assert list(found) == ["b", "a", "c"]
    assert found["b"].swing == pytest.approx(-18.0, abs=0.6) and found["c"].swing == pytest.approx(
        0.0, abs=1e-9
    )
    assert found["b"].rank_correlation < -0.95


def test_sobol_indices_are_those_of_the_ishigami_function() -> None:
    """Closed forms: Ishigami and Homma (1990)."""
    given = options(n=4096, sampler="sobol", **dict.fromkeys(("x", "y", "z"), "uniform(-pi, pi)"))
    design = make_design(given, indices=True)
    assert len(design) == 4096 * 5
    x, y, z = design.rows().T
    a, b = 7.0, 0.1
    found = sobol(design.keys, np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x))
    V = a**2 / 8 + b * math.pi**4 / 5 + b**2 * math.pi**8 / 18 + 0.5
    first = [0.5 * (1 + b * math.pi**4 / 5) ** 2 / V, a**2 / 8 / V, 0.0]
    beyond = 8 * b**2 * math.pi**8 / 225 / V
    assert found is not None
    for one, s, t in zip(found.values(), first, [first[0] + beyond, first[1], beyond]):
        assert one.first == pytest.approx(s, abs=0.02) and one.total == pytest.approx(t, abs=0.02)
        assert one.first_low <= one.first <= one.first_high


def test_many_runs_are_shown_in_one_line(fall: Path) -> None:
    runs = Mechanism(fall, ["robot.links.ball.mass"]).simulate_many({"robot.links.ball.mass": [1.0, -1.0]})
    assert repr(runs) == "ManyRuns(2 runs, 1 failed, of robot.links.ball.mass)"


@pytest.mark.parametrize("n, keys", [(2, 1), (2, 2), (8, 1), (8, 3)])
def test_sobol_indices_of_few_samples_and_of_one_key_have_finite_intervals(n: int, keys: int) -> None:
    """The last of several keys has no influence, so its indices are zero in every resample."""
    names = [f"k{i}" for i in range(keys)]
    design = make_design(options(n=n, **dict.fromkeys(names, "uniform(0, 1)")), indices=True)
    found = sobol(design.keys, design.rows()[:, : max(1, keys - 1)].sum(axis=1) ** 2)
    assert found is not None and list(found) == names
    for one in found.values():
        assert all(math.isfinite(x) for x in dataclasses.astuple(one))
    if keys > 1:
        assert found[names[-1]].total == 0.0 == found[names[-1]].total_high


def test_one_key_explains_all_of_the_variance() -> None:
    design = make_design(options(n=2048, sampler="sobol", a="normal(1, 2)"), indices=True)
    found = sobol(design.keys, 3.0 * design.rows()[:, 0])
    assert found is not None and (found["a"].first, found["a"].total) == pytest.approx((1.0, 1.0), abs=0.02)


def test_runs_that_samples_share_are_not_runs_of_an_earlier_study(fall: Path, tmp_path: Path) -> None:
    """With one key B is the block with that column of B, so values of both are the same."""
    words = ["--vary", "initial.qd.z=normal(1, 0.1)", "-n", 4, "--indices", "--of", "final.q.z"]
    first = sweep(fall, *words, "--out", tmp_path / "out")
    assert first.exit_code == 0 and "earlier study" not in first.output, first.output
    assert "Saltelli" in first.output and stored(tmp_path / "out")[1]["runs"] == 12
    again = sweep(fall, *words, "--out", tmp_path / "out")
    assert "12 of 12 runs are there from an earlier study" in again.output


def test_one_place_may_not_vary_under_two_names(fall: Path) -> None:
    for other in ("robot.links.ball.mass", "robot.links.0.mass"):
        with pytest.raises(SceneError, match="vary robot.links.0.mass: is given twice"):
            Mechanism(fall, [other, "robot.links.0.mass"])


# -- the command ----------------------------------------------------------------------------------------
def test_the_outputs_of_each_run_are_those_of_the_command_alone(fall: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = sweep(fall, "--vary", "initial.qd.z=linspace(0, 2, 3)", "--vary", "gravity.2=[-9.81, -1.62]",
                 "--of", "final.q.z", "--of", "final.qd.z", "--out", out)  # fmt: skip
    assert done.exit_code == 0, done.output
    result, summary = stored(out)
    v, g = result["inputs/initial.qd.z"], result["inputs/gravity.2"]
    assert result["outputs/final.q.z"] == pytest.approx(v + g / 2, abs=1e-9)
    assert result["outputs/final.qd.z"] == pytest.approx(v + g, abs=1e-9)
    error = np.abs(result["outputs/final.q.z"] - v - g / 2)
    assert np.all(result["errors/final.q.z"] >= 0.0) and np.all(error < 1e-9)
    assert summary["runs"] == 6 and summary["failures"] == {}
    # between -5 and -3 m: -4.905 + v with 0 <= v <= 2, so v = 0 and 1 under the gravity of the earth
    assert summary["yield"]["share"] == pytest.approx(2 / 6)
    one = subprocess.run(
        [sys.executable, "-m", "robodyn_cli", *summary["cases"][0]["command"].split()[1:], "--json", "--no-plots",
         "--out", str(tmp_path / "one")], capture_output=True, check=True)  # fmt: skip
    run = summary["cases"][0]["run"]
    alone = json.loads(
        one.stdout
    )  # the runs of the study have a method of their own: the sum of the errors is between
    apart = alone["final"]["q"]["z"] - result["outputs/final.q.z"][run]
    assert abs(apart) <= alone["error_estimate"]["q_end"] + result["errors/final.q.z"][run] < 1e-9
    with xarray.open_datatree(out / "result.h5", engine="h5netcdf") as tree:
        assert tree["outputs"]["final.q.z"].dims == ("run",)


def test_a_run_that_fails_is_a_row_and_the_others_go_on(fall: Path, tmp_path: Path) -> None:
    done = sweep(
        fall,
        "--vary",
        "robot.links.ball.mass=normal(1, 1)",
        "-n",
        12,
        "--of",
        "final.q.z",
        "--out",
        tmp_path / "out",
    )
    assert done.exit_code == 0, done.output
    result, summary = stored(tmp_path / "out")
    wrong = result["inputs/robot.links.ball.mass"] < 0.0
    assert np.array_equal(result["runs/exit_code"], np.where(wrong, 2, 0)) and 0 < wrong.sum() < 12
    assert summary["failures"] == {"2": wrong.sum()}
    assert np.array_equal(np.isnan(result["outputs/final.q.z"]), wrong)
    assert any("too small" in case["why"] for case in summary["cases"])


def test_processes_give_the_same_bits_as_one(tmp_path: Path) -> None:
    path = tmp_path / "pendulum.yaml"
    path.write_text(PENDULUM)
    words = ["--vary", "robot.links.rod.mass=normal(1.3, 10 %)", "--vary", "initial.q.theta=uniform(5 deg, 60 deg)",
             "-n", "20", "--of", "final.q.theta"]  # fmt: skip
    alone, several = tmp_path / "alone", tmp_path / "several"
    assert sweep(path, *words, "--jobs", 1, "--out", alone).exit_code == 0
    command = [
        sys.executable,
        "-m",
        "robodyn_cli",
        "sweep",
        str(path),
        *words,
        "--jobs",
        "2",
        "--out",
        str(several),
    ]
    subprocess.run(command, check=True, capture_output=True)
    a, b = stored(alone)[0], stored(several)[0]
    for name in ("inputs/robot.links.rod.mass", "outputs/final.q.theta", "errors/final.q.theta"):
        assert np.array_equal(a[name], b[name])


def test_compiled_runs_give_the_rows_of_whole_commands(fall: Path, tmp_path: Path) -> None:
    pendulum = tmp_path / "pendulum.yaml"
    pendulum.write_text(PENDULUM + "expect: {final.q.theta: < 0, status: ok}\n")
    vary = [
        "--vary",
        "robot.links.rod.mass=normal(0.5, 0.7)",
        "--vary",
        "robot.links.rod.com.0=[0.3, 0, 0.5]",
        "-n",
        "12",
    ]
    found = []
    for name, more in (("compiled", []), ("whole", ["--of", "error_estimate.at_rounding"])):
        out = tmp_path / name
        of = ["--of", "final.q.theta", "--of", "error_estimate.q_end", *more]
        assert sweep(pendulum, *vary, *of, "--no-plots", "--out", out).exit_code == 0
        found.append(stored(out))
    (a, first), (b, second) = found
    for name in ("runs/exit_code", "runs/holds"):
        assert np.array_equal(a[name], b[name]), name
    assert np.allclose(a["outputs/final.q.theta"], b["outputs/final.q.theta"], atol=1e-12, equal_nan=True)
    assert np.array_equal(np.isnan(a["errors/final.q.theta"]), np.isnan(b["errors/final.q.theta"]))
    assert first["failures"] == second["failures"] and set(first["failures"]) == {"2"}
    assert first["yield"] == second["yield"]


def test_a_scene_is_read_once_and_other_processes_get_what_was_read(fall: Path, tmp_path: Path) -> None:
    family = Family(fall, ["gravity.2=-1"])
    fall.unlink()
    of = ("final.q.z", "error_estimate.at_rounding")  # a whole command gives the second
    options = StudyOptions(vary={"initial.qd.z": parse_variation("linspace(1, 2, 20)")}, of=of)
    study = prepare(AskedStudy(family, options))
    with RowFile(tmp_path, study.task, study.design, study.rows_head) as file:
        for made in run_here(study.task, file, 2):
            file.add(made)
        rows = file.read(0, 20)
    assert rows["done"].all() and len(study.design) == 20
    assert rows["outputs"][:, 0] == pytest.approx(np.linspace(1, 2, 20) - 0.5, abs=1e-9)


def test_a_study_grows_and_keeps_the_runs_that_are_there(
    fall: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    from robodyn_cli.over.study import runs

    count = []
    one = runs.make_one
    monkeypatch.setattr(runs, "make_one", lambda *of: (count.append(of), one(*of))[1])
    of = ["--of", "final.q.z", "--of", "error_estimate.at_rounding"]  # a whole command gives the second
    words = [fall, "--vary", "initial.qd.z=normal(1, 0.1)", *of, "--out", tmp_path / "out"]
    assert sweep(*words, "-n", 4).exit_code == 0 and len(count) == 4
    first = stored(tmp_path / "out")[0]["outputs/final.q.z"]
    assert sweep(*words, "-n", 9).exit_code == 0 and len(count) == 9
    assert np.array_equal(stored(tmp_path / "out")[0]["outputs/final.q.z"][:4], first)
    # another scene shares no runs
    assert sweep(*words, "-n", 9, "--set", "gravity.2=-1").exit_code == 0 and len(count) == 18


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs /proc to see the processes begin")
@pytest.mark.parametrize("kind", ["SIGKILL", "SIGTERM", "SIGINT"])
def test_processes_end_with_the_one_that_began_them_and_leave_no_word(
    fall: Path, tmp_path: Path, kind: str
) -> None:
    command = [sys.executable, "-m", "robodyn_cli", "sweep", str(fall), "--vary", "initial.qd.z=normal(1, 0.1)",
               "-n", "5000", "--of", "error_estimate.at_rounding", "--out", str(tmp_path / "out"), "--jobs", "2", "--no-plots"]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    wait_for(lambda: len(children.read_text().split()) >= 3)  # the tracker of the library and two of ours
    if kind == "SIGINT":
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    else:
        process.send_signal(getattr(signal, kind))
    _, err = process.communicate(timeout=30)  # until the last of them has closed its standard error
    told = err.splitlines()
    if kind == "SIGINT":
        assert process.returncode == 130 and told[-1] == "robodyn: error: interrupted" and len(told) <= 2
    else:
        assert "semaphore" not in err and not (tmp_path / "out/result.h5").exists()


def test_a_study_that_was_killed_goes_on_where_it_was(fall: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "robodyn_cli", "sweep", str(fall), "--vary", "initial.qd.z=normal(1, 0.1)",
               "-n", "3000", "--of", "final.q.z", "--out", str(out), "--jobs", "1", "--no-plots"]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE)
    file = out / ROWS_NAME
    size = Task(Family(fall), "simulate", ("initial.qd.z",), ("final.q.z",)).layout.itemsize

    def done() -> int:
        return file.read_bytes()[size - 1 :: size].count(1) if file.exists() else 0

    wait_for(lambda: done() > 5)
    process.kill()
    process.communicate()
    kept = done()
    assert kept > 5 and not (out / "result.h5").exists()
    torn = bytearray(file.read_bytes())
    torn[size * (kept - 1) + 8 : size * kept] = bytes(size - 8)  # a row that was being written
    file.write_bytes(torn)
    with open(out / "unfinished.jsonl", "a") as reasons:
        reasons.write('[3, 7, "the')
    command[command.index("3000")] = str(kept + 5)
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    assert f"{kept - 1} of {kept + 5} runs are there" in ended.stderr
    result, _ = stored(out)
    assert result["outputs/final.q.z"] == pytest.approx(result["inputs/initial.qd.z"] - 9.81 / 2, abs=1e-9)
    assert not [*out.glob("*unfinished*")]


def wait_for(what: Callable[[], bool]) -> None:
    limit = time.monotonic() + 60
    while time.monotonic() < limit and not what():
        time.sleep(0.02)


def test_an_interrupt_says_what_is_kept_and_nothing_else(fall: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "robodyn_cli", "sweep", str(fall), "--vary", "initial.qd.z=normal(1, 0.1)",
               "-n", "100000", "--of", "error_estimate.at_rounding", "--out", str(out), "--jobs", "2", "--no-plots"]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    file = out / ROWS_NAME
    size = Task(Family(fall), "simulate", ("initial.qd.z",), ("error_estimate.at_rounding",)).layout.itemsize

    def done() -> int:
        return file.read_bytes()[size - 1 :: size].count(1) if file.exists() else 0

    wait_for(lambda: done() > 20)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130
    runs = done()
    # a slow machine tells how far it is
    why, first, last = (x for x in said.splitlines() if not x.startswith("robodyn: after "))
    assert "error_estimate.at_rounding" in why
    assert first.endswith(" of 100000 runs are done and kept; the same command goes on from there")
    # the last rows may be written and not yet counted
    assert 0 < int(first.split()[1]) <= runs
    assert last == "robodyn: error: interrupted"


def test_the_yield_that_is_asked_for_decides_the_exit_code(fall: Path, tmp_path: Path) -> None:
    words = [fall, "--vary", "initial.qd.z=[0, 1, 2]", "--of", "final.q.z", "--out", tmp_path / "out"]
    assert sweep(*words, "--yield", 0.6).exit_code == 0
    low = sweep(*words, "--yield", 0.7)
    assert low.exit_code == 1 and "yield is 0.6667" in low.output
    nothing = sweep(*words, "--set", "expect={}", "--yield", 0.6)
    assert nothing.exit_code == 2 and "'expect' is missing" in nothing.output


def test_a_grid_has_extremes_and_samples_a_spread(fall: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = [fall, "--of", "final.q.z", "--out", out]
    grid = sweep(*words, "--vary", "initial.qd.z=linspace(0, 2, 3)")
    found = stored(out)[1]
    assert found["results"]["final.q.z"].keys().isdisjoint({"mean", "sd", "quantiles", "mean_error"})
    assert found["failed"] == {"share": 0.0} and found["yield"] == {"share": pytest.approx(2 / 3)}
    assert "least" in grid.output and "greatest" in grid.output and "95 %" not in grid.output
    drawn = sweep(*words, "--vary", "initial.qd.z=uniform(0, 2)", "-n", 5)
    found = stored(out)[1]
    assert {"mean", "sd", "quantiles", "mean_error"} <= found["results"]["final.q.z"].keys()
    assert {"low", "high", "confidence"} <= found["failed"].keys()
    assert "95 %" in drawn.output and "0 % of the runs (0 to 52.2 %)" in drawn.output
    # the scene expects something, which is no yield as long as the study asks for none
    assert "yield" not in drawn.output
    assert "yield" in sweep(*words, "--vary", "initial.qd.z=uniform(0, 2)", "-n", 5, "--yield", 0).output


SETTLING = """
schema: 1
command: simulate
gravity: [0, 0, 0]
robot:
  joints: [{name: z, type: prismatic, parent: base, axis: [0, 0, 1]}]
  links: [{name: ball, mass: 2.0}]
control: {type: pd, gains: {kp: 40, kd: 12}}
trajectory: {type: joint, duration: 2, q: {z: "0.7"}}
initial: {q: {z: 0}}
simulate: {duration: 2, samples: 41}
outputs: {response: true}
"""


def test_the_terminal_says_in_how_many_runs_an_output_has_no_value(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(SETTLING)
    words = [
        tmp_path / "scene.yaml",
        "--of",
        "response.z.settling",
        "--of",
        "final.q.z",
        "--out",
        tmp_path / "out",
    ]
    found = sweep(*words, "--vary", "control.gains.kp=[40, 0.5, 0.1]").output
    assert stored(tmp_path / "out")[1]["results"]["response.z.settling"]["runs"] == 1
    assert re.search(r"^  output .* no value in$", found, re.MULTILINE)
    assert re.search(r"^  response.z.settling .* s  2 of 3 runs$", found, re.MULTILINE)
    assert re.search(r"^  final.q.z .* 0 of 3 runs$", found, re.MULTILINE)
    none = sweep(*words, "--vary", "control.gains.kp=[0.5, 0.1]").output
    assert re.search(r"^  response.z.settling .* 2 of 2 runs$", none, re.MULTILINE)
    assert "no value" not in sweep(*words, "--vary", "control.gains.kp=[40, 41]").output


UNITS = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: hinge, type: revolute, axis: [0, 0, 1]}
    - {name: slide, type: prismatic, axis: [1, 0, 0]}
    - {name: ball, type: spherical}
  links: [{name: a}, {name: b}, {name: c}]
"""


@pytest.mark.parametrize(
    "key, unit",
    [
        ("peak_torque.hinge", "N m"),
        ("joints.slide.peak_torque", "N"),
        ("rms_torque.slide", "N"),
        ("peak_speed.hinge", "rad/s"),
        ("joints.slide.peak_power", "W"),
        ("peak_torque_time.hinge", "s"),
        ("final.q.hinge", "rad"),
        ("final.qd.slide", "m/s"),
        ("final.q.ball.qw", "1"),
        ("final.qd.ball.wx", "rad/s"),
        ("lock.angles.slide", "m"),
        ("lock.angles_deg.hinge", "deg"),
        ("lock.time", "s"),
        ("fastest.duration", "s"),
        ("lock.time_error", "s"),
        ("accelerations.slide", "m/s^2"),
        ("torques_of_joints.hinge", "N m"),
        ("points.tip.peak_speed", "m/s"),
        ("energy_drift", "J"),
        ("energy_drift_relative", "1"),
        ("reactions.largest.hinge.peak_moment", "N m"),
        ("counters.steps", "1"),
        ("drives.slide.joint.rms_torque", "N"),
        ("drives.slide.joint.peak_speed", "m/s"),
        ("drives.slide.shaft.rms_torque", "N m"),
        ("drives.slide.shaft.peak_speed", "rad/s"),
        ("drives.slide.ratio", "rad/m"),
        ("drives.hinge.ratio", "1"),
        ("drives.hinge.wind_up", "rad"),
        ("control.tracking.slide.peak", "m"),
        ("control.tracking.hinge.at", "s"),
        ("control.limits.slide", "N"),
        ("control.saturated.slide", "s"),
        ("control.energy.braking", "J"),
        ("error_estimate.q_end", "rad or m"),
        ("constraint_residual.position", "m or rad"),
    ],
)
def test_outputs_have_the_units_of_their_keys(key: str, unit: str) -> None:
    leaf = next(leaf for command in SCENE_COMMANDS if (leaf := leaf_of(command, key)) is not None)
    assert leaf.unit(build_model(load_scene_text(UNITS)).coordinate_units) == unit


def test_units_of_outputs_are_shown_and_stored(fall: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = sweep(fall, "--vary", "initial.qd.z=[0, 1]", "--of", "final.qd.z", "--out", out)
    result, summary = stored(out)
    assert (
        result.variables["outputs/final.qd.z"].units == "m/s" == result.variables["errors/final.qd.z"].units
    )
    assert summary["results"]["final.qd.z"]["unit"] == "m/s" and "m/s" in done.output


def test_the_scene_can_say_what_it_studies(fall: Path, tmp_path: Path) -> None:
    fall.write_text(
        FALL
        + "study: {vary: {initial.qd.z: 'uniform(0, 1)', gravity.2: [-1, -2]}, n: 3, seed: 4, of: [final.q.z], "
        "sampler: latin, yield: 0}\n"
    )
    assert load_scene(fall).study.least_yield == 0.0
    done = sweep(fall, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    summary = stored(tmp_path / "out")[1]
    assert summary["runs"] == 6 and summary["sampler"] == "latin" and summary["seed"] == 4


@pytest.mark.parametrize(
    "words, part",
    [
        (["--vary", "robot.links.bull.mass=[1]"], "no item named 'bull'"),
        (["--vary", "robot.links.ball.mas=[1]"], "unknown key 'mas'"),
        (["--vary", "robot.links.ball.mass=[20 deg]"], "mass in kg expected"),
        (
            ["--vary", "robot.links.ball.mass=[1, -1, 3]"],
            "robot.links.ball.mass=[1, -1, 3]: is too small (value -1)",
        ),
        (["--vary", "simulate.samples=linspace(100, 200, 4)"], "is not a whole number (value 133.3"),
        (["--vary", "robot.links.ball.mass"], "not KEY=SPEC"),
        (["--vary", "gravity.2=[1]", "--vary", "gravity.2=[2]"], "given twice"),
        (
            ["--vary", "robot.links.0.mass=[1]", "--vary", "robot.links.ball.mass=[2]"],
            "given twice, also as robot.links.0.mass",
        ),
        (
            ["--vary", "gravity.2=uniform(0, 1)", "-n", "10", "--indices"],
            "-n 10: Sobol indices need a power of 2",
        ),
        (["--vary", "gravity.2=uniform(0, 1)", "-n", "1", "--indices"], "allowed: 2, 4, 8, 16"),
        (
            ["--vary", "gravity.2=[1]", "--of", "final.q.y"],
            "error: --of final.q.y: the summary of simulate has no such key (did you mean 'final.q.z'?)",
        ),
        (
            ["--vary", "gravity.2=[1]", "--set", "study={of: [final.q.y]}"],
            "study.of.0: the summary of simulate has no such key",
        ),
        (["--vary", "gravity.2=[1]", "--of", "status"], "not a number"),
        (["--vary", "gravity.2=uniform(0, 1)"], "-n N"),
        (["--vary", "gravity.2=uniform(0, 1)", "-n", "0"], "whole number >= 1"),
        (
            ["--vary", "gravity.2=linspace(1, 2, 1000)", "--vary", "initial.qd.z=linspace(1, 2, 1000000)"],
            "at most",
        ),
        (["--vary", "gravity.2=[1]", "--sampler", "dice"], "random, sobol, latin"),
        ([], "nothing varies"),
    ],
)
def test_a_wrong_study_is_refused_before_anything_runs(
    fall: Path, tmp_path: Path, words: list[str], part: str
) -> None:
    done = sweep(fall, *words, "--out", tmp_path / "out")
    assert done.exit_code == 2 and part in done.output, done.output
    assert not os.path.exists(tmp_path / "out")


@pytest.mark.parametrize(
    "command, key, possible",
    [
        ("deploy", "lock.time", True),
        ("deploy", "lock.tim", False),
        ("deploy", "lock.kind", False),
        ("deploy", "lock.angles.theta1", True),
        ("deploy", "lock.angles.theta9", False),
        ("deploy", "lock.multiplier_growth.times.10", True),
        ("simulate", "final.q.theta1", True),
        ("simulate", "final.p.theta1", False),
        ("simulate", "lock.time", False),
        ("simulate", "error_estimate.q_end", True),
        ("simulate", "error_estimate.end", False),
        ("simulate", "energy_drift", True),
        ("simulate", "energy_drif", False),
    ],
)
def test_an_output_that_no_run_has_is_refused_where_the_nominal_run_has_nothing(
    tmp_path: Path, command: str, key: str, possible: bool
) -> None:
    """The one does not lock, the other fails on the way."""
    deploys = command == "deploy"
    scene = CONFIGS / ("four_bar_deploy.yaml" if deploys else "double_pendulum.yaml")
    short = "simulate.duration=0.02" if deploys else "simulate.max_steps=3"
    mass = f"robot.links.{'crank' if deploys else 'link1'}.mass"
    done = sweep(
        scene, "--set", short, "--vary", f"{mass}=[20]", "--of", key, "--no-plots", "--out", tmp_path / "out"
    )
    assert (done.exit_code == 0) == possible, done.output
    if not possible:
        assert done.exit_code == 2 and f"--of {key}" in done.output and not (tmp_path / "out").exists()


def test_drawings_fit_the_study(fall: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = [fall, "--of", "final.q.z", "--out", out]
    cases = {
        "study_response": ["--vary", "gravity.2=linspace(-9, -1, 4)"],
        "study_map": ["--vary", "gravity.2=linspace(-9, -1, 3)", "--vary", "initial.qd.z=[0, 1]"],
        "study_histograms": [
            "--vary",
            "gravity.2=uniform(-9, -1)",
            "--vary",
            "initial.qd.z=normal(1, 5 %)",
            "-n",
            "24",
        ],
    }
    for name, vary in cases.items():
        assert sweep(*words, *vary).exit_code == 0
        drawn = {path.stem for path in out.glob("*.png")}
        assert name in drawn and len(drawn & set(cases)) == 1


def test_the_terminal_says_why_runs_are_whole_commands(tmp_path: Path) -> None:
    words = [
        CONFIGS / "four_bar_deploy.yaml",
        *("--set", "simulate.duration=0.02", "--vary", "robot.links.crank.mass=[20]", "--no-plots"),
    ]
    slow = sweep(
        *words, "--of", "lock.time", "--set", "expect={criteria.grid: < 1}", "--out", tmp_path / "slow"
    )
    assert (
        "compiled code does not give criteria.grid (multipliers are judged on samples) of expect"
        in slow.output
    )
    assert "of expect (--set expect={} leaves it out)" in slow.output
    assert "1 of 1 runs were whole commands, " in slow.output
    fast = sweep(*words, "--out", tmp_path / "fast")
    assert "whole command" not in fast.output
    other = sweep(*words, "--of", "criteria.grid", "--set", "expect={}", "--out", tmp_path / "other")
    assert "compiled code does not give criteria.grid (multipliers are judged on samples" in " ".join(
        other.output.split()
    )


@pytest.mark.parametrize(
    ("name", "changes", "key", "why"),
    [
        (
            "mechanisms/balanced_four_bar",
            ("command=assemble",),
            "robot.links.bar.mass",
            "there is no compiled code of assemble for many runs",
        ),
        (
            "trajectories/fastest_2r",
            (),
            "robot.links.link1.mass",
            "limits of torques or paths decide the motion",
        ),
        (
            "2r_circle",
            (),
            "robot.joints.theta2.a",
            "a point of an open chain is led, so lengths change the motion",
        ),
    ],
)
def test_runs_that_take_a_whole_command_say_why_and_what_each_costs(
    name: str, changes: tuple[str, ...], key: str, why: str, tmp_path: Path
) -> None:
    sets = [word for change in ("expect={}", *changes) for word in ("--set", change)]
    of = {"assemble": "mobility.rank", "inverse": "mechanism.degrees_of_freedom"}
    scene = Family(CONFIGS / f"{name}.yaml", ("expect={}", *changes)).own
    output = of[scene.command] if scene.loops else "peak_torque.theta1"
    done = sweep(
        CONFIGS / f"{name}.yaml",
        *sets,
        "--vary",
        f"{key}=[2, 3]",
        "--of",
        output,
        "--out",
        tmp_path,
        "--no-plots",
    )
    said = " ".join(done.output.split())
    assert why in said
    before = re.search(rf"{re.escape(why)}.*; that of the scene as it stands took \S+ s", said)
    after = re.search(r"2 of 2 runs were whole commands, \S+ s each", said)
    assert before and after and before.end() <= after.start(), said
